"""The command that lets real captures in: import."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

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
    as_json: Annotated[bool, typer.Option("--json", help="Print the checks as JSON.")] = False,
) -> None:
    """Turn image files and a calibration into a stack, after checking that they are what the manifest says.

    What the images contradict (frames exchanged, a wrong period, another camera's calibration) is refused with the reason.
    With --check the exit status is 1 if a check says wrong.
    """
    import decode.check
    from fringebench.progress import Steps
    from scenes.capture import Capture

    steps = Steps(Console(stderr=True))
    capture = Capture.load(manifest)
    with steps.step("read images"):
        stack = capture.stack()
    with steps.step("check"):
        report = decode.check.check(stack, capture.projector_resolution)
    if as_json:
        sys.stdout.write(json.dumps(report.to_dict(), indent=2) + "\n")
    else:
        table = Table("check", "", "what was found", title=f"{manifest}")
        for finding in report.findings:
            style = STYLES[finding.verdict]
            table.add_row(finding.name, f"[{style}]{finding.verdict}[/]", finding.message)
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
        Console(highlight=False).print(
            f"{output}: {exposures} exposures, {frames} frames, {columns} x {rows} px, {rig}"
        )


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command("import", epilog="Example: fringebench import capture.toml -o stack.exr")(
        import_capture
    )
