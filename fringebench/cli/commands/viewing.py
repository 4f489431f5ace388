"""Commands that show and convert files: view, convert."""

import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from fringebench.cli import shared_options as opt
from fringebench.cli.outputs import check_outputs
from fringebench.cli.overrides import parse_overrides
from fringebench.cli.registration import command
from fringebench.cli.terminal import answer

app = typer.Typer()


@command(app, "fringebench view out/reconstruction.exr --truth out/truth.exr --open")
def view(
    file: Path,
    output: Path | None = None,
    truth: Path | None = None,
    show: Annotated[bool, typer.Option("--open")] = False,
    as_json: opt.AsJson = False,
) -> None:
    """Show what a fringebench EXR file holds, as an HTML page or a contact sheet.

    file: A transport, stack, truth or reconstruction EXR.
    output: Page (.html) or contact sheet (.png); default: NAME.html here.
    truth: A truth EXR: adds the errors of a reconstruction.
    show: Open it in the browser.
    """
    from fringebench.exchange.viewer import read_view, write_view

    target = output or Path(f"{file.stem}.html")
    check_outputs({"-o": target}, [file] if truth is None else [file, truth])
    write_view(read_view(file, truth), file, target)
    answer(as_json, {"file": str(target)}, str(target))
    if show and not webbrowser.open(target.resolve().as_uri()):
        sys.stderr.write(f"fringebench: no browser found: open {target} yourself\n")


@command(app, "fringebench convert out/reconstruction.exr -o height.png")
def convert(
    source: str,
    output: Path,
    truth: Path | None = None,
    points: bool = False,
    settings: opt.Settings = [],  # noqa: B006
    as_json: opt.AsJson = False,
) -> None:
    """Write heights, surfaces and scenes in the formats of other programs; for frames use export.

    source: A reconstruction or truth EXR, or a scene (name or TOML).
    output: Heights: .png .tif (16 bits). Surface: .ply .obj .glb. Scene: .glb .obj .ply .stl.
    truth: A truth EXR: adds the errors to a PLY.
    points: PLY of points only, without triangles.
    settings: Override a key of the scene.
    """
    check_outputs({"-o": output}, [source] if truth is None else [source, truth])
    from fringebench.exchange.conversion import convert as run

    contents = run(source, output, truth, points, parse_overrides(settings))
    answer(as_json, {"file": str(output), "holds": contents}, f"{output}: {contents}")
