"""Commands that show and convert files: view, convert."""

import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from fringebench.cli import shared_options as opt
from fringebench.cli.outputs import check_outputs
from fringebench.cli.overrides import parse_overrides
from fringebench.cli.terminal import answer

app = typer.Typer()

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]


@app.command(epilog="Example: fringebench view out/reconstruction.exr --truth out/truth.exr --open")
def view(
    file: Annotated[Path, typer.Argument(help="A transport, stack, truth or reconstruction EXR.")],
    output: Annotated[
        Path | None,
        opt.destination("Page (.html) or contact sheet (.png); default: NAME.html here."),
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="A truth EXR: adds the errors of a reconstruction.")
    ] = None,
    show: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show what a fringebench EXR file holds, as an HTML page or a contact sheet."""
    from fringebench.exchange.viewer import read_view, write_view

    target = output or Path(f"{file.stem}.html")
    check_outputs({"-o": target}, [file] if truth is None else [file, truth])
    write_view(read_view(file, truth), file, target)
    answer(as_json, {"file": str(target)}, str(target))
    if show and not webbrowser.open(target.resolve().as_uri()):
        sys.stderr.write(f"fringebench: no browser found: open {target} yourself\n")


@app.command(epilog="Example: fringebench convert out/reconstruction.exr -o height.png")
def convert(
    source: Annotated[
        str, typer.Argument(help="A reconstruction or truth EXR, or a scene (name or TOML).")
    ],
    output: Annotated[
        Path,
        opt.destination(
            "Heights: .png .tif (16 bits). Surface: .ply .obj .glb. Scene: .glb .obj .ply .stl."
        ),
    ],
    truth: Annotated[
        Path | None, typer.Option(help="A truth EXR: adds the errors to a PLY.")
    ] = None,
    points: Annotated[
        bool, typer.Option("--points", help="PLY of points only, without triangles.")
    ] = False,
    settings: Annotated[
        list[str], typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the scene.")
    ] = [],  # noqa: B006
    as_json: AsJson = False,
) -> None:
    """Write heights, surfaces and scenes in the formats of other programs; for frames use export."""
    check_outputs({"-o": output}, [source] if truth is None else [source, truth])
    from fringebench.exchange.conversion import convert as run

    contents = run(source, output, truth, points, parse_overrides(settings))
    answer(as_json, {"file": str(output), "holds": contents}, f"{output}: {contents}")
