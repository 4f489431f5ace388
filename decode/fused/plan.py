"""What to do with one projector's frames, decided on the host before any pixel is touched."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.fused.axis_plan import SCANS, AxisOffer, AxisPlan
from decode.height.calibrated_view import CalibratedView, view_of
from decode.height.models import HeightModel, Linear, LinearisedRig, ReferencePlane, Triangulation
from decode.options import Height, Options
from decode.order.gray_cells import GraySet, gray_sets
from decode.phase import gamma
from decode.phase.n_step import FringeSet, fringe_sets
from decode.reconstruction import ORDER_ABSOLUTE, ORDER_UP_TO_TURNS
from decode.validity.limits import ValidityLimits
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

# Heights this fraction of the working volume outside it are still accepted: noise on its faces.
VOLUME_MARGIN = 0.05


@dataclass(frozen=True, eq=False)
class DecodePlan:
    """One projector's frames, with every choice made: a kernel only executes it."""

    stack: Stack
    options: Options
    projector: int
    axes: tuple[AxisPlan, ...]
    axis: Axis
    """The axis that measures height."""
    model: HeightModel | None
    """The way to height; None for phases alone."""
    height: Height
    """The model's name."""
    gamma: float | None
    """Gamma to undo."""
    view: CalibratedView | None
    """The calibrated rig, if there is one."""
    limits: ValidityLimits

    @property
    def guessed(self) -> bool:
        """Whether heights would rest on a fringe order that nothing measured fixes, without having been asked for."""
        options = self.options
        asked = options.unwrap is not None or options.anchor is not None
        return (
            self.view is not None
            and self.model is not None
            and not (asked or self.measuring.order_known)
        )

    def resolved(self) -> dict[str, Any]:
        """What was chosen where the options left it open, in JSON's types."""
        axis = self.measuring
        return {
            "axis": self.axis,
            "height": self.height,
            "unwrap": axis.way if axis.way in SCANS else "temporal",
            "anchor": axis.anchor,
            "order": ORDER_ABSOLUTE if axis.order_known else ORDER_UP_TO_TURNS,
            "gamma": self.gamma,
        }

    @property
    def measuring(self) -> AxisPlan:
        """The plan of the axis that measures height."""
        return next(axis for axis in self.axes if axis.axis == self.axis)


@dataclass(frozen=True, eq=False)
class Planner:
    """Finds out what a stack offers, and makes the plan that the options ask for."""

    stack: Stack
    options: Options
    projector: int

    def plan(self, reference_px: NDArray[np.float64] | None = None) -> DecodePlan:
        """The plan that the options ask for; `DecodeError` where the stack does not offer it.

        `reference_px`: measured coordinate of the reference plane (row, col), NaN where unknown; None: the
        calibration's.
        """
        model = self._model(reference_px)
        options = self.options
        return DecodePlan(
            stack=self.stack,
            options=options,
            projector=self.projector,
            axes=tuple(self._offer(axis, model).resolve(options) for axis in self._sets),
            axis=self.axis,
            model=model,
            height=self._height,
            gamma=self._gamma(),
            view=self._view,
            limits=ValidityLimits(
                options.min_modulation_dn, options.max_order_residual, self._volume_mm
            ),
        )

    @cached_property
    def axis(self) -> Axis:
        """The axis that measures height."""
        wanted, sets = self.options.axis, self._sets
        if wanted is not None:
            if wanted not in sets:
                raise DecodeError(f"the stack has no {wanted} fringes: it has {list(sets)}")
            return wanted
        if self._view is not None:
            return max(sets, key=self._view.sensitivity)
        return "column" if "column" in sets else "row"

    @cached_property
    def _sets(self) -> dict[Axis, tuple[FringeSet, ...]]:
        """Fringe sets by axis, coarsest first; none where an axis has only Gray code."""
        frames = self.stack.patterns
        sets = fringe_sets(frames, self.projector)
        for axis in self._gray:
            sets.setdefault(axis, ())
        if not sets:
            coded = {f.projector for f in frames if f.kind in ("fringe", "gray")}
            raise DecodeError(
                f"the stack has no fringes of projector {self.projector} and no Gray code: it has some of "
                f"{sorted(coded) or 'none'}"
            )
        return sets

    @cached_property
    def _gray(self) -> dict[Axis, GraySet]:
        return gray_sets(self.stack.patterns, self.projector)

    def _gamma(self) -> float | None:
        wanted = self.options.gamma
        if wanted == "estimate":
            return gamma.estimate(self.stack, self.projector)
        wanted = self.stack.gamma if wanted is None else float(wanted)
        return None if wanted == 1.0 else wanted

    @cached_property
    def _view(self) -> CalibratedView | None:
        calibration = self.stack.calibration
        if calibration is None or calibration.screens:
            return None
        return view_of(calibration, self.projector)

    @cached_property
    def _volume_mm(self) -> tuple[float, float] | None:
        """Heights that are accepted: the working volume and its margin; None if unknown."""
        heights = self.options.height_range_mm
        if self.stack.calibration is not None and self.stack.calibration.screens:
            # A screen's coordinate says nothing of the height by itself.
            return None
        if heights is None and self.stack.calibration is not None:
            heights = self.stack.calibration.height_range_mm
        if heights is None:
            return None
        margin = VOLUME_MARGIN * (heights[1] - heights[0])
        return heights[0] - margin, heights[1] + margin

    @property
    def _height(self) -> Height:
        if self.options.height is not None:
            return self.options.height
        return "linear" if self.options.c_px_per_mm is not None else "triangulation"

    def _model(self, reference_px: NDArray[np.float64] | None) -> HeightModel | None:
        options, axis, view, kind = self.options, self.axis, self._view, self._height
        if options.height is None and kind == "triangulation" and view is None:
            raise DecodeError(
                "the stack has no calibration: give it one, or c_px_per_mm for linear heights, or "
                "height='phase' for phases alone"
            )
        if kind == "phase":
            return None
        if kind == "reference-plane":
            return ReferencePlane(axis, view, reference_px, options.c_px_per_mm)
        if kind == "linear" and options.c_px_per_mm is not None:
            return Linear(options.c_px_per_mm, axis)
        if view is None:
            other = ", or c_px_per_mm" if kind == "linear" else ""
            raise DecodeError(f"{kind} needs a calibration: give the stack one{other}")
        return LinearisedRig(view, axis) if kind == "linear" else Triangulation(view, axis)

    def _offer(self, axis: Axis, model: HeightModel | None) -> AxisOffer:
        return AxisOffer(
            axis,
            self._sets[axis],
            self._gray.get(axis),
            self._field_px(axis),
            self._locator(axis, model),
            self._volume_mm,
        )

    def _locator(self, axis: Axis, model: HeightModel | None) -> HeightModel | None:
        """Model that gives the expected coordinates of an axis; None if the expected heights are unknown."""
        if self._volume_mm is None:
            return None
        if axis == self.axis and model is not None:
            return model
        return None if self._view is None else Triangulation(self._view, axis, measures=False)

    def _field_px(self, axis: Axis) -> float:
        """Size of the projector's image along an axis; infinite if unknown."""
        size = self.stack.projector_size(self.projector)
        return float("inf") if size is None else float(size[0 if axis == "column" else 1])
