"""Stack to reconstruction: one fused kernel that reads the frames once (two when orders come from a spatial scan)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode import fusion, unwrap, validity
from decode.device import Device, Lanes
from decode.geometry import View
from decode.height import (
    HeightModel,
    Linear,
    LinearisedRig,
    Pixels,
    ReferencePlane,
    Solver,
    Triangulation,
)
from decode.options import Options
from decode.phase import FringeSet, Phasor, fringe_sets, wrapped
from decode.reconstruction import AxisPhase, Reconstruction
from decode.validity import Limits, Reason
from scenes.errors import DecodeError
from scenes.patterns import Axis
from scenes.stack import Stack

# Heights this fraction of the working volume outside it are still accepted: noise on its faces.
VOLUME_MARGIN = 0.05


def reconstruct(stack: Stack, **choices: Any) -> Reconstruction:
    """Decode a stack into heights; the keywords are the fields of `Options`.

    Raises `DecodeError`, naming the cause, when a choice is impossible for this stack or no pixel can be decoded.

    >>> rec = reconstruct(stack, fusion="max-modulation", roi=(0, 100, 0, 200))  # doctest: +SKIP
    >>> rec.height_mm.shape == stack.frames.shape[2:]  # doctest: +SKIP
    True
    """
    options = Options.of(choices)
    _check(stack)
    projectors = sorted({frame.projector for frame in stack.patterns})
    if options.projector is not None:
        projectors = [options.projector]
    elif len(projectors) > 1 and options.height == "phase":
        raise DecodeError(
            f"phases of projectors {projectors} cannot be compared: choose one with projector="
        )
    rule = options.rule().prepare(stack)
    found = [_Projector(stack, options, index, rule).decode() for index in projectors]
    best = found[0]
    for other in found[1:]:
        best = _better(best, other)
    if not best.valid.any():
        shares = ", ".join(
            f"{name} {share:.1%}" for name, share in best.reason_fractions().items() if name != "ok"
        )
        raise DecodeError(
            f"no pixel could be decoded ({shares}): check exposure times, min_modulation_dn "
            f"({options.min_modulation_dn}), the patterns' order and the calibration"
        )
    return best


def _check(stack: Stack) -> None:
    if stack.calibration is not None:
        camera = stack.calibration.camera.projection()
        if (camera.width, camera.height) != stack.resolution:
            raise DecodeError(
                f"the calibration's camera is {camera.width} x {camera.height} pixels, the frames are "
                f"{stack.resolution[0]} x {stack.resolution[1]}: set calibrated_at and resolution to match"
            )


def _better(one: Reconstruction, two: Reconstruction) -> Reconstruction:
    """Per pixel the valid one with the smaller predicted sigma."""
    take = two.valid & (~one.valid | (two.sigma_mm < one.sigma_mm))
    images = ("height_mm", "sigma_mm", "modulation_dn", "offset_dn", "reason", "exposure")
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

    finest: FringeSet
    phasor: Phasor
    wrapped_rad: Lanes
    order: Lanes
    residuals: list[Lanes]
    usable: Lanes


class _Projector:
    """Decoding of one projector's frames: the plan on the host, then the kernel."""

    def __init__(
        self, stack: Stack, options: Options, projector: int, rule: fusion.FusionRule
    ) -> None:
        self.stack, self.options, self.rule = stack, options, rule
        self.projector = projector
        self.sets = fringe_sets(stack.patterns, projector)
        self.view = None if stack.calibration is None else View(stack.calibration, projector)
        self.heights_mm = options.height_range_mm or (
            stack.calibration.height_range_mm if stack.calibration else None
        )
        self.axis = self._axis()
        self.model = self._model()
        image = stack.frames.shape[2:]
        self.image: tuple[int, int] = (image[0], image[1])
        self.ways = {axis: self._way(axis) for axis in self.sets}
        # a spatial scan must see the whole image, or the region's orders would depend on the region
        spatial = any(
            way in ("spatial", "row-scan", "quality-guided") for way in self.ways.values()
        )
        box = options.box(self.image)
        self.pixels = Pixels(
            Device.open(options.backend),
            (0, self.image[0], 0, self.image[1]) if spatial else box,
            self.image,
        )

    # The plan

    def _axis(self) -> Axis:
        wanted = self.options.axis
        if wanted is not None:
            if wanted not in self.sets:
                raise DecodeError(f"the stack has no {wanted} fringes: it has {list(self.sets)}")
            return wanted
        if self.view is not None:
            return max(self.sets, key=self.view.sensitivity)
        return "column" if "column" in self.sets else "row"

    def _model(self) -> HeightModel | None:
        options, axis = self.options, self.axis
        kind = options.height
        if kind is None:
            if self.view is None and options.c_px_per_mm is None:
                raise DecodeError(
                    "the stack has no calibration: give it one, or c_px_per_mm for linear heights, or "
                    "height='phase' for phases alone"
                )
            kind = "linear" if options.c_px_per_mm is not None else "triangulation"
        if kind == "phase":
            return None
        if kind == "reference-plane":
            return ReferencePlane(axis, self.view, self._reference(), options.c_px_per_mm)
        if kind == "linear" and options.c_px_per_mm is not None:
            return Linear(options.c_px_per_mm, axis)
        if self.view is None:
            raise DecodeError(
                f"{kind} needs a calibration: give the stack one"
                + (", or c_px_per_mm" if kind == "linear" else "")
            )
        return (
            LinearisedRig(self.view, axis) if kind == "linear" else Triangulation(self.view, axis)
        )

    def _reference(self) -> NDArray[np.float64] | None:
        plane = self.options.reference
        if isinstance(plane, Stack):
            choices = {
                name: getattr(self.options, name)
                for name in (
                    "fusion",
                    "exposure",
                    "saturation",
                    "unwrap",
                    "min_modulation_dn",
                    "backend",
                )
            }
            plane = reconstruct(
                plane, **choices, height="phase", axis=self.axis, projector=self.projector
            )
        if plane is None:
            return None
        if self.axis not in plane.phases or plane.reason.shape != self.stack.frames.shape[2:]:
            raise DecodeError(
                f"the reference has phases of {list(plane.phases)} and shape {plane.reason.shape}; needed: "
                f"{self.axis}, {self.stack.frames.shape[2:]}"
            )
        return np.where(plane.valid, plane.phases[self.axis].coordinate_px, np.nan)

    def _locator(self, axis: Axis) -> HeightModel | None:
        """What tells the coordinates to expect on an axis, for heights known."""
        if self.heights_mm is None:
            return None
        if self.view is not None and not (axis == self.axis and self.model is not None):
            return Triangulation(self.view, axis)
        return self.model if axis == self.axis else None

    def _way(self, axis: Axis) -> str:
        """How this axis is unwrapped: volume, field or spatial (temporal ones), row-scan or quality-guided."""
        wanted, coarsest = self.options.unwrap, self.sets[axis][0].period_px
        if wanted in ("row-scan", "quality-guided"):
            return str(wanted)
        locator = self._locator(axis)
        possible = {
            "volume": locator is not None and locator.band_px(self._volume()) < coarsest,
            "field": self.view is not None and coarsest >= self._field_px(axis),
            "spatial": True,
        }
        if self.options.anchor is not None:
            if not possible[self.options.anchor]:
                raise DecodeError(self._why_not(self.options.anchor, axis, locator, coarsest))
            return self.options.anchor
        way = next(name for name, there in possible.items() if there)
        if way == "spatial" and len(self.sets[axis]) == 1:
            if wanted == "temporal":
                raise DecodeError(
                    f"temporal unwrapping of one {axis} period ({coarsest:g} px) needs a height range that shifts the "
                    "fringe by less than a period, or a period as wide as the projector: add a coarser period, or use "
                    "unwrap='quality-guided'"
                )
            return "quality-guided"
        return way

    def _why_not(
        self, anchor: str, axis: Axis, locator: HeightModel | None, coarsest: float
    ) -> str:
        if anchor == "volume" and locator is None:
            return "anchor 'volume' needs height_range_mm and a calibration or c_px_per_mm"
        if anchor == "volume" and locator is not None:
            return (
                f"anchor 'volume' is ambiguous: heights {self._volume()} mm shift the {axis} fringe by "
                f"{locator.band_px(self._volume()):.1f} px, more than the coarsest period of {coarsest:g} px"
            )
        return (
            f"anchor 'field' needs a calibration, and a {axis} period as wide as the projector; the coarsest is "
            f"{coarsest:g} px"
        )

    def _volume(self) -> tuple[float, float]:
        low, high = self.heights_mm or (-np.inf, np.inf)
        margin = VOLUME_MARGIN * (high - low)
        return low - margin, high + margin

    def _field_px(self, axis: Axis) -> float:
        if self.view is None:
            return float("inf")
        projector = self.view.rig.projector
        return float(projector.width if axis == "column" else projector.height)

    # The kernel

    def decode(self) -> Reconstruction:
        """Trace the kernel, run it, and lay its images into the whole frame."""
        device = self.pixels.device
        axes = {axis: self._decode_axis(axis) for axis in self.sets}
        measured = axes[self.axis]
        finest = measured.phasor
        modulation = device.dr.sqrt(finest.cosine**2 + finest.sine**2)
        height = sigma = None
        if self.model is not None:
            height, sigma = self._height(self.model.bind(self.pixels), measured)
        limits = replace(self._limits, heights_mm=self.heights_mm and self._volume())
        lanes: dict[str, Lanes] = {
            "modulation_dn": modulation,
            "offset_dn": finest.offset,
            "reason": validity.reasons(
                device, limits, finest, modulation, measured.usable, measured.residuals, height
            ),
            "exposure": device.types.UInt8(finest.exposure),
        }
        if height is not None:
            lanes |= {"height_mm": device.types.Float(height), "sigma_mm": sigma}
        for axis, decoded in axes.items():
            lanes[f"{axis}.wrapped"] = decoded.wrapped_rad
            lanes[f"{axis}.order"] = decoded.order
        device.dr.eval(list(lanes.values()))
        images = {name: self._image(name, values) for name, values in lanes.items()}
        return self._result(images)

    def _height(self, solver: Solver, measured: _Decoded) -> tuple[Lanes, Lanes]:
        dr, types = self.pixels.device.dr, self.pixels.device.types
        period = measured.finest.period_px
        at = unwrap.coordinate(self.pixels.device, measured.wrapped_rad, measured.order, period)
        height, slope = solver.height(at)
        px = dr.sqrt(measured.phasor.variance_rad2) * (period / unwrap.TURN)
        return height, px * dr.abs(types.Float(slope))

    @property
    def _limits(self) -> Limits:
        options = self.options
        return Limits(options.min_modulation_dn, options.max_order_residual, None)

    def _decode_axis(self, axis: Axis) -> _Decoded:
        device, sets = self.pixels.device, self.sets[axis]
        way = self.ways[axis]
        if way in ("row-scan", "quality-guided"):
            sets = sets[-1:]
        phasors = [self.rule.fuse(self._samples(fringes)) for fringes in sets]
        phases = [wrapped(device, phasor) for phasor in phasors]
        if way in ("volume", "field"):
            order = unwrap.anchored(device, phases[0], sets[0].period_px, self._expected(axis, way))
        else:
            order = self._spatial(axis, sets[0], phasors[0], phases[0])
        residuals = []
        for k in range(1, len(sets)):
            ratio = sets[k - 1].period_px / sets[k].period_px
            order, residual = unwrap.climb(device, phases[k - 1], order, ratio, phases[k])
            residuals.append(residual)
        usable = phasors[0].usable
        for phasor in phasors[1:]:
            usable = usable & phasor.usable
        return _Decoded(sets[-1], phasors[-1], phases[-1], order, residuals, usable)

    def _samples(self, fringes: FringeSet) -> fusion.Samples:
        stack, pixels = self.stack, self.pixels
        at = pixels.flat()
        reject = self.options.saturation == "reject"
        return fusion.Samples(
            device=pixels.device,
            fringes=fringes,
            dn=tuple(
                tuple(pixels.device.plane(exposure[k], at) for k in fringes.frames)
                for exposure in stack.frames
            ),
            exposure_ms=stack.exposure_ms,
            black_level_dn=stack.sensor.black_level_dn,
            saturation_dn=stack.saturation_dn if reject else float("inf"),
            noise=tuple(stack.sensor.noise_model(ms) for ms in stack.exposure_ms),
        )

    def _expected(self, axis: Axis, way: str) -> Lanes:
        """Coordinate in the middle of what each pixel can show."""
        if way == "field":
            return self.pixels.device.types.Float64(self._field_px(axis) / 2.0)
        locator = self._locator(axis)
        assert locator is not None  # `_way` chose volume because there is one
        solver = locator.bind(self.pixels)
        low, high = self._volume()
        return (solver.coordinate(low) + solver.coordinate(high)) * 0.5

    def _spatial(self, axis: Axis, fringes: FringeSet, phasor: Phasor, phase: Lanes) -> Lanes:
        """Orders from a scan of the whole image, on the host."""
        device, types = self.pixels.device, self.pixels.device.types
        modulation = device.dr.sqrt(phasor.cosine**2 + phasor.sine**2)
        good = types.UInt8(
            device.dr.select(
                validity.bright(self._limits, phasor, modulation) & phasor.usable,
                types.UInt32(1),
                types.UInt32(0),
            )
        )
        device.dr.eval(phase, good)
        image, mask = self._host(phase), self._host(good) > 0
        guided = self.ways[axis] == "quality-guided"
        scan: Callable[..., unwrap.Orders] = unwrap.quality_guided if guided else unwrap.row_scan
        orders = scan(image, mask)
        if self._locator(axis) is not None:
            turns = types.Float64(self._expected(axis, "volume") * (1.0 / fringes.period_px))
            orders = unwrap.level(orders, image, mask, self._host(turns), whole=not guided)
        return types.Int32(orders.reshape(-1))

    def _host(self, values: Lanes) -> NDArray[Any]:
        """Lanes as an image of the pixels decoded; one value for all of them is spread."""
        flat: NDArray[Any] = values.numpy()
        shape = self.pixels.shape
        return np.full(shape, flat[0]) if flat.size == 1 else flat.reshape(shape)

    def _image(self, name: str, values: Lanes) -> NDArray[Any]:
        """Lanes as an image of the whole frame; outside the region of interest NaN, 0 or `OUTSIDE_ROI`."""
        part = self._host(values)
        roi = self.options.roi
        if roi is None:
            return part
        fill = {"reason": int(Reason.OUTSIDE_ROI), "exposure": fusion.MERGED}.get(
            name, np.nan if part.dtype == np.float32 else 0
        )
        row0, row1, col0, col1 = self.pixels.box
        whole = np.full(self.image, fill, part.dtype)
        whole[row0:row1, col0:col1] = part
        inside = np.zeros(self.image, np.bool_)
        if isinstance(roi, np.ndarray):
            inside = roi
        else:
            row0, row1, col0, col1 = self.options.box(self.image)
            inside[row0:row1, col0:col1] = True
        whole[~inside] = fill
        return whole

    def _result(self, images: dict[str, NDArray[Any]]) -> Reconstruction:
        nothing = np.full(self.image, np.nan, np.float32) if self.model is None else None
        options = self.options
        return Reconstruction(
            height_mm=images.get("height_mm", nothing),
            sigma_mm=images.get("sigma_mm", nothing),
            modulation_dn=images["modulation_dn"],
            offset_dn=images["offset_dn"],
            reason=images["reason"],
            exposure=images["exposure"],
            axis=self.axis,
            phases={
                axis: AxisPhase(
                    sets[-1].period_px, images[f"{axis}.wrapped"], images[f"{axis}.order"]
                )
                for axis, sets in self.sets.items()
            },
            calibration=self.stack.calibration,
            settings={
                "fusion": options.fusion
                if isinstance(options.fusion, str)
                else type(options.fusion).__name__,
                "saturation": options.saturation,
                "unwrap": self.ways[self.axis],
                "height": "phase" if self.model is None else type(self.model).__name__,
                "min_modulation_dn": options.min_modulation_dn,
                "max_order_residual": options.max_order_residual,
            },
        )
