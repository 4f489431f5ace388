"""What can be done with a scene, a data set or a decoder, as functions: the Python side of the commands of the same names.

Each verb joins an experiment with the page and the files that show its result.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

import scenes
from evaluation.hdr.comparison import StrategyComparison
from evaluation.hdr.light_budget import BUDGETS, LightBudget
from evaluation.scoring.error_budget import ErrorBudget
from fringebench.datasets.making import dataset
from fringebench.experiments import cause_budget, hdr_comparison, surface_methods, whole_run
from fringebench.experiments.hdr_comparison import outside_strategy
from fringebench.experiments.rigs.acceptance import accept
from fringebench.gate.decoders import resolve
from fringebench.gate.regression_gate import regress
from fringebench.output_folder import prepare, write_json
from fringebench.progress import Steps
from scenes import Scene

__all__ = ["accept", "budget", "compare", "dataset", "methods", "regress", "run"]


def run(
    scene: Scene | str,
    folder: str | Path,
    seed: int = 0,
    fusion: str = "max-modulation",
    steps: Steps | None = None,
) -> whole_run.Run:
    """Render, expose, decode and score a scene, and write every file and the report into a folder.

    The files are ``scene.toml transport.exr stack.exr truth.exr reconstruction.exr cloud.ply scores.json report.html``.
    Each is written under a temporary name and then renamed, so an interrupted run leaves no half-written file. Results of
    an earlier run in `folder` are replaced only once this run has succeeded.

    Parameters
    ----------
    scene
        A scene, the name of a shipped scene, or the path of a scene's TOML file.
    folder
        Output folder; created if it does not exist.
    seed
        Seed of light paths and sensor noise, 0 or more.
    fusion
        Name of the rule that combines exposures; `decode.rules` lists them.
    steps
        Shows progress; none by default.

    Returns
    -------
    Run
        `stack`, `truth`, `reconstruction`, `score`, and `naive`, the score of a single exposure decoded with saturation ignored.

    Raises
    ------
    FringebenchError
        If the scene is invalid, cannot be decoded, or the folder cannot be written.

    Examples
    --------
    >>> import tempfile, fringebench as fb
    >>> scene = fb.load("step", {"camera.resolution": [64, 48], "sampling.samples": 16})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = fb.run(scene, folder)
    ...     (result.folder / "report.html").exists()
    True
    >>> result.score.regions["base"].rms_mm < 0.1
    True
    """
    from fringebench.pages.run_page import run_report

    return whole_run.run(_scene(scene), folder, seed, fusion, steps, run_report)


def compare(
    scene: Scene | str,
    strategies: Sequence[str] | None = None,
    repeats: int = 5,
    seed: int = 0,
    folder: str | Path | None = None,
    steps: Steps | None = None,
    budgets: Sequence[LightBudget] = BUDGETS[:2],
    pareto: bool = False,
    decoders: Sequence[str | Callable[[scenes.Stack], object]] = (),
) -> StrategyComparison:
    """Compare HDR strategies on one scene under equal budgets.

    Light is traced once. Repeat r of every strategy has the noise of seed ``seed + r``, so differences between strategies
    are differences of the strategies. A scene with a single exposure is given four.

    Parameters
    ----------
    scene
        A scene with phase-shift patterns, the name of a shipped scene, or the path of a scene's TOML file.
    strategies
        Names of strategies; all by default. Unknown names are refused with the list of known ones.
    repeats
        Captures of each strategy; two or more give 95 % intervals.
    seed
        Seed of light paths and sensor noise, 0 or more.
    folder
        If given, ``compare.json``, one figure for each budget and ``report.html`` are written there.
    steps
        Shows progress; none by default.
    budgets
        What is equal: ``"equal-time"`` (total exposure), ``"equal-frames"``, ``"cycle-time"`` (exposure and each frame's
        overhead, `scene.acquisition`).
    pareto
        Also give each strategy 1/4, 1/2, 1, 2 and 4 times the reference's cycle time.
    decoders
        Whole decoders that get the scene's exposures, as `regress` takes them: ``package.module:callable``, a command, or a
        callable.

    Returns
    -------
    StrategyComparison
        Errors in mm, exposure times in ms, and efficiency (Cramér–Rao bound over variance, at most 1) of each strategy,
        by region; strategies that failed are in `left_out` with the reason.

    Raises
    ------
    ScoreError
        For an unknown strategy, fewer than one repeat, or patterns without fringes.
    OutsideDecoderError
        For a decoder that is neither a name, a command nor a callable.

    Examples
    --------
    >>> import fringebench as fb
    >>> scene = fb.load("ink", {"camera.resolution": [64, 48], "sampling.samples": 16})
    >>> found = fb.compare(scene, ["max-modulation", "single"], repeats=2)
    >>> {entry.name for entry in found.entries} == {"max-modulation", "single"}
    True
    """
    loaded = _scene(scene)
    # A folder that cannot be written is reported before the work, not after it.
    out = None if folder is None else prepare(folder)
    steps = steps or Steps()
    with ExitStack() as running:
        outside = [outside_strategy(running.enter_context(resolve(d)), d) for d in decoders]
        result = hdr_comparison.compare(
            loaded, strategies, repeats, seed, steps, budgets, pareto, outside
        )
    if out is not None:
        from fringebench.pages.compare_page import compare_report
        from fringebench.pages.comparison_tables import write

        write(result, out)
        report = compare_report(result, scenes.dumps(loaded), steps.seconds)
        report.write(out / "report.html")
    return result


def budget(
    scene: Scene | str,
    seed: int = 0,
    repeats: int = 4,
    fusion: str = "max-modulation",
    saturation: Literal["reject", "ignore"] = "reject",
    folder: str | Path | None = None,
    steps: Steps | None = None,
) -> ErrorBudget:
    """Find which cause of error makes which part of a scene's height error.

    Each cause is switched off alone, and switched on alone; the mean square errors of independent causes add up, and what
    they do not add up to is reported as the interaction.

    Parameters
    ----------
    scene
        A scene, the name of a shipped scene, or the path of a scene's TOML file.
    seed
        Seed of light paths and sensor noise, 0 or more.
    repeats
        Captures of each variant that has noise.
    fusion
        Name of the rule that combines exposures; `decode.rules` lists them.
    saturation
        ``"ignore"`` shows what a decoder without a saturation mask would do.
    folder
        If given, ``budget.json`` and ``report.html`` are written there.
    steps
        Shows progress; none by default.

    Returns
    -------
    ErrorBudget
        By region and cause: mean square error in mm² with this cause alone, and what is removed with it.

    Raises
    ------
    FringebenchError
        For fewer than one repeat, or a scene that cannot be decoded.

    Examples
    --------
    >>> import fringebench as fb
    >>> coarse = {"camera.resolution": [48, 36], "patterns.periods_px": [128.0, 1024.0]}
    >>> scene = fb.load("step", coarse | {"sampling.samples": 4, "sampling.depth": 1})
    >>> found = fb.budget(scene, repeats=2)
    >>> found.regions["base"].causes["noise"].alone_mm2 > 0
    True
    """
    loaded = _scene(scene)
    out = None if folder is None else prepare(folder)
    steps = steps or Steps()
    found = cause_budget.budget(loaded, seed, repeats, steps, fusion=fusion, saturation=saturation)
    if out is not None:
        from fringebench.pages.budget_page import budget_report

        write_json(found.to_dict(), out / "budget.json")
        toml = scenes.dumps(loaded)
        report = budget_report(found, toml, seed, steps.seconds, loaded.description)
        report.write(out / "report.html")
    return found


def methods(
    methods: Sequence[str] | None = None,
    surfaces: Sequence[str] | None = None,
    folder: str | Path | None = None,
    resolution: tuple[int, int] = (200, 150),
    samples: int = 32,
    seed: int = 0,
    steps: Steps | None = None,
) -> surface_methods.MethodMap:
    """Measure surfaces by several methods with one camera: how much of each is measured, how well, and why not.

    Parameters
    ----------
    methods
        Some of ``fringe-projection phase-stereo active-stereo passive-stereo deflectometry``; None: all.
    surfaces
        Some of ``matt glossy black translucent solder grains mirror step``; None: all.
    folder
        If given, ``methods.json``, ``methods.png`` and ``report.html`` are written there.
    resolution
        Columns and rows of the cameras, px.
    samples
        As `scenes.Sampling.samples`.
    seed
        Seed of light paths and sensor noise, 0 or more.
    steps
        Shows progress; none by default.

    Returns
    -------
    MethodMap
        For each pair the coverage (0 to 1), the error in mm, and what most pixels fail by.

    Raises
    ------
    ScoreError
        For an unknown method or surface.

    Examples
    --------
    >>> import fringebench as fb
    >>> found = fb.methods(["fringe-projection"], ["step"], resolution=(80, 60), samples=4)
    >>> found.cells[0].coverage > 0.5
    True
    """
    out = None if folder is None else prepare(folder)
    steps = steps or Steps()
    found = surface_methods.method_map(methods, surfaces, resolution, samples, seed, steps)
    if out is not None:
        from evaluation.output.plots import save
        from fringebench.pages.method_map_page import map_figure, map_report

        write_json(found.to_dict(), out / "methods.json")
        save(map_figure(found), out / "methods.png")
        map_report(found, steps.seconds).write(out / "report.html")
    return found


def _scene(scene: Scene | str) -> Scene:
    return scenes.load(scene) if isinstance(scene, str) else scene
