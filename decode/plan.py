"""What to do with one projector's frames, decided on the host before any pixel is touched."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from decode import gamma
from decode.geometry import View, view_of
from decode.gray import GraySet, gray_sets
from decode.height import HeightModel, Linear, LinearisedRig, ReferencePlane, Triangulation
from decode.ladder import Rung, ladder, single
from decode.options import Options
from decode.phase import FringeSet, fringe_sets
from scenes.errors import DecodeError
from scenes.patterns import Axis
from scenes.stack import Stack

# Heights this fraction of the working volume outside it are still accepted: noise on its faces.
VOLUME_MARGIN = 0.05

Way = Literal["gray", "volume", "field", "spatial", "row-scan", "quality-guided"]
"""How an axis is unwrapped: the first four anchor temporal unwrapping."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Which axis measures height and how, and how each axis is unwrapped."""

    stack: Stack
    options: Options
    projector: int
    reference_px: NDArray[np.float64] | None = None
    """Measured coordinate of the reference plane (row, col)."""

    @cached_property
    def sets(self) -> dict[Axis, tuple[FringeSet, ...]]:
        """Fringe sets by axis, coarsest first; none where an axis has only Gray code.

        Raises `DecodeError` if the projector shows neither.
        """
        frames = self.stack.patterns
        sets = fringe_sets(frames, self.projector)
        for axis in self.gray:
            sets.setdefault(axis, ())
        if not sets:
            coded = {f.projector for f in frames if f.kind in ("fringe", "gray")}
            raise DecodeError(
                f"the stack has no fringes of projector {self.projector} and no Gray code: it has some of "
                f"{sorted(coded) or 'none'}"
            )
        return sets

    @cached_property
    def gray(self) -> dict[Axis, GraySet]:
        """Gray codes by axis."""
        return gray_sets(self.stack.patterns, self.projector)

    @cached_property
    def gamma(self) -> float | None:
        """The gamma to undo."""
        wanted = self.options.gamma
        if wanted == "estimate":
            return gamma.estimate(self.stack, self.projector)
        return None if wanted is None else float(wanted)

    @cached_property
    def view(self) -> View | None:
        """The calibrated rig, if there is one."""
        calibration = self.stack.calibration
        return None if calibration is None else view_of(calibration, self.projector)

    @cached_property
    def volume_mm(self) -> tuple[float, float] | None:
        """Heights that are accepted: the working volume and its margin; None if unknown."""
        heights = self.options.height_range_mm
        if heights is None and self.stack.calibration is not None:
            heights = self.stack.calibration.height_range_mm
        if heights is None:
            return None
        margin = VOLUME_MARGIN * (heights[1] - heights[0])
        return heights[0] - margin, heights[1] + margin

    @cached_property
    def axis(self) -> Axis:
        """The axis that measures height."""
        wanted = self.options.axis
        if wanted is not None:
            if wanted not in self.sets:
                raise DecodeError(f"the stack has no {wanted} fringes: it has {list(self.sets)}")
            return wanted
        if self.view is not None:
            return max(self.sets, key=self.view.sensitivity)
        return "column" if "column" in self.sets else "row"

    @cached_property
    def model(self) -> HeightModel | None:
        """The way to height; None for phases alone."""
        options, axis, view = self.options, self.axis, self.view
        kind = options.height
        if kind is None:
            kind = "linear" if options.c_px_per_mm is not None else "triangulation"
            if kind == "triangulation" and view is None:
                raise DecodeError(
                    "the stack has no calibration: give it one, or c_px_per_mm for linear heights, or "
                    "height='phase' for phases alone"
                )
        if kind == "phase":
            return None
        if kind == "reference-plane":
            return ReferencePlane(axis, view, self.reference_px, options.c_px_per_mm)
        if kind == "linear" and options.c_px_per_mm is not None:
            return Linear(options.c_px_per_mm, axis)
        if view is None:
            other = ", or c_px_per_mm" if kind == "linear" else ""
            raise DecodeError(f"{kind} needs a calibration: give the stack one{other}")
        return LinearisedRig(view, axis) if kind == "linear" else Triangulation(view, axis)

    def locator(self, axis: Axis) -> HeightModel | None:
        """What tells the coordinates to expect on an axis, if the heights to expect are known."""
        if self.volume_mm is None:
            return None
        if axis == self.axis and self.model is not None:
            return self.model
        return None if self.view is None else Triangulation(self.view, axis, measures=False)

    @cached_property
    def ways(self) -> dict[Axis, Way]:
        """How each axis is unwrapped. Raises `DecodeError` if it cannot be as asked."""
        return {axis: self._way(axis) for axis in self.sets}

    def levels(self, axis: Axis) -> Way | None:
        """What fixes orders pixel by pixel where the finest fringes are scanned, and so tells the scan's whole turns."""
        if self.ways[axis] not in ("row-scan", "quality-guided"):
            return None
        way = replace(self, options=replace(self.options, unwrap=None))._way(axis)
        return way if way in ("gray", "volume", "field") else None

    def rungs(self, axis: Axis, way: Way) -> tuple[Rung, ...]:
        """The phases that carry an axis' order down to its finest fringes."""
        periods = [fringes.period_px for fringes in self.sets[axis]]
        found = None
        if way == "gray" and periods:
            found = self._on_gray(axis)
        elif way == "field":
            found = ladder(periods, self.field_px(axis))
        elif way == "volume":
            found = ladder(periods, self.band_px(axis))
        return found or single(periods)

    def _on_gray(self, axis: Axis) -> tuple[Rung, ...] | None:
        periods = [fringes.period_px for fringes in self.sets[axis]]
        cell = self.gray[axis].cell_px * (1.0 - 1e-9)
        # twice the cell forgives an error of half a cell at its border
        return ladder(periods, 2.0 * cell) or ladder(periods, cell)

    def field_px(self, axis: Axis) -> float:
        """Size of the projector's image along an axis; infinite if unknown."""
        if self.view is None:
            return float("inf")
        projector = self.view.rig.projector
        return float(projector.width if axis == "column" else projector.height)

    def band_px(self, axis: Axis) -> float:
        """Largest range of coordinates that one pixel can show within the volume; infinite if unknown."""
        locator = self.locator(axis)
        if locator is None or self.volume_mm is None:
            return float("inf")
        return locator.band_px(self.volume_mm)

    def _way(self, axis: Axis) -> Way:
        wanted, anchor = self.options.unwrap, self.options.anchor
        periods = [fringes.period_px for fringes in self.sets[axis]]
        if not periods:
            if wanted in ("row-scan", "quality-guided") or anchor not in (None, "gray"):
                raise DecodeError(
                    f"the {axis}s have Gray code alone, which needs no unwrapping: leave out unwrap and anchor"
                )
            return "gray"
        if wanted in ("row-scan", "quality-guided"):
            return wanted
        why_not: dict[Way, str] = {
            "gray": self._no_gray(axis),
            "volume": self._no_volume(axis),
            "field": self._no_field(axis),
            "spatial": "",
        }
        if anchor is not None:
            if why_not[anchor]:
                raise DecodeError(f"anchor '{anchor}': {why_not[anchor]}")
            return anchor
        # a measured period that is wide enough goes before one that is only computed
        fits: tuple[tuple[Way, bool], ...] = (
            ("gray", True),
            ("volume", self.band_px(axis) < periods[0]),
            ("field", self.field_px(axis) <= periods[0]),
            ("volume", True),
            ("field", True),
        )
        for way, fit in fits:
            if fit and not why_not[way]:
                return way
        if len(periods) > 1:
            return "spatial"
        if wanted == "temporal":
            raise DecodeError(
                f"temporal unwrapping of a single {axis} period: {why_not['volume']}; and {why_not['field']}. "
                "Add a coarser period, or use unwrap='quality-guided'"
            )
        return "quality-guided"

    def _no_gray(self, axis: Axis) -> str:
        """Why the Gray code does not fix the order; empty if it does."""
        if axis not in self.gray:
            return f"the stack has no {axis} Gray code"
        if self._on_gray(axis) is None:
            return (
                f"a cell of the Gray code is {self.gray[axis].cell_px:g} px wide, more than the coarsest {axis} period of "
                f"{self.sets[axis][0].period_px:g} px or any beat of the periods: use cells of half a period"
            )
        return ""

    def _no_volume(self, axis: Axis) -> str:
        """Why heights do not fix the coarsest order; empty if they do."""
        if self.locator(axis) is None or self.volume_mm is None:
            return "the heights to expect are unknown (height_range_mm, with a calibration or c_px_per_mm)"
        periods = [fringes.period_px for fringes in self.sets[axis]]
        band = self.band_px(axis)
        if band < periods[0] or ladder(periods, band) is not None:
            return ""
        low, high = self.volume_mm
        return (
            f"heights from {low:g} to {high:g} mm shift the {axis} fringe by {band:.1f} px, "
            f"more than its coarsest period of {periods[0]:g} px"
        )

    def _no_field(self, axis: Axis) -> str:
        """Why the coarsest period alone is ambiguous; empty if it is not."""
        field = self.field_px(axis)
        periods = [fringes.period_px for fringes in self.sets[axis]]
        if np.isfinite(field) and ladder(periods, field) is not None:
            return ""
        return f"its coarsest period of {periods[0]:g} px is less than the projector's {field:g} px"
