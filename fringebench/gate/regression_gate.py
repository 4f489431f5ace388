"""The gate for decoders: run one over the cases, compare its figures with a baseline's, and say what got worse."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import decode
from evaluation.gate.regression import Figures, Margins, compare_with_baseline, measure
from fringebench.gate.baseline import Baseline, mostly_missing
from fringebench.gate.cached_light import chosen_folder
from fringebench.gate.cases import Case, fingerprint, plane_stack, scene_cases, suite, sweep
from fringebench.gate.decoders import TIMEOUT_S, Decoder, resolve
from fringebench.gate.error_maps import ErrorMaps, place, worst_pixels
from fringebench.gate.regression_result import Regression
from fringebench.progress import StepProgress, Steps
from scenes import Scene, Stack, load
from scenes.support.errors import FileError, FringebenchError, OutsideDecoderError

SEEDS = tuple(range(16))
CONFIDENCE = 0.95
OWN = "decode:reconstruct"


def regress(
    decoder: str | Callable[[Stack], Any],
    baseline: str | Path | None = None,
    *,
    scenes: Sequence[str | Path | Scene] = (),
    update: bool = False,
    force: bool = False,
    seeds: Sequence[int] = SEEDS,
    cases: Sequence[Case] | None = None,
    margins: Margins | None = None,
    confidence: float = CONFIDENCE,
    timeout_s: float = TIMEOUT_S,
    cache: str | Path | None = None,
    steps: Steps | None = None,
) -> Regression:
    """Run a decoder over the cases and compare its figures with a baseline.

    Parameters
    ----------
    decoder
        ``package.module:callable``, a command, or a callable: see `fringebench.gate.decoders.resolve`.
    baseline
        File of the figures to compare with. None: those shipped, of our own decoder; with `scenes`, our own decoder is run
        on them.
    scenes
        Judge on these scenes, such as the user's own rig and patterns, instead of the shipped cases.
    update
        Store the figures as the new baseline, unless the decoder got worse: a baseline that follows every decline guards
        nothing (delete the file to start again).
    force
        Store a baseline even if most regions are missing.
    seeds
        Seeds of the noise; each case is decoded once for each. At least three.
    cases
        Cases made before, by `suite` or `scene_cases`.
    margins
        By how much each figure may get worse.
    confidence
        One-sided confidence of each comparison.
    timeout_s
        Seconds that one stack may take.
    cache
        Folder in which the cases' light is kept between runs. None: that of the environment's ``FRINGEBENCH_CACHE``, if set.
    steps
        Progress shown to the user.

    Returns
    -------
    Regression
        Its `passed` says whether no figure got worse.

    Raises
    ------
    OutsideDecoderError
        When the decoder cannot be run or gives no heights, by its first stack, before any scene is rendered.
    FileError
        For a baseline that cannot be used.

    Examples
    --------
    The saturation sweep needs no rendering; a first run stores the baseline, the next one is compared with it:

    >>> import tempfile, fringebench as fb
    >>> from fringebench.gate.cases import sweep
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     choices = {"cases": [sweep()], "seeds": range(3), "force": True}
    ...     fb.regress("decode:reconstruct", folder + "/base.json", update=True, **choices).passed
    ...     fb.regress("decode:reconstruct", folder + "/base.json", **choices).passed
    True
    True
    """
    steps = steps or Steps()
    name = decoder if isinstance(decoder, str) else getattr(decoder, "__qualname__", repr(decoder))
    target = None if baseline is None else Path(baseline)
    if update and target is None:
        raise FileError("--update needs --baseline FILE to write to: the shipped one stays")
    loaded = [source if isinstance(source, Scene) else load(source) for source in scenes]
    for scene in loaded:
        scene.calibration().require_projectors("the gate")
    old = None
    if target is not None and (target.exists() or not update):
        old = Baseline.load(target)
    elif target is None and not loaded:
        old = Baseline.load(None)
    with resolve(decoder, timeout_s) as run:
        with steps.step("try the decoder"):
            _try(run, [plane_stack(scene) for scene in loaded] or [sweep().stack(seeds[0])])
        if cases is None:
            folder = chosen_folder(cache)
            cases = (
                scene_cases(loaded, steps, folder) if loaded else suite(steps=steps, cache=folder)
            )
        if old is not None:
            _same_cases(old, cases)
        figures, maps = _all_figures(cases, run, seeds, "decode", steps)
    if old is None and target is None:
        with resolve(decode.reconstruct) as own:
            own_figures, own_maps = _all_figures(cases, own, seeds, "compare", steps)
        old = Baseline(OWN, fingerprint(cases), own_figures, tuple(seeds), own_maps)
    new = Baseline(name, fingerprint(cases), figures, tuple(seeds), maps)
    if old is None:
        assert target is not None  # Otherwise there is something to compare with.
        _store(new, target, force)
        return Regression(name, f"{target} (new)", tuple(seeds), (), figures, True, maps=maps)
    rows = [
        row
        for case in cases
        for row in compare_with_baseline(
            case.name,
            figures[case.name],
            old.figures[case.name],
            case.mm_per_rad,
            margins or Margins(),
            confidence,
            paired=old.seeds == tuple(seeds),
        )
    ]
    failed = [row for row in rows if not row.comparison.passed]
    by_name = {case.name: case for case in cases}
    store = update and not failed
    if store:
        assert target is not None
        _store(new, target, force)
    return Regression(
        name,
        old.decoder if target is None else str(target),
        tuple(seeds),
        tuple(rows),
        figures,
        store,
        {
            (row.case, row.region, row.metric): place(
                by_name[row.case], row.region, maps[row.case].of_metric(row.metric)
            )
            for row in failed
        },
        maps,
        _old_maps(old, {row.case: by_name[row.case] for row in failed}, seeds),
        worst_pixels(by_name.values(), failed, maps, seeds[0]),
    )


def _try(run: Decoder, stacks: Sequence[Stack]) -> None:
    """Decode something made by formula, so that a decoder that cannot start fails before anything is rendered."""
    for stack in stacks:
        try:
            run(replace(stack, seed=None))
        except FringebenchError as error:
            raise OutsideDecoderError(f"first try: {error}") from error


def _same_cases(old: Baseline, cases: Sequence[Case]) -> None:
    """Raise `FileError` for a baseline of other cases."""
    missing = [case.name for case in cases if case.name not in old.figures]
    if missing:
        raise FileError(
            f"the baseline of '{old.decoder}' has no case {', '.join(missing)}, but {', '.join(old.figures)}: make one of "
            "these cases with --update and a new file"
        )
    if len(cases) == len(old.figures) and old.suite != fingerprint(cases):
        raise FileError(
            f"the baseline of '{old.decoder}' was made with other cases than this version or scene has: make it again with "
            "--update and a new file"
        )


def _store(new: Baseline, target: Path, force: bool) -> None:
    """Write a baseline; raises `FileError` for one in which most regions are missing, unless forced."""
    empty = mostly_missing(new.figures)
    regions = sum(len(case) for case in new.figures.values())
    if 2 * len(empty) > regions and not force:
        table = "\n".join(
            f"  {case} / {region}: {100 * share:.0f} % missing" for case, region, share in empty
        )
        raise FileError(
            f"not stored: in {len(empty)} of {regions} regions more than half of the pixels are missing, and such a baseline "
            f"guards nothing; see why the decoder rejects them, or give --force\n{table}"
        )
    new.write(target)


def _old_maps(
    old: Baseline, failed: Mapping[str, Case], seeds: Sequence[int]
) -> dict[str, ErrorMaps]:
    """The baseline's error maps of the cases that failed: stored, or of our own decoder made again."""
    found = {name: old.maps[name] for name in failed if name in old.maps}
    if old.decoder == OWN and not found:
        with resolve(decode.reconstruct) as own:
            for name, case in failed.items():
                found[name] = _decoded(case, own, seeds[:3], lambda _: None)[1]
    return found


def _all_figures(
    cases: Sequence[Case], run: Decoder, seeds: Sequence[int], verb: str, steps: Steps
) -> tuple[dict[str, Figures], dict[str, ErrorMaps]]:
    """Figures and maps of a decoder, by case."""
    figures, maps = {}, {}
    for case in cases:
        with steps.step(f"{verb} {case.name}") as done:
            figures[case.name], maps[case.name] = _decoded(case, run, seeds, done)
    return figures, maps


def _decoded(
    case: Case, run: Decoder, seeds: Sequence[int], done: StepProgress | Callable[[float], None]
) -> tuple[Figures, ErrorMaps]:
    """Figures and maps of a decoder on one case."""
    heights, sigmas = [], []
    for i, seed in enumerate(seeds):
        done(i / len(seeds))
        try:
            # The seed is kept back: with it the noise can be made again, and subtracted.
            answer = run(replace(case.stack(seed), seed=None))
        except FringebenchError as error:
            raise OutsideDecoderError(f"case '{case.name}', seed {seed}: {error}") from error
        heights.append(answer.height_mm)
        sigmas.append(case.sigma_mm if answer.sigma_mm is None else answer.sigma_mm)
    height, sigma = np.stack(heights), np.stack(sigmas)
    figures = measure(height, sigma, case.height_mm, case.regions, case.unlit, case.mm_per_rad)
    return figures, ErrorMaps.of(case, height, sigma)
