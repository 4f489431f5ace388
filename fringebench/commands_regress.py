"""Commands that judge decoders: regress, export, budget."""

import json
import re
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from fringebench.options import AsJson, Fusion, PhaseError, SceneName, Seed, Settings, ShowProgress
from fringebench.progress import Mode, Steps
from scenes.errors import FringebenchError
from scenes.replace_file import replacing

Folder = Annotated[
    Path | None, typer.Option("-o", "--output", help="Also write JSON and report.html here.")
]


def regress(
    decoder: Annotated[
        str,
        typer.Argument(
            help="package.module:callable taking a Stack, or a command with {stack} or {manifest}, and {output}."
        ),
    ],
    baseline: Annotated[
        Path | None,
        typer.Option(help="Baseline JSON; default: the one shipped, of decode:reconstruct."),
    ] = None,
    update: Annotated[
        bool,
        typer.Option("--update", help="Store the figures in --baseline, unless they got worse."),
    ] = False,
    seed: Annotated[int, typer.Option(help="First of 16 noise seeds in a row.", min=0)] = 0,
    seeds: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="Noise seeds, one decode each, instead: 0-31 or 3,7,11."),
    ] = None,
    timeout: Annotated[
        float, typer.Option(help="Seconds a command may take for one stack.")
    ] = 600.0,
    output: Folder = None,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Hold a decoder against a baseline: exit status 1 if bias, silent errors or coverage got worse."""
    from fringebench.regress import SEEDS, told
    from fringebench.regress import regress as run

    steps = Steps(Console(stderr=True), progress)
    folder = _prepared(output)
    result = run(
        decoder,
        baseline,
        update=update,
        seeds=range(seed, seed + len(SEEDS)) if seeds is None else parse_seeds(seeds),
        timeout_s=timeout,
        steps=steps,
    )
    if folder:
        from fringebench.regress_report import regress_report

        _write(result.to_dict(), folder / "regress.json")
        regress_report(result, steps.seconds).write(folder / "report.html")
    if as_json:
        _print_json(result.to_dict())
    else:
        console = Console(highlight=False, soft_wrap=True)
        for row in result.failed:
            console.print(f"[red]{row.comparison.verdict}[/]  {escape(told(row))}")
        for row in result.improved:
            console.print(f"[green]better[/]  {escape(told(row))}")
        if result.updated:
            sys.stdout.write(f"stored as {baseline}\n")
        if result.rows:
            failed = f"{len(result.failed)} of {len(result.rows)} figures failed"
            verdict = failed if result.failed else "passed"
            sys.stdout.write(f"{result.decoder} against {result.baseline}: {verdict}\n")
    if not result.passed:
        raise typer.Exit(1)


def export(
    stack: Annotated[Path, typer.Argument(help="A stack EXR.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write.")],
    projector: Annotated[
        int | None, typer.Option(help="Whose frames, where there are several projectors.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a stack as numbered PNGs and a manifest, for programs that read images."""
    import scenes
    from fringebench.export import export as run

    manifest = str(run(scenes.Stack.read(stack), output, projector))
    if as_json:
        _print_json({"manifest": manifest})
    else:
        sys.stdout.write(f"{manifest}\n")


def budget(
    scene: SceneName,
    settings: Settings = [],  # noqa: B006
    phase_error: PhaseError = None,
    seed: Seed = 0,
    repeats: Annotated[int, typer.Option(help="Decodes of each noisy variant.", min=1)] = 4,
    fusion: Fusion = "max-modulation",
    saturation: Annotated[
        str, typer.Option(help="reject, or ignore: what a decoder without a saturation mask does.")
    ] = "reject",
    output: Folder = None,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Which cause owns which millimetre: causes of error switched off, and on, one at a time."""
    import scenes
    from fringebench.budget import budget as run
    from fringebench.overrides import parse_overrides

    loaded = scenes.load(scene, parse_overrides(settings, phase_error))
    folder = _prepared(output)
    steps = Steps(Console(stderr=True), progress)
    found = run(loaded, seed, repeats, steps, fusion=fusion, saturation=saturation)
    if folder:
        from fringebench.budget_report import budget_report

        _write(found.to_dict(), folder / "budget.json")
        page = budget_report(found, scenes.dumps(loaded), seed, steps.seconds, loaded.description)
        page.write(folder / "report.html")
    if as_json:
        _print_json(found.to_dict())
        return
    from fringebench.tables import budget_table

    console = Console()
    console.print(budget_table(found))
    if found.absent:
        console.print(f"not in this scene: {', '.join(found.absent)}", highlight=False)


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds from a list such as ``0-15`` or ``3,7,20-22``; raises `FringebenchError` for another form.

    >>> parse_seeds("3,7-9")
    (3, 7, 8, 9)
    """
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


def _prepared(output: Path | None) -> Path | None:
    """A folder that cannot be is told before the work, not after."""
    from fringebench.run import prepare

    return None if output is None else prepare(output)


def _write(value: object, path: Path) -> None:
    with replacing(path) as beside:
        beside.write_text(json.dumps(value, indent=2, allow_nan=False) + "\n", "utf-8")


def _print_json(value: object) -> None:
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + "\n")


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command(
        epilog="Example: fringebench regress my_package.decoder:decode --baseline mine.json"
    )(regress)
    app.command(epilog="Example: fringebench export stack.exr -o frames")(export)
    app.command(epilog="Example: fringebench budget bench --set camera.resolution=[320,240]")(
        budget
    )
