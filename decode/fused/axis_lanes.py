"""One axis inside the kernel: from frames to wrapped phase and fringe order, as its plan says."""

from dataclasses import dataclass

import numpy as np

from decode.device import Device, Lanes
from decode.fused.axis_plan import AxisPlan
from decode.fusion.interface import FusionRule, Samples
from decode.height.models import Pixels
from decode.order import gray_cells, gray_order, spatial, temporal
from decode.phase import gamma
from decode.phase.n_step import TURN, FringeSet, Phasor, wrapped
from decode.validity.limits import NO_FRINGE_RAD2
from scenes.files.stack import Stack


@dataclass(frozen=True)
class AxisLanes:
    """One decoded axis, as lanes."""

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
    samples: Samples | None = None
    """Of the finest fringes; None for Gray code alone."""
    phasors: tuple[Phasor, ...] = ()
    """Of each period, coarsest first."""


@dataclass(frozen=True)
class AxisTracer:
    """Traces axes of one stack; it decides nothing that depends on the pixels' values."""

    device: Device
    stack: Stack
    pixels: Pixels
    rule: FusionRule
    gamma: float | None
    reject_saturated: bool

    def samples(self, fringes: FringeSet, at: Lanes | None = None) -> Samples:
        """Digital numbers of one fringe set by exposure and step, at flat pixel indices or of the whole image."""
        return Samples.of(self.device, self.stack, fringes, self.reject_saturated, at)

    def trace(self, plan: AxisPlan) -> AxisLanes:
        """One axis as lanes: phase in rad, order, and what limits their use; a scan runs on the host, everything else
        in the kernel.
        """
        device = self.device
        samples = [self.samples(fringes) for fringes in plan.sets]
        cell = None if plan.gray is None else self._cell(plan.gray, samples)
        if not samples:
            assert plan.gray is not None and cell is not None  # An axis has fringes or Gray code.
            return self._coded(plan, plan.gray, cell)
        phasors = [self.rule.fuse(taken) for taken in samples]
        phases = [self._phase(*pair) for pair in zip(plan.sets, phasors, strict=True)]
        lifted = [rung.phase(device, phases) for rung in plan.rungs]
        coarsest_px = plan.rungs[0].period_px
        residuals = []
        if plan.gray is not None and cell is not None:
            order, residual = gray_order.order_in_cell(
                device, plan.gray, cell, lifted[0], coarsest_px, plan.field_px
            )
            residuals.append(residual)
        elif plan.way in ("volume", "field"):
            expected = plan.expected_px(self.pixels)
            order = temporal.anchored(device, lifted[0], coarsest_px, expected)
        else:
            order = self._scanned(plan, phasors[0], phases[0])
        for upper, lower, coarse, fine in zip(
            plan.rungs, plan.rungs[1:], lifted, lifted[1:], strict=False
        ):
            ratio = upper.period_px / lower.period_px
            order, residual = temporal.climb(device, coarse, order, ratio, fine)
            residuals.append(residual)
        if plan.way == "field":
            turns = (
                plan.rungs[0].period_px / plan.sets[-1].period_px,
                plan.field_px / plan.sets[-1].period_px,
            )
            order = temporal.in_field(device, phases[-1], order, *turns)
        usable = phasors[0].usable
        for phasor in phasors[1:]:
            usable = usable & phasor.usable
        period = plan.sets[-1].period_px
        return AxisLanes(
            period,
            phasors[-1],
            phases[-1],
            order,
            residuals,
            usable,
            device.root(phasors[-1].variance_rad2) * (period / TURN),
            self._not_a_number(phasors),
            samples[-1],
            tuple(phasors),
        )

    def _cell(self, gray: gray_cells.GraySet, samples: list[Samples]) -> gray_cells.GrayCell:
        """The Gray cell of every pixel; where the code has no thresholds of its own, the fringes' offset is used."""
        offsets = None
        if samples:
            offsets = [samples[-1].phasor(e).offset for e in range(len(self.stack.exposure_ms))]
        return gray_cells.cells_of(
            self.device,
            gray,
            self.stack,
            self.device.plane,
            offsets,
            # Cells of half a fringe are many pixels wide, and the fringe checks the code.
            weak=0.0 if samples else gray_cells.WEAK,
        )

    def _coded(
        self, plan: AxisPlan, gray: gray_cells.GraySet, cell: gray_cells.GrayCell
    ) -> AxisLanes:
        coded = gray_order.coded_phase(self.device, gray, cell, plan.field_px)
        return AxisLanes(
            gray.cell_px,
            coded.phasor,
            coded.wrapped_rad,
            coded.order,
            [coded.mismatch],
            coded.phasor.usable,
            coded.sigma_px,
        )

    def _phase(self, fringes: FringeSet, phasor: Phasor) -> Lanes:
        """Wrapped phase, gamma undone."""
        phase = wrapped(self.device, phasor)
        if self.gamma is None:
            return phase
        return gamma.correct(self.device, phase, self.gamma, fringes)

    def _scanned(self, plan: AxisPlan, phasor: Phasor, phase: Lanes) -> Lanes:
        """Orders of the coarsest fringes that are read, from a scan."""
        expected = turns = None
        if plan.levelled_by is not None:
            known = self.trace(plan.levelled_by)
            turns = self.device.types.Float(known.order) + known.wrapped_rad * (1.0 / TURN)
        else:
            expected = plan.expected_px(self.pixels)
        if expected is not None:
            turns = expected * (1.0 / plan.sets[0].period_px)
        # Dim and clipped pixels still lead the scan on; only those without a fringe mislead it.
        fringe = phasor.variance_rad2 < NO_FRINGE_RAD2
        guided = plan.way == "quality-guided"
        return spatial.scanned(self.device, self.pixels.image, phase, fringe, guided, turns)

    def _not_a_number(self, phasors: list[Phasor]) -> Lanes | None:
        """Where samples are NaN or infinite and the rule found no way around; None where none can be."""
        if np.issubdtype(self.stack.frames.dtype, np.integer):
            return None
        lost = self.device.types.Bool(False)
        for phasor in phasors:
            lost = lost | ~self.device.dr.isfinite(phasor.offset)
        return lost
