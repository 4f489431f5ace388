"""The command that compares strategies."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

import scenes
from fringebench.overrides import parse_overrides

# Columns of text when nobody says how many there are.
WIDTH = 120


def compare(
    scene: Annotated[str, typer.Argument(help="A shipped scene's name, or a TOML file.")] = "bench",
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
        typer.Option("-o", "--output", help="Also write compare.json and figures here."),
    ] = None,
    settings: Annotated[
        list[str],
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Override a key of the scene; may be repeated."
        ),
    ] = [],  # noqa: B006
    seed: Annotated[int, typer.Option(help="Seed of light paths and noise.", min=0)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """HDR strategies side by side: one transport, at equal total exposure time and at equal frame count."""
    loaded = scenes.load(scene, parse_overrides(settings))
    names = None
    if strategies is not None:
        names = [name.strip() for name in strategies.split(",") if name.strip()]

    from fringebench.compare import compare as run
    from fringebench.comparison_output import tables, write
    from fringebench.progress import Steps
    from fringebench.run import prepare

    if output:
        prepare(output)  # a folder that cannot be is told before the work, not after
    result = run(loaded, names, repeats, seed, Steps(Console(stderr=True)))
    written = write(result, output) if output else []
    if as_json:
        sys.stdout.write(json.dumps(result.to_dict(), indent=2, allow_nan=False) + "\n")
        return
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=WIDTH)
    for table in tables(result):
        console.print(table)
    for name, budget, reason in result.left_out:
        console.print(f"[yellow]left out:[/] {name}, {budget}: {reason}")
    for path in written:
        console.print(f"wrote {path}")


def register(app: typer.Typer) -> None:
    """Add the command to the front door's."""
    app.command(
        epilog="Example: fringebench compare bench --strategies max-modulation,censored-ml "
        "--set camera.resolution=[320,240] -o comparison"
    )(compare)
