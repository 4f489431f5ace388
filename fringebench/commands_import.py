"""The commands that let real captures in: import, stereo."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fringebench.options import AsJson, Fusion, ShowProgress
from fringebench.progress import Mode, Steps
from scenes.replace_file import require_writable

STYLES = {"ok": "green", "warning": "yellow", "wrong": "bold red", "unknown": "dim"}


def import_capture(
    manifest: Annotated[
        Path, typer.Argument(help="A manifest TOML: which image shows what (see docs/import.md).")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Stack file.")] = Path("stack.exr"),
    check: Annotated[
        bool,
        typer.Option("--check", help="Only check linearity, order and periods; write nothing."),
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Write the stack although checks say it is wrong.")
    ] = False,
    progress: ShowProgress = Mode.AUTO,
    as_json: Annotated[bool, typer.Option("--json", help="Print the checks as JSON.")] = False,
) -> None:
    """Turn image files and a calibration into a stack, after checking that they are what the manifest says.

    What the images contradict (frames exchanged, a wrong period, another camera's calibration) is refused with the reason.
    With --check the exit status is 1 if a check says wrong.
    """
    import decode.check
    from scenes.capture import Capture

    steps = Steps(Console(stderr=True), progress)
    capture = Capture.load(manifest)
    if not check:
        require_writable(output)
    with steps.step("read images"):
        stack = capture.stack()
    with steps.step("check"):
        report = decode.check.check(stack, capture.projector_resolution)
    if as_json:
        sys.stdout.write(json.dumps(report.to_dict(), indent=2) + "\n")
    else:
        table = Table("check", "", "what was found", title=escape(str(manifest)))
        for finding in report.findings:
            style = STYLES[finding.verdict]
            verdict = f"[{style}]{finding.verdict}[/]"
            table.add_row(escape(finding.name), verdict, escape(finding.message))
        Console().print(table)
    if check:
        raise typer.Exit(1 if report.wrong else 0)
    if not force:
        report.raise_if_wrong()
    with steps.step("write"):
        stack.write(output)
    if not as_json:
        exposures, frames, rows, columns = stack.frames.shape
        rig = "calibrated" if stack.calibration else "not calibrated"
        sys.stdout.write(
            f"{output}: {exposures} exposures, {frames} frames, {columns} x {rows} px, {rig}\n"
        )


def stereo(
    left: Annotated[Path, typer.Argument(help="Stack EXR of the first camera.")],
    right: Annotated[Path, typer.Argument(help="Stack EXR of the second camera.")],
    calibration: Annotated[
        list[Path], typer.Argument(help="OpenCV calibration of the pair: one file or several.")
    ],
    depth_mm: Annotated[
        tuple[float, float],
        typer.Option(metavar="NEAR FAR", help="Depths to search in front of the first camera."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Reconstruction file.")] = Path(
        "reconstruction.exr"
    ),
    mm_per_unit: Annotated[
        float, typer.Option(help="Millimetres per unit of the calibration: 1000 for metres.")
    ] = 1.0,
    fusion: Fusion = "max-modulation",
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Heights from two cameras that saw the same patterns; the projector needs no calibration."""
    import scenes
    from decode.stereo import stereo as match
    from scenes.opencv_calibration import Source

    stacks = [scenes.Stack.read(path) for path in (left, right)]
    pair = Source(files=tuple(calibration), mm_per_unit=mm_per_unit).pair()
    cameras = pair.cameras(stacks[0].resolution, stacks[1].resolution)
    require_writable(output)
    with Steps(Console(stderr=True), progress).step("match"):
        rec = match(stacks[0], stacks[1], cameras, (-depth_mm[1], -depth_mm[0]), fusion=fusion)
    rec.write(output)
    if as_json:
        told = {"reasons": rec.reason_fractions(), "settings": rec.settings}
        sys.stdout.write(json.dumps({"reconstruction": str(output)} | told, indent=2) + "\n")
        return
    sys.stdout.write(f"{output}: {rec.valid.mean():.1%} of the pixels measured\n")


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command("import", epilog="Example: fringebench import capture.toml -o stack.exr")(
        import_capture
    )
    app.command(
        epilog="Example: fringebench stereo left.exr right.exr stereo.yml --depth-mm 400 900"
    )(stereo)
