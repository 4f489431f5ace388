"""Comparison of HDR strategies: one transport, from which every strategy is exposed and decoded with the same seeds."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

import render
import scenes
from decode import Reconstruction
from evaluation.hdr.capture_strategies import CapturePlan, PlannedCapture, Strategy, ladder
from evaluation.hdr.coding_strategies import Coding
from evaluation.hdr.comparison import (
    Repeat,
    StrategyComparison,
    StrategyRegion,
    StrategyResult,
    summary,
)
from evaluation.hdr.light_budget import BUDGETS, LightBudget, Reference, Shoot, Shot
from evaluation.hdr.strategy_lookup import strategies
from evaluation.theory.cramer_rao import FringeLight, phase_bound_rad2
from fringebench.experiments.noise_summary import figures
from fringebench.gate.decoders import Decoder
from fringebench.progress import StepProgress, Steps
from render.projector.masks import masked
from render.projector.pattern_span import channel_weights
from scenes.acquisition.patterns import Axis, Frame, Patterns
from scenes.support.errors import FringebenchError, ScoreError

# Exposure times given to a scene with a single exposure, relative to it.
LADDER = (0.25, 0.5, 1.0, 2.0)
# Shares of the reference's cycle time that a sweep gives each strategy.
SHARES = (0.25, 0.5, 1.0, 2.0, 4.0)
# Pixels on a border see two heights; no strategy can avoid that.
MARGIN_PX = 1
# An error above this fraction of the depth of the working volume is an outlier.
OUTLIER_FRACTION = 0.02


def compare(
    scene: scenes.Scene,
    names: Sequence[str] | None = None,
    repeats: int = 5,
    seed: int = 0,
    steps: Steps | None = None,
    budgets: Sequence[LightBudget] = BUDGETS[:2],
    pareto: bool = False,
    decoders: Sequence[Strategy] = (),
) -> StrategyComparison:
    """Compare strategies (None: all), and `decoders`, on a scene under each budget.

    Repeat r of every strategy has the noise of seed ``seed + r``. A scene with one exposure is given four. With `pareto`, every
    strategy is also given several shares of the reference's cycle time. A strategy that fails on this scene or does not fit a
    budget is listed with its reason.

    Raises `ScoreError` for an unknown strategy, fewer than one repeat or patterns that are no fringes, and the first
    strategy's own error if all fail.
    """
    if repeats < 1:
        raise ScoreError(f"repeats = {repeats}: needs at least 1, and 2 or more for intervals")
    scene.calibration().require_projectors("a comparison of strategies")
    chosen = (*strategies(names), *decoders)
    if not isinstance(scene.patterns, scenes.PhaseShift):
        raise ScoreError(
            f"scene '{scene.name}' shows {scene.patterns.kind} patterns: strategies compare phase shifts; "
            "set patterns.kind to phase-shift"
        )
    shown = steps or Steps()
    with shown.step("trace light") as progress:
        bench = _Bench(scene, repeats, seed, progress, chosen)
    left_out: list[tuple[str, str, str]] = []
    first: list[FringebenchError] = []
    order = {strategy.name: i for i, strategy in enumerate(chosen)}

    def under(budget: LightBudget, share: float = 1.0) -> list[StrategyResult]:
        entries: list[StrategyResult] = []
        name = budget if share == 1.0 else f"{budget} x {share:g}"
        for plan, group in groupby(sorted(chosen, key=lambda s: s.plan.__name__), lambda s: s.plan):
            with shown.step(f"{plan.__name__}, {name}"):
                made, failed = bench.group(plan, tuple(group), budget, share)
            entries += made
            left_out.extend((who, name, str(error)) for who, error in failed)
            first.extend(error for _, error in failed)
        return sorted(entries, key=lambda e: order[e.name])

    entries = [entry for budget in budgets for entry in under(budget)]
    sweep = [entry for share in SHARES for entry in under("cycle-time", share)] if pareto else []
    if not entries and first:
        raise first[0]
    shot = bench.reference.shot
    return StrategyComparison(
        scene.name,
        repeats,
        seed,
        MARGIN_PX,
        bench.outlier_mm,
        {budget: bench.reference.cost(budget, shot) for budget in BUDGETS},
        tuple(entries),
        tuple(left_out),
        figures(bench.transport),
        tuple(sweep),
    )


def outside_strategy(decoder: Decoder, spec: str | Callable[[scenes.Stack], object]) -> Strategy:
    """A whole decoder on the reference's exposures, under the name that it was given."""

    def decoded(stack: scenes.Stack) -> Reconstruction:
        answer = decoder(stack)
        rec = Reconstruction.of_heights(answer.height_mm, calibration=stack.calibration)
        if answer.sigma_mm is None:
            return rec
        return replace(rec, sigma_mm=answer.sigma_mm.astype(np.float32))

    name = spec if isinstance(spec, str) else getattr(spec, "__qualname__", type(spec).__name__)
    return Strategy(name, ladder, "", "a decoder from outside", decoder=decoded)


class _Bench:
    """The scene's light, its truth, and the acquisition that sets the budgets."""

    def __init__(
        self,
        scene: scenes.Scene,
        repeats: int,
        seed: int,
        progress: StepProgress,
        chosen: Sequence[Strategy],
    ) -> None:
        self.scene, self.repeats, self.seed = scene, repeats, seed
        patterns, machine = scene.patterns, scene.acquisition
        assert isinstance(patterns, scenes.PhaseShift)
        size = scene.projectors[0].resolution
        reference = Reference(
            patterns,
            (1.0,),
            len(scene.projectors),
            machine.overhead_ms,
            machine.min_exposure_ms,
            size[("column", "row").index(patterns.axes[0])],
        )
        # Light for the patterns of every coding; each is then a part of what was traced.
        shown = [s.plan.patterns(reference) for s in chosen if isinstance(s.plan, Coding)]
        others = tuple(p for p in shown if p != patterns)
        traced = scene
        if others:
            series = scenes.PatternSeries.model_construct(parts=(patterns, *others))
            traced = scene.model_copy(update={"patterns": series})
        surfaces = render.surfaces(scene)
        self.transport = render.trace(traced, seed=seed, progress=progress, surfaces=surfaces)
        self.truth = render.truth(scene, self.transport, surfaces)
        plain = render.expose(self.transport, seed=seed, patterns=patterns, noise=False)
        times_ms = plain.exposure_ms
        if len(times_ms) == 1:
            times_ms = tuple(times_ms[0] * relative for relative in LADDER)
        self.reference = replace(reference, times_ms=times_ms)
        low, high = scene.height_range_mm
        self.outlier_mm = OUTLIER_FRACTION * (high - low)
        self.light: dict[tuple[Axis, float], FringeLight] = {}
        self.done: list[StrategyResult] = []

    def group(
        self, plan: CapturePlan, members: Sequence[Strategy], budget: LightBudget, share: float
    ) -> tuple[list[StrategyResult], list[tuple[str, FringebenchError]]]:
        """Strategies that share their pictures."""
        if plan is ladder and share == 1.0:
            # The reference's own exposures use every budget exactly.
            done = [e for e in self.done if e.name in {s.name for s in members}]
            if done:
                return [replace(e, budget=budget) for e in done], []
        reference = replace(self.reference, share=share)
        kept: dict[str, list[Repeat]] = {s.name: [] for s in members}
        fastest: dict[str, float] = {}
        axes: dict[str, Axis] = {}
        failed: dict[str, FringebenchError] = {}
        capture: PlannedCapture | None = None
        for r in range(self.repeats):
            try:
                capture = plan(self._shoot(self.seed + r), reference, budget)
            except FringebenchError as error:
                return [], [(s.name, error) for s in members]
            for s in members:
                if s.name in failed:
                    continue
                start = time.perf_counter()
                try:
                    rec = s.reconstruct(capture.stack)
                except FringebenchError as error:
                    failed[s.name] = error
                    continue
                spent = time.perf_counter() - start
                fastest[s.name] = min(fastest.get(s.name, spent), spent)
                axes[s.name] = rec.axis
                light = self._light(rec.axis, capture.shot)
                kept[s.name].append(Repeat.of(rec, self.truth, light, MARGIN_PX, self.outlier_mm))
        assert capture is not None
        entries = [
            StrategyResult(
                s.name,
                budget,
                plan.__name__,
                s.decoded_by,
                s.source,
                capture.frames,
                capture.exposure_ms,
                capture.cycle_ms,
                fastest[s.name],
                self._regions(kept[s.name], capture, axes[s.name]),
                share,
            )
            for s in members
            if s.name not in failed
        ]
        if plan is ladder and share == 1.0:
            self.done = entries
        return entries, list(failed.items())

    def _regions(
        self, repeats: Sequence[Repeat], capture: PlannedCapture, axis: Axis
    ) -> dict[str, StrategyRegion]:
        shot = capture.shot
        light = self._light(axis, shot)
        bound = None
        if light is not None:
            shifts = [f.phase_shift_rad for f in _finest(shot.patterns, axis)]
            bound = phase_bound_rad2(light, shifts, shot.times_ms, self.scene.sensor, shot.levels)
        return summary(repeats, self.truth, bound, MARGIN_PX)

    def _light(self, axis: Axis, shot: Shot) -> FringeLight | None:
        """Noise-free light of the finest fringe; None for several projectors, as pixels use different ones."""
        patterns = shot.patterns
        if self.reference.projectors > 1 or not isinstance(patterns, scenes.PhaseShift):
            return None
        finest = min(patterns.periods_px)
        if shot.masks or (axis, finest) not in self.light:
            seen = render.through_lens(self._lit(shot))
            weights = channel_weights(self.transport, 0, patterns)
            frames = np.tensordot(weights, seen.total[0, : weights.shape[1]], axes=1) + seen.ambient
            found = FringeLight.of(frames, patterns.frames(), axis, finest)
            if shot.masks:
                return found
            self.light[axis, finest] = found
        return self.light[axis, finest]

    def _lit(self, shot: Shot) -> render.Transport:
        """Light of the projectors that shine, through their masks."""
        light = self.transport
        if shot.masks:
            light = masked(light, self.truth, shot.masks)
        if shot.projectors is None:
            return light
        shining = slice(shot.projectors)
        scene = light.scene
        return replace(
            light,
            total=light.total[shining],
            direct=light.direct[shining],
            bases=light.bases[shining],
            noise_rad=None,
            amplitude_noise=None,
            noise_correlation=None,
            scene=scene.model_copy(update={"projectors": scene.projectors[shining]}),
        )

    def _shoot(self, seed: int) -> Shoot:
        def shoot(shot: Shot) -> scenes.Stack:
            light = self._lit(shot)

            def taken(level: float) -> scenes.Stack:
                # Projectors are dimmed; ambient light is not.
                dimmed = light
                if level != 1.0:
                    dim = np.float32(level)
                    dimmed = replace(light, total=light.total * dim, direct=light.direct * dim)
                return render.expose(
                    dimmed, seed=seed, exposures=shot.times_ms, patterns=shot.patterns
                )

            if not shot.levels:
                return taken(1.0)
            # All exposures at each level, of which one is kept: an exposure's noise depends on its number.
            stacks = [taken(level) for level in shot.levels]
            frames = np.stack([stack.frames[e] for e, stack in enumerate(stacks)])
            return replace(stacks[0], frames=frames)

        return shoot


def _finest(patterns: Patterns, axis: Axis) -> list[Frame]:
    fringes = [f for f in patterns.frames() if f.kind == "fringe" and f.axis == axis]
    finest = min(f.period_px for f in fringes)
    return [f for f in fringes if f.period_px == finest]
