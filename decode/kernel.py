"""The fused kernel that decodes what a plan says: it reads the frames once (twice when orders come from a spatial scan)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode import fusion, gamma, gray, ordering, shadow, unwrap, validity
from decode.device import Device, Lanes
from decode.height import Pixels, Solver
from decode.ladder import single
from decode.phase import FringeSet, Phasor, wrapped
from decode.plan import Plan, Way
from decode.reconstruction import AxisPhase, Reconstruction
from decode.validity import Limits, Reason
from scenes.patterns import Axis


@dataclass(frozen=True)
class _Decoded:
    """One axis, as lanes."""

    period_px: float
    phasor: Phasor
    wrapped_rad: Lanes
    order: Lanes
    residuals: list[Lanes]
    usable: Lanes
    sigma_px: Lanes
    """Predicted standard deviation of the coordinate."""
    lost: Lanes | None = None
    """Where samples are NaN or infinite."""
    typical: float | None = None
    """`shadow.typical` light, if stray light is to be told by it."""
    lit: Lanes | None = None
    """Where the light is the projector's own, as far as each pixel tells by itself."""


class Kernel:
    """Traces and runs what a plan says."""

    def __init__(self, plan: Plan, device: Device, rule: fusion.FusionRule) -> None:
        self.plan, self.device, self.rule = plan, device, rule
        rows, columns = plan.stack.frames.shape[2:]
        self.image = (rows, columns)
        self.limits = Limits(
            plan.options.min_modulation_dn, plan.options.max_order_residual, plan.volume_mm
        )
        self.pixels = Pixels(device, self.image, device.types.Float64)
        # started here, to be done when the rest is traced
        self.few_levels = self._few_levels()

    def decode(self) -> Reconstruction:
        """Trace the kernel, run it, and hand out its images."""
        plan, types = self.plan, self.device.types
        axes = {axis: self._axis(axis) for axis in plan.sets}
        measured = axes[plan.axis]
        finest = measured.phasor
        modulation = self._modulation(finest)
        height = sigma = types.Float(float("nan"))
        if plan.model is not None:
            height, sigma = self._height(plan.model.bind(self.pixels), measured)
        reason = validity.reasons(
            self.device,
            self.limits,
            finest,
            modulation,
            measured.usable,
            measured.residuals,
            None if plan.model is None else height,
            measured.lit,
            measured.lost,
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
        self.device.dr.eval(list(lanes.values()))
        images = {name: self._host(values) for name, values in lanes.items()}
        reason = images["reason"]
        # the greatest code first: without the comparison's image, which costs a fifth of all decoding
        if measured.typical and reason.max() >= Reason.SHADOW and (reason == Reason.SHADOW).any():
            images["reason"] = self._shaded(images, measured, measured.typical)
        phases = {
            axis: AxisPhase(
                decoded.period_px, images.pop(f"{axis}.wrapped"), images.pop(f"{axis}.order")
            )
            for axis, decoded in axes.items()
        }
        return Reconstruction(
            axis=plan.axis,
            # one number, seen as an image
            projector=np.broadcast_to(np.uint8(plan.projector), self.image),
            phases=phases,
            calibration=plan.stack.calibration,
            settings=plan.options.summary() | {"unwrap": plan.ways[plan.axis]},
            **images,
        )

    def _axis(self, axis: Axis, way: Way | None = None) -> _Decoded:
        """One axis, unwrapped as the plan says or another way."""
        device, plan = self.device, self.plan
        way = way or plan.ways[axis]
        sets, rungs = plan.sets[axis], plan.rungs(axis, way)
        if way in ("row-scan", "quality-guided"):
            sets, rungs = sets[-1:], single([sets[-1].period_px])
        samples = [self._samples(fringes) for fringes in sets]
        cell = self._cell(axis, samples) if way == "gray" else None
        if not sets:
            assert cell is not None  # an axis has fringes or Gray code
            return self._coded(axis, cell)
        phasors = [self.rule.fuse(taken) for taken in samples]
        phases = [self._phase(*pair) for pair in zip(sets, phasors, strict=True)]
        lifted = [rung.phase(device, phases) for rung in rungs]
        residuals = []
        if cell is not None:
            order, residual = self._on_cell(axis, cell, lifted[0], rungs[0].period_px)
            residuals.append(residual)
        elif way in ("volume", "field"):
            expected = self._expected(axis, way == "field")
            order = unwrap.anchored(device, lifted[0], rungs[0].period_px, expected)
        else:
            order = self._scanned(axis, sets[0], phasors[0], phases[0])
        for k in range(1, len(rungs)):
            ratio = rungs[k - 1].period_px / rungs[k].period_px
            order, residual = unwrap.climb(device, lifted[k - 1], order, ratio, lifted[k])
            residuals.append(residual)
        usable = phasors[0].usable
        for phasor in phasors[1:]:
            usable = usable & phasor.usable
        period = sets[-1].period_px
        sigma_px = device.root(phasors[-1].variance_rad2) * (period / unwrap.TURN)
        return _Decoded(
            period,
            phasors[-1],
            phases[-1],
            order,
            residuals,
            usable,
            sigma_px,
            self._not_a_number(phasors),
            *(self._lit(samples[-1]) if axis == plan.axis else ()),
        )

    def _few_levels(self) -> Lanes | None:
        """Light of a coarse grid of pixels; None if stray light is not to be told by it."""
        sets = self.plan.sets[self.plan.axis]
        if not (sets and self.plan.options.min_relative_modulation):
            return None
        at = self.device.types.UInt32(shadow.grid(self.image))
        levels = shadow.level(self._samples(sets[-1], at))
        self.device.dr.eval(levels)
        return levels

    def _lit(self, samples: fusion.Samples) -> tuple[float, Lanes] | tuple[()]:
        """The image's typical light, and where there is more than stray light has."""
        if self.few_levels is None:
            return ()
        typical = shadow.typical(self.few_levels.numpy())
        fraction = self.plan.options.min_relative_modulation
        least = self.device.dr.opaque(self.device.types.Float, fraction * typical)
        return typical, shadow.level(samples) >= least

    def _shaded(
        self, images: dict[str, NDArray[Any]], measured: _Decoded, typical: float
    ) -> NDArray[np.uint8]:
        """Reasons, (row, col), with the shadow that is known by what borders on it, or by what contradicts it."""
        least = self.plan.options.min_relative_modulation * typical
        dr, types = self.device.dr, self.device.types
        samples = self._samples(self.plan.sets[self.plan.axis][-1])
        levels = shadow.level(samples)
        phasor = self.rule.fuse(samples)
        # clipped light is no shadow; NaN, and what float32 cannot square, is neither shadow nor light
        real = dr.isfinite(phasor.offset) & dr.isfinite(levels)
        dark = phasor.usable & real & ~(levels >= dr.opaque(types.Float, least))
        what = dr.select(
            dark,
            types.UInt32(shadow.DARK),
            dr.select(real, types.UInt32(0), types.UInt32(shadow.NOTHING)),
        )
        dr.eval(levels, what)
        level, where = self._host(levels), self._host(what)
        nothing = where == shadow.NOTHING
        shade = shadow.borders(level, where == shadow.DARK, nothing, least)
        reason = images["reason"]
        shade &= (reason != Reason.SATURATED) & (reason != Reason.NOT_A_NUMBER)
        reason = np.where(shade, np.uint8(Reason.SHADOW), reason)
        trusted = reason == Reason.OK
        stray = self._contradicted(trusted, images["height_mm"], measured, level, typical)
        reason[stray] = Reason.SHADOW
        return reason

    def _contradicted(
        self,
        trusted: NDArray[np.bool_],
        height_mm: NDArray[np.float32],
        measured: _Decoded,
        level: NDArray[np.float32],
        typical: float,
    ) -> NDArray[np.bool_]:
        """Which trusted pixels others contradict, (row, col); none where the rig is unknown."""
        plan, device, types = self.plan, self.device, self.device.types
        heights = plan.volume_mm
        if plan.model is not None and trusted.any():
            found = height_mm[trusted]
            heights = float(found.min()), float(found.max())
        if plan.view is None or heights is None:
            return np.zeros(self.image, np.bool_)
        at = types.Float(
            unwrap.coordinate(device, measured.wrapped_rad, measured.order, measured.period_px)
        )
        margin = ordering.SURE * measured.sigma_px
        told = device.plane(trusted.view(np.uint8)) > 0.5
        least = device.dr.select(told, at - margin, float("-inf"))
        most = device.dr.select(told, at + margin, float("inf"))
        device.dr.eval(least, most)
        claims = ordering.Claims(self._host(least), self._host(most), level, typical)
        return ordering.contradicted(claims, plan.view.rig, plan.axis, heights)

    def _phase(self, fringes: FringeSet, phasor: Phasor) -> Lanes:
        """Wrapped phase, gamma undone."""
        phase = wrapped(self.device, phasor)
        power = self.plan.gamma
        return phase if power is None else gamma.correct(self.device, phase, power, fringes)

    def _cell(self, axis: Axis, samples: list[fusion.Samples]) -> gray.GrayCell:
        """The Gray cell of every pixel; where the code has no thresholds of its own, the fringes' offset serves."""
        stack = self.plan.stack
        offsets = None
        if samples:
            offsets = [samples[-1].phasor(e).offset for e in range(len(stack.exposure_ms))]
        return gray.decode(
            self.device,
            self.plan.gray[axis],
            stack,
            self.device.plane,
            offsets,
            # cells of half a fringe are many pixels wide, and the fringe tells whether the code is right
            weak=0.0 if samples else gray.WEAK,
        )

    def _on_cell(
        self, axis: Axis, cell: gray.GrayCell, phase: Lanes, period_px: float
    ) -> tuple[Lanes, Lanes]:
        """Order nearest the Gray cell, and how much of the margin beside the cell the phase takes: 0.5 for all of it."""
        dr, real = self.device.dr, self.device.types.Float
        turns = cell.centre_px * (1.0 / period_px) - phase * (1.0 / unwrap.TURN)
        whole = dr.round(turns)
        margin = max(0.5 - 0.5 * self.plan.gray[axis].cell_px / period_px, 1e-3)
        outside = dr.abs(turns - whole) - cell.width_px * (0.5 / period_px)
        residual = dr.maximum(outside, 0.0) * (0.5 / margin)
        known = cell.sure & (cell.width_px <= period_px * 1.001) & self._in_field(axis, cell)
        return self.device.types.Int32(whole), dr.select(known, residual, real(1.0))

    def _in_field(self, axis: Axis, cell: gray.GrayCell) -> Lanes:
        """Where the code names a cell the projector has."""
        field = self.plan.field_px(axis)
        return cell.centre_px - 0.5 * cell.width_px < (field if np.isfinite(field) else 1e9)

    def _coded(self, axis: Axis, cell: gray.GrayCell) -> _Decoded:
        """An axis of Gray code alone: the cell's middle, as a phase of the cell's width."""
        dr, types = self.device.dr, self.device.types
        period = self.plan.gray[axis].cell_px
        turns = cell.centre_px * (1.0 / period)
        order = dr.round(turns)
        wrapped_rad = (turns - order) * unwrap.TURN
        known = cell.sure & self._in_field(axis, cell)
        phasor = Phasor(
            cosine=cell.contrast,
            sine=types.Float(0.0),
            offset=cell.offset,
            variance_rad2=cell.contrast_variance,
            usable=types.Bool(True),
            exposure=cell.exposure,
        )
        mismatch = dr.select(known, types.Float(0.0), types.Float(1.0))
        # (-0.5, 0.5] turns of rounding become [-0.5, 0.5)
        edge = wrapped_rad >= float(np.float32(np.pi))
        return _Decoded(
            period,
            phasor,
            dr.select(edge, -float(np.float32(np.pi)), wrapped_rad),
            types.Int32(dr.select(edge, order + 1.0, order)),
            [mismatch],
            phasor.usable,
            cell.width_px * float(np.sqrt(1.0 / 12.0)),
        )

    @property
    def _whole_numbers(self) -> bool:
        return bool(np.issubdtype(self.plan.stack.frames.dtype, np.integer))

    def _not_a_number(self, phasors: list[Phasor]) -> Lanes | None:
        """Where samples are NaN or infinite and the rule found no way around; None where none can be."""
        if self._whole_numbers:
            return None
        lost = self.device.types.Bool(False)
        for phasor in phasors:
            lost = lost | ~self.device.dr.isfinite(phasor.offset)
        return lost

    def _samples(self, fringes: FringeSet, at: Lanes | None = None) -> fusion.Samples:
        """Samples of the pixels with flat indices `at`; None: of the whole image."""
        stack = self.plan.stack
        reject = self.plan.options.saturation == "reject"
        return fusion.Samples(
            device=self.device,
            fringes=fringes,
            dn=tuple(
                tuple(self.device.plane(exposure[k], at) for k in fringes.frames)
                for exposure in stack.frames
            ),
            exposure_ms=stack.exposure_ms,
            black_level_dn=stack.sensor.black_level_dn,
            saturation_dn=stack.saturation_dn if reject else float("inf"),
            whole=self._whole_numbers,
            noise=tuple(stack.sensor.noise_model(ms) for ms in stack.exposure_ms),
        )

    def _modulation(self, phasor: Phasor) -> Lanes:
        return self.device.root(phasor.cosine * phasor.cosine + phasor.sine * phasor.sine)

    def _height(self, solver: Solver, measured: _Decoded) -> tuple[Lanes, Lanes]:
        """Height and its predicted standard deviation, float32."""
        dr, real = self.device.dr, self.device.types.Float
        period = measured.period_px
        at = unwrap.coordinate(self.device, measured.wrapped_rad, measured.order, period)
        height, slope = solver.height(at)
        return real(height), measured.sigma_px * dr.abs(real(slope))

    def _expected(self, axis: Axis, field: bool) -> Lanes:
        """Coordinate in the middle of what each pixel can show, float32."""
        real = self.device.types.Float
        if field:
            return real(self.plan.field_px(axis) / 2.0)
        locator, volume = self.plan.locator(axis), self.plan.volume_mm
        assert locator is not None and volume is not None  # the plan saw that they are there
        return real(locator.bind(self.pixels.coarse()).coordinate(sum(volume) / 2.0))

    def _scanned(self, axis: Axis, fringes: FringeSet, phasor: Phasor, phase: Lanes) -> Lanes:
        """Orders from a scan of the whole image, on the host."""
        dr, types = self.device.dr, self.device.types
        # dim and clipped pixels still lead the scan on; only those without a fringe mislead it
        fringe = phasor.variance_rad2 < validity.NO_FRINGE_RAD2
        good = types.UInt8(dr.select(fringe, types.UInt32(1), types.UInt32(0)))
        dr.eval(phase, good)
        image, mask = self._host(phase), self._host(good) > 0
        guided = self.plan.ways[axis] == "quality-guided"
        scan: Callable[..., unwrap.Orders] = unwrap.quality_guided if guided else unwrap.row_scan
        orders = scan(image, mask)
        known = self.plan.levels(axis)
        if known is not None:
            pixelwise = self._axis(axis, known)
            turns = types.Float(pixelwise.order) + pixelwise.wrapped_rad * (1.0 / unwrap.TURN)
        elif self.plan.locator(axis) is not None:
            turns = self._expected(axis, field=False) * (1.0 / fringes.period_px)
        else:
            return types.Int32(orders.reshape(-1))
        orders = unwrap.level(orders, image, mask, self._host(turns), whole=not guided)
        return types.Int32(orders.reshape(-1))

    def _host(self, values: Lanes) -> NDArray[Any]:
        """Lanes as an image; one value for all of them is seen as one, and is read-only."""
        found = np.asarray(values.numpy())
        if found.size == 1:
            return np.broadcast_to(found, self.image)
        return found.reshape(self.image)
