"""The projector as a Mitsuba emitter, so that Mitsuba's own integrators can light a scene with fringes."""

import functools
import json
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter

from render.plugins.lens import optics
from render.plugins.projector_light import Light
from render.plugins.variant import dr, mi
from scenes.acquisition.pattern_basis import Basis, Channel
from scenes.rig.projectors import PinholeProjector, TelecentricProjector

PLUGIN = "fringe_projector"


def projector_plugin(
    projector: TelecentricProjector | PinholeProjector, basis: Basis, frame: int
) -> dict[str, Any]:
    """Mitsuba's dictionary entry of a projector showing one of its frames."""
    register(mi.variant())
    return {
        "type": PLUGIN,
        "device": projector.model_dump_json(),
        "channels": json.dumps([asdict(channel) for channel in basis.channels]),
        "weights": json.dumps(basis.weights[frame].tolist()),
    }


@functools.cache
def register(variant: str) -> None:
    """Register the plugin with Mitsuba, once per variant, as its classes differ between variants."""

    class FringeProjector(mi.Emitter):  # type: ignore[misc]
        """A delta light: one direction per point, drawn from the pupil if there is a lens.

        Properties, all JSON: `device` (a `scenes` projector), `channels` (a list of `scenes.Channel`) and
        `weights` (one per channel).
        """

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            device = TypeAdapter(TelecentricProjector | PinholeProjector).validate_json(
                props["device"]
            )
            channels = [Channel(**channel) for channel in json.loads(props["channels"])]
            self.light = Light(device, optics(device), channels)
            self.weights = weights(json.loads(props["weights"]))
            self.m_flags = mi.EmitterFlags.DeltaPosition

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            source, irradiance, pixel, lit = self.light.connect(it.p, sample)
            active &= lit
            ds = dr.zeros(mi.DirectionSample3f)
            ds.p = source
            ds.d = source - it.p
            ds.dist = dr.norm(ds.d)
            ds.d /= ds.dist
            ds.n = mi.Normal3f(self.light.optics.axis())
            ds.uv = pixel
            ds.time = it.time
            ds.pdf = dr.select(active, 1, mi.Float(0))
            ds.delta = mi.Bool(True)
            ds.emitter = mi.EmitterPtr(self)
            return ds, self._emitted(irradiance, pixel, active)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            to_local = self.light.optics.to_local
            irradiance, pixel, lit = self.light.response(to_local(it.p), to_local(ds.p))
            return self._emitted(irradiance, pixel, active & lit)

        def _emitted(self, irradiance: Any, pixel: Any, active: Any) -> Any:
            values = self.light.channel_values(pixel, active)
            pattern = sum((w * v for w, v in zip(self.weights, values, strict=True)), mi.Float(0))
            return mi.Color1f(irradiance * pattern) & active

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Float(0)

        def eval(self, si: Any, active: Any = True) -> Any:
            return mi.Color1f(0)

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

        def traverse(self, callback: Any) -> None:
            super().traverse(callback)

        def to_string(self) -> str:
            return f"FringeProjector[{len(self.weights)} channels]"

    mi.register_emitter(PLUGIN, FringeProjector)


def weights(row: ArrayLike) -> list[Any]:
    """A frame's weights as opaque numbers, so that all frames use one compiled kernel."""
    return [dr.opaque(mi.Float, float(w)) for w in np.asarray(row)]
