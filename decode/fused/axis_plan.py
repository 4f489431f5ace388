"""How one projector axis is decoded, resolved: which frames are read, and what fixes the fringe order."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from decode.device import Lanes
from decode.height.models import HeightModel, Pixels
from decode.options import Anchor, Options, Unwrap
from decode.order.gray_cells import GraySet
from decode.order.heterodyne import Rung, ladder, single, widest_px
from decode.phase.n_step import FringeSet
from scenes.acquisition.patterns import Axis
from scenes.support.errors import DecodeError

Way = Literal["gray", "volume", "field", "spatial", "row-scan", "quality-guided"]
"""How an axis is unwrapped: the first four anchor temporal unwrapping."""
SCANS: tuple[Way, ...] = ("row-scan", "quality-guided")
ABSOLUTE: tuple[Anchor, ...] = ("gray", "volume", "field")


@dataclass(frozen=True, eq=False)
class AxisPlan:
    """One axis, with every choice made: a kernel only executes it."""

    axis: Axis
    way: Way
    sets: tuple[FringeSet, ...]
    """Fringe sets that are read, coarsest first; empty where the axis has Gray code alone."""
    rungs: tuple[Rung, ...]
    """Phases that carry the order from the coarsest to the finest fringes."""
    gray: GraySet | None
    """The Gray code that anchors the order."""
    field_px: float
    """Size of the projector's image along the axis; infinite if unknown."""
    middle: tuple[HeightModel, float] | None
    """A height model and the height in mm, mid-volume, whose coordinate each pixel is expected to show."""
    levelled_by: "AxisPlan | None" = None
    """What fixes the whole turns of a scan pixel by pixel, if anything does."""

    @property
    def anchor(self) -> Anchor:
        """What fixes the order, or the whole turns of a scan; spatial: nothing measured."""
        way = self.way if self.levelled_by is None else self.levelled_by.way
        return next((anchor for anchor in ABSOLUTE if anchor == way), "spatial")

    @property
    def order_known(self) -> bool:
        """Whether something measured fixes the order; else it is known only up to whole turns."""
        return self.way in ABSOLUTE or self.levelled_by is not None

    def expected_px(self, pixels: Pixels) -> Lanes | None:
        """Coordinate in px in the middle of what each pixel can show, float32 lanes; None if nothing is known."""
        real = pixels.device.types.Float
        if self.way == "field":
            return real(self.field_px / 2.0)
        if self.middle is None:
            return None
        locator, height_mm = self.middle
        return real(locator.bind(pixels.coarse()).coordinate(height_mm))


@dataclass(frozen=True, eq=False)
class AxisOffer:
    """What a stack offers to fix one axis' fringe order, from which `resolve` makes an `AxisPlan`."""

    axis: Axis
    sets: tuple[FringeSet, ...]
    gray: GraySet | None
    field_px: float
    locator: HeightModel | None
    """Height model that gives the expected coordinates; None if the expected heights are unknown."""
    volume_mm: tuple[float, float] | None

    @property
    def periods_px(self) -> Sequence[float]:
        """Measured periods, coarsest first."""
        return [fringes.period_px for fringes in self.sets]

    def resolve(self, options: Options) -> AxisPlan:
        """The plan that the options ask for. Raises `DecodeError` if it is impossible."""
        way = self._way(options.unwrap, options.anchor)
        if way not in SCANS:
            return self._plan(way, self.sets)
        pixelwise = self._way(None, options.anchor)
        known = pixelwise in ABSOLUTE
        return self._plan(way, self.sets[-1:], self._plan(pixelwise, self.sets) if known else None)

    def _plan(
        self, way: Way, sets: tuple[FringeSet, ...], levelled_by: AxisPlan | None = None
    ) -> AxisPlan:
        middle = None
        if self.locator is not None and self.volume_mm is not None:
            middle = self.locator, sum(self.volume_mm) / 2.0
        return AxisPlan(
            self.axis,
            way,
            sets,
            self._rungs(way, [fringes.period_px for fringes in sets]),
            self.gray if way == "gray" else None,
            self.field_px,
            middle,
            levelled_by,
        )

    def _rungs(self, way: Way, periods: Sequence[float]) -> tuple[Rung, ...]:
        found = None
        if way == "gray" and periods:
            found = self._on_gray()
        elif way == "field":
            found = ladder(periods, self._centres_px)
        elif way == "volume":
            found = ladder(periods, self.band_px)
        return found or single(periods)

    @property
    def band_px(self) -> float:
        """Largest range of coordinates that one pixel can show within the volume; infinite if unknown."""
        if self.locator is None or self.volume_mm is None:
            return float("inf")
        return self.locator.band_px(self.volume_mm)

    @property
    def _centres_px(self) -> float:
        """Range of the projector's pixel centres, over which a coordinate must be unique."""
        return self.field_px - 1.0

    def _on_gray(self) -> tuple[Rung, ...] | None:
        assert self.gray is not None
        cell = self.gray.cell_px * (1.0 - 1e-9)
        # Twice the cell forgives an error of half a cell at its border.
        return ladder(self.periods_px, 2.0 * cell) or ladder(self.periods_px, cell)

    def _way(self, wanted: Unwrap | None, anchor: Anchor | None) -> Way:
        if not self.sets:
            if wanted in SCANS or anchor not in (None, "gray"):
                raise DecodeError(
                    f"the {self.axis}s have Gray code alone, which needs no unwrapping: leave out unwrap and anchor"
                )
            assert self.gray is not None  # An axis has fringes or Gray code.
            ambiguity = self.gray.ambiguity(self.field_px)
            if anchor is None and ambiguity:
                raise DecodeError(f"{ambiguity}, or accept it with anchor='gray'")
            return "gray"
        if wanted is not None and wanted != "temporal":
            return wanted
        if anchor is not None:
            why_not = self._coarse_gray() if anchor == "gray" else self._why_not(anchor)
            if why_not:
                raise DecodeError(f"anchor '{anchor}': {why_not}")
            return anchor
        way = self._best_way()
        if way == "quality-guided" and wanted == "temporal":
            raise DecodeError(
                f"temporal unwrapping of a single {self.axis} period: {self._no_volume()}; and {self._no_field()}. "
                "Add a coarser period, or use unwrap='quality-guided'"
            )
        return way

    def _best_way(self) -> Way:
        """The first way that is unambiguous, else a scan."""
        # A measured period that is wide enough goes before one that is only computed.
        fits: tuple[tuple[Anchor, bool], ...] = (
            ("gray", True),
            ("volume", self.band_px < self.periods_px[0]),
            ("field", self._centres_px <= self.periods_px[0]),
            ("volume", True),
            ("field", True),
        )
        for way, fit in fits:
            if fit and not self._why_not(way):
                return way
        return "spatial" if len(self.sets) > 1 else "quality-guided"

    def _why_not(self, anchor: Anchor) -> str:
        """Why an anchor does not fix the order; empty if it does."""
        reasons = {"gray": self._no_gray, "volume": self._no_volume, "field": self._no_field}
        return reasons[anchor]() if anchor in reasons else ""

    def _no_gray(self) -> str:
        return self._coarse_gray() or (self.gray.ambiguity(self.field_px) if self.gray else "")

    def _coarse_gray(self) -> str:
        """Why a cell is too wide to give the fringe order; empty if it is not."""
        if self.gray is None:
            return f"the stack has no {self.axis} Gray code"
        if self._on_gray() is None:
            return (
                f"a cell of the Gray code is {self.gray.cell_px:g} px wide, more than the coarsest {self.axis} period of "
                f"{self.periods_px[0]:g} px or any beat of the periods: use cells of half a period"
            )
        return ""

    def _no_volume(self) -> str:
        if self.locator is None or self.volume_mm is None:
            return "the heights to expect are unknown (height_range_mm, with a calibration or c_px_per_mm)"
        coarsest, band = self.periods_px[0], self.band_px
        if band < coarsest or ladder(self.periods_px, band) is not None:
            return ""
        low, high = self.volume_mm
        return (
            f"heights from {low:g} to {high:g} mm shift the {self.axis} fringe by {band:.1f} px, "
            f"more than its coarsest period of {coarsest:g} px"
        )

    def _no_field(self) -> str:
        if np.isinf(self.field_px):
            return "the projector's size is unknown: give projector_resolution or a calibration"
        if ladder(self.periods_px, self._centres_px) is not None:
            return ""
        return (
            f"its coarsest period of {self.periods_px[0]:g} px is less than the projector's {self.field_px:g} px"
            + (
                f", and its periods together are unique over {widest_px(self.periods_px):.5g} px at most"
                if len(self.sets) > 1
                else ""
            )
        )
