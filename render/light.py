"""What a projector sends to a point: the irradiance it makes there, and the pattern's basis channels."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from render.optics import Optics
from render.variant import dr, mi
from scenes.basis import Channel
from scenes.emission import PinholeProjector, Projector


class Light:
    """A projector's light for the variant in use.

    White makes the irradiance ``E0 (reference / z)^2`` on a plane perpendicular to a pinhole's axis, ``E0`` on a
    telecentric one's, uniform across the plane. `channels` are evaluated once each: a cosine and a sine of one fringe
    share a `sincos`, tables of one axis share their index.
    """

    def __init__(self, projector: Projector, optics: Optics, channels: Sequence[Channel]) -> None:
        self.optics = optics
        strength = projector.irradiance_w_m2
        if isinstance(projector, PinholeProjector):
            strength *= projector.reference_mm**2
        self.strength = dr.opaque(mi.Float, strength)
        self.channels = tuple(channels)
        self.periods = {
            (c.axis, c.period_px): dr.opaque(mi.Float, c.period_px)
            for c in channels
            if c.kind in ("cos", "sin")
        }
        self.tables = [
            mi.Float(np.asarray(c.values, dtype=np.float32)) if c.kind == "table" else None
            for c in channels
        ]
        dr.eval(self.tables)

    def connect(self, point: Any, lens_sample: Any) -> tuple[Any, Any, Any, Any]:
        """Light that reaches a world point.

        Returns the world point it comes from, the irradiance of white in W/m^2 on a surface facing that point, the
        continuous projector pixel it carries, and whether that pixel exists (shadows are the caller's).
        """
        local = self.optics.to_local(point)
        source = self.optics.light_source(local, lens_sample)
        irradiance, pixel, lit = self.response(local, source)
        return self.optics.to_world(source), irradiance, pixel, lit

    def response(self, local: Any, source: Any) -> tuple[Any, Any, Any]:
        """Irradiance of white, pixel and existence for a point and a light source in the projector's frame."""
        pixel, lit = self.optics.pixel(local, source)
        cosine = local.z / dr.norm(local - source)
        irradiance = self.strength / cosine
        if not self.optics.telecentric:
            irradiance /= dr.square(local.z)
        return irradiance, pixel, lit

    def channel_values(self, pixel: Any, active: Any) -> list[Any]:
        """Each basis channel's value at a continuous projector pixel."""
        along = {"column": pixel.x, "row": pixel.y}
        waves = {}
        for key, period in self.periods.items():
            u = along[key[0]]
            # Whole fringes go first, in one rounding: the phase keeps float32's digits.
            rest = dr.fma(-period, dr.round(u / period), u)
            waves[key] = dr.sincos(2 * dr.pi * rest / period)
        values = []
        for channel, table in zip(self.channels, self.tables, strict=True):
            if channel.kind == "one":
                values.append(mi.Float(1))
            elif channel.kind == "table":
                index = dr.clip(mi.Int32(dr.floor(along[channel.axis])), 0, len(channel.values) - 1)
                values.append(dr.gather(mi.Float, table, mi.UInt32(index), active))
            else:
                values.append(waves[channel.axis, channel.period_px][channel.kind == "cos"])
        return values
