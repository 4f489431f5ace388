"""Commands that show and convert files: view, convert."""

import json
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from fringebench.overrides import parse_overrides

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]


def view(
    file: Annotated[Path, typer.Argument(help="A transport, stack, truth or reconstruction EXR.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Page (.html) or contact sheet (.png); default: NAME.html here."
        ),
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="Truth file: adds a reconstruction's errors.")
    ] = None,
    show: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show what one of our EXR files holds, as a page of HTML or a contact sheet."""
    from fringebench.view import view as look
    from fringebench.view import write_view

    target = output or Path(f"{file.stem}.html")
    write_view(look(file, truth), file, target)
    _say({"file": str(target)}, str(target), as_json)
    if show and not webbrowser.open(target.resolve().as_uri()):
        sys.stderr.write(f"fringebench: no browser found: open {target} yourself\n")


def convert(
    source: Annotated[
        str, typer.Argument(help="A reconstruction or truth EXR, or a scene (name or TOML).")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="Heights: .png .tif (16 bits). Surface: .ply .obj .glb. Scene: .glb .obj .ply .stl.",
        ),
    ],
    truth: Annotated[Path | None, typer.Option(help="Truth file: adds the error to a PLY.")] = None,
    points: Annotated[
        bool, typer.Option("--points", help="PLY without triangles: the cloud alone.")
    ] = False,
    settings: Annotated[
        list[str],
        typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the scene."),
    ] = [],  # noqa: B006
    as_json: AsJson = False,
) -> None:
    """Write heights, surfaces and scenes in the formats of other programs; frames: see `export`."""
    from fringebench.convert import convert as run

    words = run(source, output, truth, points, parse_overrides(settings))
    _say({"file": str(output), "holds": words}, f"{output}: {words}", as_json)


def _say(data: dict[str, str], text: str, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(data, indent=2) + "\n")
    else:
        Console(highlight=False, soft_wrap=True).print(text, markup=False)


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command(
        epilog="Example: fringebench view out/reconstruction.exr --truth out/truth.exr --open"
    )(view)
    app.command(epilog="Example: fringebench convert out/reconstruction.exr -o height.png")(convert)
