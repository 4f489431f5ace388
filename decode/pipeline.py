"""Stack to reconstruction: one fused kernel that reads the frames once (two when orders come from a spatial scan)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode import fusion, gamma, gray, shadow, unwrap, validity
from decode.device import Device, Lanes
from decode.geometry import view_of
from decode.height import Pixels, Solver
from decode.ladder import single
from decode.options import Options
from decode.phase import FringeSet, Phasor, wrapped
from decode.plan import Plan, Way
from decode.reconstruction import AxisPhase, Reconstruction
from decode.validity import Limits, Reason
from scenes.errors import DecodeError
from scenes.memory import room_for
from scenes.patterns import Axis
from scenes.stack import Stack

# What stands outside the region of interest; NaN or 0 in the other images.
OUTSIDE = {"reason": int(Reason.OUTSIDE_ROI), "exposure": fusion.MERGED}

# Memory per pixel of what comes out, as measured; frames are read in place.
PIXEL_BYTES = 24


def reconstruct(stack: Stack, **choices: Any) -> Reconstruction:
    """Decode a stack into heights; the keywords are the fields of `Options`.

    Raises `DecodeError`, naming the cause, when a choice is impossible for this stack or no pixel can be decoded, and
    `TooLargeError` for more pixels than memory holds.

    >>> rec = reconstruct(stack, fusion="max-modulation", roi=(0, 100, 0, 200))  # doctest: +SKIP
    >>> rec.height_mm.shape == stack.frames.shape[2:]  # doctest: +SKIP
    True
    """
    options = Options.of(choices)
    _check_size(stack)
    projectors = sorted({frame.projector for frame in stack.patterns})
    if options.projector is not None:
        projectors = [options.projector]
    elif len(projectors) > 1 and options.height == "phase":
        raise DecodeError(
            f"phases of projectors {projectors} cannot be compared: choose one with projector="
        )
    device = Device.open(options.backend)
    rule = options.rule().prepare(stack)
    best: Reconstruction | None = None
    for projector in projectors:
        plan = Plan(stack, options, projector)
        if options.height == "reference-plane":
            plan = replace(plan, reference_px=_reference_px(plan))
        columns, rows = stack.resolution
        with room_for(
            PIXEL_BYTES * columns * rows,
            f"decoding {columns} x {rows} pixels",
            "decode regions with roi, one after the other",
        ):
            found = _Kernel(plan, device, rule).decode()
        best = found if best is None else _better(best, found)
    assert best is not None  # a stack has at least one frame, so one projector
    # some pixels first, which settle it nearly always
    if best.reason[::16, ::16].min() != Reason.OK and best.reason.min() != Reason.OK:
        shares = ", ".join(
            f"{name} {share:.1%}" for name, share in best.reason_fractions().items() if name != "ok"
        )
        if (best.reason == Reason.NOT_A_NUMBER).any():
            shares += "; frames hold NaN or infinity, which are no digital numbers"
        raise DecodeError(
            f"no pixel could be decoded ({shares}): check exposure times, min_modulation_dn "
            f"({options.min_modulation_dn}), the patterns' order and the calibration"
        )
    return best


def _check_size(stack: Stack) -> None:
    if stack.calibration is not None:
        camera = view_of(stack.calibration, 0).rig.camera
        if (camera.width, camera.height) != stack.resolution:
            raise DecodeError(
                f"the calibration's camera is {camera.width} x {camera.height} pixels, the frames are "
                f"{stack.resolution[0]} x {stack.resolution[1]}: set calibrated_at and resolution to match"
            )


def _reference_px(plan: Plan) -> NDArray[np.float64] | None:
    """Coordinate (row, col) of the measured reference plane, NaN where it is invalid; None without one."""
    plane, options, shape = plan.options.reference, plan.options, plan.stack.frames.shape[2:]
    if plane is None:
        return None
    if isinstance(plane, Stack):
        kept = ("fusion", "exposure", "saturation", "unwrap", "min_modulation_dn", "backend")
        choices = {name: getattr(options, name) for name in kept}
        plane = reconstruct(
            plane, **choices, height="phase", axis=plan.axis, projector=plan.projector
        )
    if plan.axis not in plane.phases or plane.reason.shape != shape:
        raise DecodeError(
            f"the reference has phases of {list(plane.phases)} and shape {plane.reason.shape}; "
            f"needed: {plan.axis}, {shape}"
        )
    return np.where(plane.valid, plane.phases[plan.axis].coordinate_px, np.nan)


def _better(one: Reconstruction, two: Reconstruction) -> Reconstruction:
    """Per pixel the valid one with the smaller predicted sigma."""
    take = two.valid & (~one.valid | (two.sigma_mm < one.sigma_mm))
    images = (
        "height_mm",
        "sigma_mm",
        "modulation_dn",
        "offset_dn",
        "reason",
        "exposure",
        "projector",
    )
    phases = {
        axis: AxisPhase(
            phase.period_px,
            np.where(take, two.phases[axis].wrapped_rad, phase.wrapped_rad),
            np.where(take, two.phases[axis].order, phase.order),
        )
        for axis, phase in one.phases.items()
        if axis in two.phases and two.phases[axis].period_px == phase.period_px
    }
    merged = {name: np.where(take, getattr(two, name), getattr(one, name)) for name in images}
    return replace(one, phases=phases, **merged)


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
    least: float | None = None
    """`shadow.level` below which light is stray, if that can be told."""
    lit: Lanes | None = None
    """Where the light is the projector's own, as far as each pixel tells by itself."""


class _Kernel:
    """Traces and runs what a plan says."""

    def __init__(self, plan: Plan, device: Device, rule: fusion.FusionRule) -> None:
        self.plan, self.device, self.rule = plan, device, rule
        rows, columns = plan.stack.frames.shape[2:]
        self.image = (rows, columns)
        self.limits = Limits(
            plan.options.min_modulation_dn, plan.options.max_order_residual, plan.volume_mm
        )
        self.box = plan.options.box(self.image)
        # a scan must see the whole image, or the region's orders would depend on the region
        whole = (0, rows, 0, columns)
        self.pixels = Pixels(
            device, whole if plan.scans else self.box, self.image, device.types.Float64
        )

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
        images = self._images(lanes)
        reason = images["reason"]
        # the greatest code first: without the comparison's image, which costs a fifth of all decoding
        shadow_found = reason.max() >= Reason.SHADOW and (reason == Reason.SHADOW).any()
        # a region must not have other shadows than the image: what lies around it counts
        if measured.least and (plan.options.roi is not None or shadow_found):
            open_to_doubt = (reason != Reason.SATURATED) & (reason != Reason.NOT_A_NUMBER)
            open_to_doubt &= reason != Reason.OUTSIDE_ROI
            shade = self._shade(measured.least) & open_to_doubt
            images["reason"] = np.where(shade, np.uint8(Reason.SHADOW), reason)
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
        samples = [self._samples(fringes, self.pixels.flat()) for fringes in sets]
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

    def _lit(self, samples: fusion.Samples) -> tuple[float, Lanes] | tuple[()]:
        """Least light that is not stray, and where there is more; the image's typical light comes from a coarse grid,
        whatever the region.
        """
        fraction = self.plan.options.min_relative_modulation
        if not fraction:
            return ()
        types = self.device.types
        at = types.UInt32(shadow.grid(self.image))
        levels = shadow.level(self._samples(samples.fringes, at)).numpy()
        least = fraction * shadow.typical(levels)
        return least, shadow.level(samples) >= self.device.dr.opaque(types.Float, least)

    def _shade(self, least: float) -> NDArray[np.bool_]:
        """Where shadow is known by what borders on it, (row, col): of the whole image, whatever the region."""
        dr, types = self.device.dr, self.device.types
        samples = self._samples(self.plan.sets[self.plan.axis][-1], None)
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
        found, where = (lanes.numpy().reshape(self.image) for lanes in (levels, what))
        return shadow.borders(found, where == shadow.DARK, where == shadow.NOTHING, least)

    def _phase(self, fringes: FringeSet, phasor: Phasor) -> Lanes:
        """Wrapped phase, gamma undone."""
        phase = wrapped(self.device, phasor)
        power = self.plan.gamma
        return phase if power is None else gamma.correct(self.device, phase, power, fringes)

    def _cell(self, axis: Axis, samples: list[fusion.Samples]) -> gray.GrayCell:
        """The Gray cell of every pixel; where the code has no thresholds of its own, the fringes' offset serves."""
        stack, at = self.plan.stack, self.pixels.flat()
        offsets = None
        if samples:
            offsets = [samples[-1].phasor(e).offset for e in range(len(stack.exposure_ms))]
        return gray.decode(
            self.device,
            self.plan.gray[axis],
            stack,
            lambda image: self.device.plane(image, at),
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

    def _samples(self, fringes: FringeSet, at: Lanes | None) -> fusion.Samples:
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
        """Lanes as an image of the pixels decoded; one value for all of them is seen as one, and is read-only."""
        found = np.asarray(values.numpy())
        if found.size == 1:
            return np.broadcast_to(found, self.pixels.shape)
        return found.reshape(self.pixels.shape)

    def _images(self, lanes: dict[str, Lanes]) -> dict[str, NDArray[Any]]:
        """Lanes as images of the whole frame; outside the region of interest NaN, 0 or the code that says so.

        The frame is laid out by Dr.Jit, whose pool hands the same memory out again: fresh pages from the system would
        cost more time than decoding.
        """
        dr, roi = self.device.dr, self.plan.options.roi
        if roi is None:
            dr.eval(list(lanes.values()))
            return {name: self._host(values) for name, values in lanes.items()}
        inside = self._inside(roi)
        whole = {}
        for name, values in lanes.items():
            kind = type(values)
            fill = OUTSIDE.get(name, float("nan") if dr.is_float_v(kind) else 0)
            if self.pixels.whole:
                whole[name] = dr.select(inside, values, kind(fill))
            else:
                whole[name] = dr.full(kind, fill, self.image[0] * self.image[1])
                dr.scatter(whole[name], values, self.pixels.flat(), inside)
        dr.eval(list(whole.values()))
        return {name: values.numpy().reshape(self.image) for name, values in whole.items()}

    def _inside(self, roi: Any) -> Lanes:
        """Which of the decoded pixels are in the region of interest."""
        if isinstance(roi, np.ndarray):
            row0, row1, col0, col1 = self.pixels.box
            return self.device.plane(roi[row0:row1, col0:col1].astype(np.uint8)) > 0.5
        if not self.pixels.whole:
            return self.device.types.Bool(True)
        row0, row1, col0, col1 = self.box
        column, row = self.pixels.coarse().centres()
        return (row > row0) & (row < row1) & (column > col0) & (column < col1)
