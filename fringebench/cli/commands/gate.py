"""Commands that judge decoders: regress, export, budget."""

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from fringebench.cli import shared_options as opt
from fringebench.cli.outputs import check_outputs
from fringebench.cli.overrides import parse_overrides
from fringebench.cli.registration import command
from fringebench.cli.terminal import (
    answer,
    answer_console,
    print_figures,
    print_json,
    progress_steps,
    say,
)
from fringebench.progress import Mode

if TYPE_CHECKING:
    from fringebench.gate.regression_result import Regression

app = typer.Typer()


@command(app, "fringebench regress my_package.decoder:decode --baseline mine.json")
def regress(
    decoder: str,
    baseline: Path | None = None,
    scene: Annotated[list[str], typer.Option(metavar="FILE", autocompletion=opt.scene_names)] = [],  # noqa: B006
    update: bool = False,
    force: bool = False,
    seed: opt.Seed = 0,
    seeds: opt.Listed = None,
    timeout: Annotated[float, typer.Option(min=0.1)] = 600.0,
    cache: Annotated[Path | None, typer.Option(envvar="FRINGEBENCH_CACHE")] = None,
    output: Path | None = None,
    junit: Path | None = None,
    history: Path | None = None,
    github: bool = False,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Compare a decoder with a baseline: exit status 1 if errors, wrong orders, sigma or coverage got worse.

    decoder: package.module:callable taking a Stack, or a command with {stack} or {manifest}, and {output}.
    baseline: Baseline JSON; default: the one shipped, of decode:reconstruct.
    scene: Judge on this scene instead of the shipped cases; may be repeated.
    update: Store the figures in --baseline, unless they got worse.
    force: Store a baseline even if most regions are missing.
    seed: First of 16 noise seeds in a row.
    seeds: Noise seeds, one decode each, instead: 0-31 or 3,7,11.
    timeout: Seconds the decoder may take for one stack.
    cache: Keep the cases' light in this folder between runs.
    output: Also write JSON and report.html here.
    junit: Also write JUnit XML here.
    history: Append this run to a history (one line of JSON a run); the page plots it.
    github: Also print annotations for GitHub Actions.
    """
    from fringebench.gate.ci_formats import (
        append_history,
        github_annotations,
        read_history,
        write_junit,
    )
    from fringebench.gate.regression_gate import SEEDS
    from fringebench.gate.regression_gate import regress as run
    from fringebench.output_folder import prepare, write_json

    steps = progress_steps(progress)
    folder = None if output is None else prepare(output)
    check_outputs(
        {"--junit": junit, "--history": history, "--baseline": baseline if update else None},
        [Path(name) for name in scene],
    )
    if history:
        read_history(history)
    result = run(
        decoder,
        baseline,
        scenes=scene,
        update=update,
        force=force,
        seeds=range(seed, seed + len(SEEDS)) if seeds is None else parse_seeds(seeds),
        timeout_s=timeout,
        cache=cache,
        steps=steps,
    )
    runs = append_history(result, history) if history else []
    if junit:
        write_junit(result, junit)
    if folder:
        from fringebench.pages.regress_page import regress_report

        write_json(result.to_dict(), folder / "regress.json")
        regress_report(result, steps.seconds, runs).write(folder / "report.html")
    if github:
        # Both streams are read for annotations; with --json the answer has standard output to itself.
        stream = sys.stderr if as_json else sys.stdout
        stream.write("".join(f"{line}\n" for line in github_annotations(result)))
    if as_json:
        print_json(result.to_dict())
    else:
        _print_regression(result, baseline)
        if folder:
            say(f"see {folder / 'report.html'}")
    if not result.passed:
        raise typer.Exit(1)


def _print_regression(result: "Regression", baseline: Path | None) -> None:
    """What got worse and better in words, and the verdict as the last line."""
    from fringebench.gate.baseline import mostly_missing
    from fringebench.gate.wording import sentence

    console = answer_console()
    failures = result.failures()
    for failure in failures:
        how = failure.worst.comparison.verdict
        console.print(f"[red]{how}[/]  {escape(failure.sentence())}", soft_wrap=True)
    for row in result.improved:
        console.print(f"[green]better[/]  {escape(sentence(row))}", soft_wrap=True)
    if result.updated:
        for case, region, share in mostly_missing(result.figures):
            say(f"warning: {100 * share:.0f} % of the pixels of {case} / {region} are missing")
        say(f"stored as {baseline}")
    if result.rows:
        failed = (
            f"{len(result.failed)} of {len(result.rows)} figures failed, in {len(failures)} regions"
        )
        verdict = failed if failures else f"passed, {len(result.rows)} figures"
        say(f"{result.decoder} compared with {result.baseline}: {verdict}")


@command(app, "fringebench export stack.exr -o frames")
def export(
    stack: Path, output: Path, projector: int | None = None, as_json: opt.AsJson = False
) -> None:
    """Write a stack as numbered PNGs and a manifest, for programs that read images.

    stack: A stack EXR.
    output: Folder to write.
    projector: Whose frames, where there are several projectors.
    """
    import scenes
    from fringebench.exchange.capture_export import export as run

    manifest = str(run(scenes.Stack.read(stack), output, projector))
    answer(as_json, {"manifest": manifest}, manifest)


@command(app, "fringebench budget bench --set camera.resolution=[320,240]")
def budget(
    scene: opt.SceneName,
    settings: opt.Settings = [],  # noqa: B006
    phase_error: opt.PhaseError = None,
    render_noise: opt.RenderNoise = None,
    seed: opt.Seed = 0,
    repeats: opt.Count = 4,
    fusion: opt.Fusion = "max-modulation",
    saturation: str = "reject",
    output: Path | None = None,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Find which cause makes which part of the error: causes switched off, and on, one at a time.

    repeats: Decodes of each noisy variant.
    output: Also write JSON and report.html here.
    saturation: reject, or ignore: what a decoder without a saturation mask does.
    """
    import scenes
    from fringebench import verbs
    from fringebench.pages.score_tables import budget_table

    loaded = scenes.load(scene, parse_overrides(settings, phase_error, render_noise))
    steps = progress_steps(progress)
    found = verbs.budget(loaded, seed, repeats, fusion, saturation, output, steps)  # type: ignore[arg-type]
    if as_json:
        print_json(found.to_dict())
        return
    console = answer_console()
    print_figures([budget_table(found)])
    if found.absent:
        console.print(f"not in this scene: {', '.join(found.absent)}")


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds from a list such as ``0-15`` or ``3,7,20-22``; raises `FringebenchError` for another form.

    >>> parse_seeds("3,7-9")
    (3, 7, 8, 9)
    """
    from scenes.support.errors import FringebenchError

    found: list[int] = []
    for part in text.split(","):
        ends = re.fullmatch(r"\s*(\d+)(?:-(\d+))?\s*", part)
        if ends is None:
            raise FringebenchError(f"--seeds '{text}': write whole numbers, such as 0-15 or 3,7,11")
        first = int(ends[1])
        found += range(first, int(ends[2] or first) + 1)
    if len(set(found)) < 3:
        raise FringebenchError(f"--seeds '{text}': give at least 3 different seeds")
    return tuple(dict.fromkeys(found))
