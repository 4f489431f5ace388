"""The commands that let real captures in: import, stereo."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from fringebench.cli import shared_options as opt
from fringebench.cli.outputs import check_outputs
from fringebench.cli.overrides import part_names
from fringebench.cli.registration import command
from fringebench.cli.terminal import answer, print_figures, print_json, progress_steps, say
from fringebench.progress import Mode

if TYPE_CHECKING:
    from scenes import Stack

app = typer.Typer()

STYLES = {"ok": "green", "warning": "yellow", "wrong": "bold red", "unknown": "dim"}


@command(app, "fringebench import capture.toml -o stack.exr")
def import_capture(
    manifest: Path,
    output: Path = Path("stack.exr"),
    check: bool = False,
    force: bool = False,
    equalise: bool = False,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Turn image files and a calibration into a stack, after checking that they are what the manifest says.

    What the images contradict (frames exchanged, a wrong period, another camera's calibration) is refused with the reason.
    With --check the exit status is 1 if a check says wrong.

    manifest: A manifest TOML: which image shows what (see docs/import.md).
    output: Stack file.
    check: Only check linearity, order and periods; write nothing.
    force: Write the stack although checks say it is wrong.
    equalise: Divide out a source that flickers or drifts between frames.
    as_json: Print the checks and the stack's data as JSON.
    """
    from fringebench.exchange.capture_import import checked
    from scenes.files.capture import Capture

    steps = progress_steps(progress)
    if not check:
        check_outputs({"-o": output}, [manifest])
    found = checked(Capture.load(manifest), equalise, steps)
    stack, report = found.stack, found.report
    if as_json:
        written = None if check or (report.wrong and not force) else str(output)
        print_json({"stack": written, **_described(stack), **report.to_dict()})
    else:
        table = Table("check", "", "what was found", title=escape(str(manifest)))
        for finding in report.findings:
            style = STYLES[finding.verdict]
            verdict = f"[{style}]{finding.verdict}[/]"
            table.add_row(escape(finding.name), verdict, escape(finding.message))
        print_figures([table])
        if report.not_verified:
            say("The images cannot show whether these parts of the manifest are right:")
            for key, why in report.not_verified.items():
                say(f"  {key}: {why}")
    if check:
        raise typer.Exit(1 if report.wrong else 0)
    if not force:
        report.raise_if_wrong()
    with steps.step("write"):
        stack.write(output)
    if not as_json:
        exposures, frames, rows, columns = stack.frames.shape
        rig = "calibrated" if stack.calibration else "not calibrated"
        say(f"{output}: {exposures} exposures, {frames} frames, {columns} x {rows} px, {rig}")


def _described(stack: "Stack") -> dict[str, Any]:
    """What was read, in JSON's types."""
    _, frames, rows, columns = stack.frames.shape
    return {
        "exposures_ms": list(stack.exposure_ms),
        "frames": frames,
        "camera_resolution": [columns, rows],
        "projector_resolution": stack.projector_size(),
        "calibrated": stack.calibration is not None,
        "dtype": str(stack.frames.dtype),
        "saturation_dn": stack.saturation_dn,
        "gamma": stack.gamma,
        "sensor": stack.sensor.model_dump(mode="json"),
    }


@command(app, "fringebench stereo left.exr right.exr stereo.yml --depth-mm 400 900")
def stereo(
    left: Path,
    right: Path,
    calibration: list[Path],
    depth_mm: Annotated[tuple[float, float], typer.Option(metavar="NEAR FAR")],
    output: Path = Path("reconstruction.exr"),
    mm_per_unit: opt.MmPerUnit = None,
    fusion: opt.Fusion = "max-modulation",
    name: opt.PartNames = [],  # noqa: B006
    roi: opt.Region = None,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Heights from two cameras that saw the same patterns; the projector needs no calibration.

    left: Stack EXR of the first camera.
    right: Stack EXR of the second camera.
    calibration: OpenCV calibration of the pair: one file or several.
    depth_mm: Depths to search in front of the first camera.
    output: Reconstruction file.
    roi: Only this region of the first camera.
    """
    check_outputs({"-o": output}, [left, right, *calibration])
    import scenes
    from decode.stereo_phase import stereo as match
    from scenes.rig.opencv_calibration import Source

    entries = part_names(name)
    stacks = [scenes.Stack.read(path) for path in (left, right)]
    pair = Source(files=tuple(calibration), mm_per_unit=mm_per_unit, names=entries).pair()
    cameras = pair.cameras(stacks[0].resolution, stacks[1].resolution)
    with progress_steps(progress).step("match") as done:
        rec = match(
            stacks[0],
            stacks[1],
            cameras,
            (-depth_mm[1], -depth_mm[0]),
            fusion=fusion,
            roi=roi,
            progress=done,
        )
    rec.write(output)
    shares = rec.reason_fractions()
    data = {"reconstruction": str(output), "reasons": shares, "settings": rec.settings}
    answer(as_json, data, f"{output}: {shares['ok']:.1%} of the pixels measured")
