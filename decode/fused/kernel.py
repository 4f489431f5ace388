"""The fused kernel that executes a plan: it reads the frames once (twice when orders come from a spatial scan)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.device import Device, Lanes
from decode.fused.axis_lanes import AxisLanes, AxisTracer
from decode.fused.plan import DecodePlan
from decode.fusion.interface import FusionRule
from decode.height.models import Pixels
from decode.order import temporal
from decode.reason import Reason
from decode.reconstruction import AxisPhase, Reconstruction
from decode.validity import limits, shadow
from decode.validity.error_causes import Signs
from decode.validity.stray_light import Coordinates, StrayLight


class Kernel:
    """Traces and runs what a plan says."""

    def __init__(self, plan: DecodePlan, device: Device, rule: FusionRule) -> None:
        self._plan, self._device, self._rule = plan, device, rule
        rows, columns = plan.stack.frames.shape[2:]
        self._image = (rows, columns)
        self._tracer = AxisTracer(
            device,
            plan.stack,
            Pixels(device, self._image, device.types.Float64),
            rule,
            plan.gamma,
            reject_saturated=plan.options.saturation == "reject",
        )
        # Started here, to be done when the rest is traced.
        self._stray = self._stray_light()

    def decode(self) -> tuple[Reconstruction, Signs | None]:
        """Trace the kernel, run it, and return its images; and signs of errors, where they are asked for."""
        plan, types = self._plan, self._device.types
        axes = {axis.axis: self._tracer.trace(axis) for axis in plan.axes}
        measured = axes[plan.axis]
        finest = measured.phasor
        modulation = self._device.root(finest.cosine * finest.cosine + finest.sine * finest.sine)
        height = sigma = types.Float(float("nan"))
        if plan.model is not None:
            height, sigma = self._height(measured)
        lit = None
        if self._stray is not None and measured.samples is not None:
            lit = self._stray.lit(measured.samples)
        reason = limits.reasons(
            self._device,
            plan.limits,
            finest,
            modulation,
            measured.usable,
            measured.residuals,
            None if plan.model is None else height,
            lit,
            measured.lost,
            accepted=Reason.ORDER_UNKNOWN if plan.guessed else Reason.OK,
        )
        lanes: dict[str, Lanes] = {
            "height_mm": height,
            "sigma_mm": sigma,
            "modulation_dn": modulation,
            "offset_dn": finest.offset,
            "reason": reason,
            "exposure": types.UInt8(finest.exposure),
        }
        for axis, decoded in axes.items():
            lanes[f"{axis}.wrapped"] = decoded.wrapped_rad
            lanes[f"{axis}.order"] = decoded.order
        signs = self._signs(measured) if plan.options.uncertainty == "by-cause" else []
        self._device.dr.eval(list(lanes.values()), signs)
        images: dict[str, Any] = {
            name: self._device.image(values, self._image) for name, values in lanes.items()
        }
        if self._stray is not None:
            images["reason"] = self._stray.spread(
                images["reason"],
                self._rule,
                lambda: self._coordinates(measured, images["height_mm"]),
            )
        phases = {
            axis: AxisPhase(
                decoded.period_px, images.pop(f"{axis}.wrapped"), images.pop(f"{axis}.order")
            )
            for axis, decoded in axes.items()
        }
        rec = Reconstruction(
            axis=plan.axis,
            # One number, seen as an image.
            projector=np.broadcast_to(np.uint8(plan.projector), self._image),
            phases=phases,
            calibration=plan.stack.calibration,
            scene=plan.stack.scene,
            identity=plan.stack.identity,
            settings=plan.options.summary()
            | {"unwrap": plan.measuring.way, "resolved": plan.resolved()},
            **images,
        )
        if not signs:
            return rec, None
        sigma_rad, *visibility = (self._device.image(values, self._image) for values in signs)
        level = visibility.pop(0) if measured.samples is not None else None
        with np.errstate(divide="ignore", invalid="ignore"):
            mm_per_rad = rec.sigma_mm / sigma_rad
        periods = tuple(fringes.period_px for fringes in plan.measuring.sets)
        return rec, Signs(periods, tuple(visibility), sigma_rad, mm_per_rad, level)

    def _signs(self, measured: AxisLanes) -> list[Lanes]:
        """Sensor noise of the finest phase in rad, the fringes' level, and B / A of each period unless samples may be clipped."""
        black, device = self._plan.stack.sensor.black_level_dn, self._device
        # Clipping changes the modulation of fine and coarse fringes differently.
        clean = measured.phasors if self._plan.options.saturation == "reject" else ()
        return [
            device.root(measured.phasor.variance_rad2),
            *([] if measured.samples is None else [shadow.level(measured.samples)]),
            *(
                device.root(p.cosine * p.cosine + p.sine * p.sine) / (p.offset - black)
                for p in clean
            ),
        ]

    def _stray_light(self) -> StrayLight | None:
        """The search for stray light; None if it is off, or the axis has no fringes."""
        sets, fraction = self._plan.measuring.sets, self._plan.options.min_relative_modulation
        if not (sets and fraction):
            return None
        return StrayLight(
            self._device, self._image, fraction, lambda at: self._tracer.samples(sets[-1], at)
        )

    def _coordinates(
        self, measured: AxisLanes, height_mm: NDArray[np.float32]
    ) -> Coordinates | None:
        """What is compared along epipolar lines; None where the rig is unknown."""
        plan = self._plan
        if plan.view is None:
            return None
        return Coordinates(
            plan.view.rig,
            plan.axis,
            self._device.types.Float(self._coordinate(measured)),
            measured.sigma_px,
            None if plan.model is None else height_mm,
            plan.limits.heights_mm,
        )

    def _height(self, measured: AxisLanes) -> tuple[Lanes, Lanes]:
        """Height and its predicted standard deviation, float32."""
        assert self._plan.model is not None
        real = self._device.types.Float
        solver = self._plan.model.bind(self._tracer.pixels)
        height, slope = solver.height(self._coordinate(measured))
        return real(height), measured.sigma_px * self._device.dr.abs(real(slope))

    def _coordinate(self, measured: AxisLanes) -> Lanes:
        return temporal.coordinate(
            self._device, measured.wrapped_rad, measured.order, measured.period_px
        )
