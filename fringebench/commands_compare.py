"""The command that compares strategies."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

import scenes
from fringebench.options import AsJson, PhaseError, SceneName, Seed, Settings, ShowProgress
from fringebench.overrides import parse_overrides
from fringebench.progress import Mode, Steps


def compare(
    scene: SceneName = "bench",
    strategies: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="Names, separated by commas; default: all."),
    ] = None,
    repeats: Annotated[
        int,
        typer.Option(help="Captures of each, with noise of their own; 2 give intervals.", min=1),
    ] = 5,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Also write compare.json, figures and report.html here."
        ),
    ] = None,
    settings: Settings = [],  # noqa: B006
    phase_error: PhaseError = None,
    seed: Seed = 0,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """HDR strategies side by side: one transport, at equal total exposure time and at equal frame count."""
    loaded = scenes.load(scene, parse_overrides(settings, phase_error))
    names = None
    if strategies is not None:
        names = [name.strip() for name in strategies.split(",") if name.strip()]

    from fringebench.compare import compare as run
    from fringebench.comparison_output import tables, write
    from fringebench.light import told
    from fringebench.run import prepare
    from fringebench.tables import wide_console

    if output:
        prepare(output)  # a folder that cannot be is told before the work, not after
    steps = Steps(Console(stderr=True), progress)
    result = run(loaded, names, repeats, seed, steps)
    written = write(result, output) if output else []
    if output:
        from fringebench.compare_report import compare_report

        written.append(output / "report.html")
        compare_report(result, scenes.dumps(loaded), steps.seconds).write(written[-1])
    if as_json:
        sys.stdout.write(json.dumps(result.to_dict(), indent=2, allow_nan=False) + "\n")
        return
    console = wide_console()
    for table in tables(result):
        console.print(table)
    for name, budget, reason in result.left_out:
        console.print(f"[yellow]left out:[/] {name}, {budget}: {escape(reason)}")
    if result.light:
        console.print(told(result.light), soft_wrap=True)
    for path in written:
        sys.stdout.write(f"wrote {path}\n")


def register(app: typer.Typer) -> None:
    """Add the command to the front door's."""
    app.command(
        epilog="Example: fringebench compare bench --strategies max-modulation,censored-ml "
        "--set camera.resolution=[320,240] -o comparison"
    )(compare)
