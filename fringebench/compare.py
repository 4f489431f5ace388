"""High-dynamic-range strategies side by side: one transport, every strategy exposed and decoded from it, the same seeds."""

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np

import decode
import render
import scenes
from evaluation.bound import FringeLight, phase_bound_rad2
from evaluation.comparison import Comparison, Entry, Region, Repeat, summary
from evaluation.strategies import (
    BUDGETS,
    Budget,
    Capture,
    Level,
    Plan,
    Reference,
    Strategy,
    ladder,
    strategies,
)
from fringebench.light import figures
from fringebench.progress import Report, Steps
from scenes.errors import FringebenchError, ScoreError
from scenes.patterns import Axis

# Exposures a scene with one is given, relative to it.
LADDER = (0.25, 0.5, 1.0, 2.0)
# Pixels across a border mix two heights, which no strategy can help.
MARGIN_PX = 1
# An error of more than this part of the working volume's depth is an outlier.
OUTLIER_FRACTION = 0.02


def compare(
    scene: scenes.Scene,
    names: Sequence[str] | None = None,
    repeats: int = 5,
    seed: int = 0,
    steps: Steps | None = None,
) -> Comparison:
    """Compare strategies (None: all) on a scene at equal total exposure time and at equal frame count.

    Repeat r of every strategy has the noise of seed ``seed + r``. A scene with one exposure is given a ladder of four.
    A strategy that fails on this scene is listed with its reason.

    Raises `ScoreError` for an unknown strategy, fewer than one repeat or patterns that are no fringes, and the first
    strategy's own error if all fail.
    """
    if repeats < 1:
        raise ScoreError(f"repeats = {repeats}: needs at least 1, and 2 or more for intervals")
    chosen = strategies(names)
    if not isinstance(scene.patterns, scenes.PhaseShift):
        raise ScoreError(
            f"scene '{scene.name}' shows {scene.patterns.kind} patterns: strategies compare phase shifts; "
            "set patterns.kind to phase-shift"
        )
    shown = steps or Steps()
    with shown.step("trace light") as progress:
        bench = _Bench(scene, repeats, seed, progress)
    entries: list[Entry] = []
    left_out: list[tuple[str, str, str]] = []
    first: FringebenchError | None = None
    for plan, group in groupby(sorted(chosen, key=lambda s: s.plan.__name__), lambda s: s.plan):
        members = tuple(group)
        for budget in BUDGETS[:1] if plan is ladder else BUDGETS:
            with shown.step(f"{plan.__name__}, {budget}"):
                made, failed = bench.group(plan, members, budget)
            entries += made
            left_out += [(name, budget, str(error)) for name, error in failed]
            first = first or (failed[0][1] if failed else None)
    # the reference's own exposures use up either budget exactly
    entries += [replace(e, budget="equal-frames") for e in entries if e.plan == ladder.__name__]
    if not entries and first:
        raise first
    order = {strategy.name: i for i, strategy in enumerate(chosen)}
    entries.sort(key=lambda e: (BUDGETS.index(e.budget), order[e.name]))
    shot = bench.reference.shot
    return Comparison(
        scene.name,
        repeats,
        seed,
        MARGIN_PX,
        bench.outlier_mm,
        shot.frames(bench.reference.projectors),
        shot.light_ms(bench.reference.projectors),
        tuple(entries),
        tuple(left_out),
        figures(bench.transport),
    )


class _Bench:
    """The scene's light, its truth, and the acquisition that sets the budgets."""

    def __init__(self, scene: scenes.Scene, repeats: int, seed: int, progress: Report) -> None:
        self.scene, self.repeats, self.seed = scene, repeats, seed
        surfaces = render.surfaces(scene)
        self.transport = render.trace(scene, seed=seed, progress=progress, surfaces=surfaces)
        self.truth = render.truth(scene, self.transport, surfaces)
        times_ms = render.expose(self.transport, seed=seed, noise=False).exposure_ms
        if len(times_ms) == 1:
            times_ms = tuple(times_ms[0] * relative for relative in LADDER)
        patterns = scene.patterns
        assert isinstance(patterns, scenes.PhaseShift)
        self.reference = Reference(patterns, times_ms, len(scene.projectors))
        low, high = scene.height_range_mm
        self.outlier_mm = OUTLIER_FRACTION * (high - low)
        self.light: dict[str, FringeLight] = {}

    def group(
        self, plan: Plan, members: Sequence[Strategy], budget: Budget
    ) -> tuple[list[Entry], list[tuple[str, FringebenchError]]]:
        """Strategies that share their pictures."""
        kept: dict[str, list[Repeat]] = {s.name: [] for s in members}
        fastest: dict[str, float] = {}
        axes: dict[str, Axis] = {}
        failed: dict[str, FringebenchError] = {}
        capture: Capture | None = None
        for r in range(self.repeats):
            try:
                capture = plan(self._shoot(self.seed + r), self.reference, budget)
            except FringebenchError as error:
                return [], [(s.name, error) for s in members]
            for s in members:
                if s.name in failed:
                    continue
                start = time.perf_counter()
                try:
                    rec = decode.reconstruct(
                        capture.stack, fusion=s.fusion, saturation=s.saturation
                    )
                except FringebenchError as error:
                    failed[s.name] = error
                    continue
                spent = time.perf_counter() - start
                fastest[s.name] = min(fastest.get(s.name, spent), spent)
                axes[s.name] = rec.axis
                light = self._light(rec.axis)
                kept[s.name].append(Repeat.of(rec, self.truth, light, MARGIN_PX, self.outlier_mm))
        assert capture is not None
        entries = [
            Entry(
                s.name,
                budget,
                plan.__name__,
                s.fusion,
                s.source,
                capture.frames,
                capture.exposure_ms,
                fastest[s.name],
                self._regions(kept[s.name], capture, axes[s.name]),
            )
            for s in members
            if s.name not in failed
        ]
        return entries, list(failed.items())

    def _regions(
        self, repeats: Sequence[Repeat], capture: Capture, axis: Axis
    ) -> dict[str, Region]:
        shot = capture.shot
        finest = min(shot.patterns.periods_px)
        shifts = [
            f.phase_shift_rad
            for f in shot.patterns.frames()
            if f.axis == axis and f.period_px == finest and f.kind == "fringe"
        ]
        light = self._light(axis)
        bound = None
        if light is not None:
            bound = phase_bound_rad2(light, shifts, shot.times_ms, self.scene.sensor, shot.level)
        return summary(repeats, self.truth, bound, MARGIN_PX)

    def _light(self, axis: Axis) -> FringeLight | None:
        """The finest fringe's noise-free light; None of several projectors, whose pixels differ in which they took."""
        if self.reference.projectors > 1:
            return None
        if axis not in self.light:
            frames = self.reference.patterns.frames()
            finest = min(self.reference.patterns.periods_px)
            self.light[axis] = FringeLight.of(self.transport.frames(), frames, axis, finest)
        return self.light[axis]

    def _shoot(self, seed: int) -> Any:
        def shoot(
            patterns: scenes.PhaseShift, times_ms: Sequence[float], level: Level = 1.0
        ) -> scenes.Stack:
            light = self.transport
            if np.ndim(level) or level != 1.0:
                # all light a pixel gets from the projectors is dimmed; ambient light is not
                dim = np.asarray(level, np.float32)
                light = replace(light, total=light.total * dim, direct=light.direct * dim)
            return render.expose(light, seed=seed, exposures=times_ms, patterns=patterns)

        return shoot
