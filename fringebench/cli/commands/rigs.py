"""Commands about rigs: twin, calibrate, accept."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from fringebench.cli import shared_options as opt
from fringebench.cli.outputs import check_outputs
from fringebench.cli.overrides import parse_overrides, part_names
from fringebench.cli.registration import command
from fringebench.cli.terminal import (
    answer,
    answer_console,
    print_figures,
    print_json,
    progress_steps,
)
from fringebench.pages.figure_tables import number
from fringebench.progress import Mode

app = typer.Typer()


@command(app, "fringebench twin procam.yml -o mine.toml --distance-mm 600")
def twin(
    output: Path,
    distance_mm: Annotated[float, typer.Option()],
    calibration: Annotated[list[Path], typer.Argument()] = [],  # noqa: B006
    camera: Annotated[str, typer.Option(metavar="SHEET")] = "",
    projector: Annotated[str, typer.Option(metavar="SHEET")] = "",
    baseline_mm: float = 100.0,
    camera_size: Annotated[tuple[int, int] | None, typer.Option(metavar="COLUMNS ROWS")] = None,
    projector_size: Annotated[tuple[int, int] | None, typer.Option(metavar="COLUMNS ROWS")] = None,
    mm_per_unit: opt.MmPerUnit = None,
    second_to_first: bool = False,
    name: opt.PartNames = [],  # noqa: B006
    as_json: opt.AsJson = False,
) -> None:
    """Turn a calibration or two data sheets into a scene: the user's own rig in front of a plate, a cap and a step.

    output: Scene TOML to write.
    distance_mm: Working distance in front of the camera.
    calibration: OpenCV calibration: one file, or several.
    camera: Without a file: '2448x2048, 3.45 um, f 16 mm'.
    projector: Likewise: '1280x800, throw 1.4, offset 100 %'.
    baseline_mm: Of data sheets: projector to the right of the camera.
    camera_size: If the file does not say.
    projector_size: If the file does not say.
    second_to_first: R and T take projector points to the camera.
    """
    check_outputs({"-o": output}, calibration)
    import scenes
    from fringebench.experiments.rigs.data_sheet import rig_of_sheets
    from fringebench.experiments.rigs.rig_twin import twin as make
    from scenes.rig.opencv_calibration import Source
    from scenes.support.errors import FileError

    if bool(calibration) == bool(camera or projector) or bool(camera) != bool(projector):
        raise FileError("give either the files of a calibration, or --camera and --projector")
    if calibration:
        source = Source(
            files=tuple(calibration),
            names=part_names(name),
            mm_per_unit=mm_per_unit,
            second_to_first=second_to_first,
            distance_mm=distance_mm,
        )
        rig = source.calibration(camera_size, projector_size)
        scene = make(rig, output.stem, distance_mm)
    else:
        sheets = rig_of_sheets(camera, projector, distance_mm, baseline_mm)
        scene = make(sheets.calibration, output.stem, distance_mm, sheets.sensor)
    scenes.save(scene, output)
    eye, light = scene.camera.projection(), scene.projectors[0].projection()
    answer(
        as_json,
        {"scene": str(output)},
        f"{output}: camera {eye.width} x {eye.height}, projector {light.width} x {light.height}, "
        f"z = 0 at {distance_mm:g} mm; next: fringebench run {output}",
    )


@command(app, "fringebench calibrate bench --poses 20 --board charuco")
def calibrate(
    scene: opt.SceneName = "bench",
    board: str = "checkerboard",
    poses: Annotated[int, typer.Option(min=4)] = 15,
    output: Path | None = None,
    settings: opt.Settings = [],  # noqa: B006
    seed: opt.Seed = 0,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Render a chart in several poses, calibrate from the images with OpenCV, and compare with the rendered rig.

    board: checkerboard or charuco.
    poses: Pictures of the chart.
    output: Also write the calibration (.yml, .xml, .json).
    seed: Seed of poses, light paths and noise.
    """
    check_outputs({"-o": output}, [scene])
    import scenes
    from fringebench.experiments.rigs.virtual_calibration import calibrate as run
    from scenes.rig import opencv_calibration
    from scenes.support.errors import FileError

    if board not in ("checkerboard", "charuco"):
        raise FileError(f"--board '{board}': choose checkerboard or charuco")
    loaded = scenes.load(scene, parse_overrides(settings))
    result = run(loaded, board, poses, seed, progress_steps(progress))  # type: ignore[arg-type]
    if output:
        opencv_calibration.write(output, result.found)
    if as_json:
        print_json(result.to_dict())
        return
    table = Table("", "rendered", "found", "difference", title=escape(f"{loaded.name}, {board}"))
    for row, true, found, difference in result.rows():
        relative = row.endswith(("fx_px", "fy_px", "baseline_mm"))
        table.add_row(
            row,
            f"{true:.5g}",
            f"{found:.6g}",
            f"{number(difference, 100, 3, signed=True)} %" if relative else f"{difference:+.4g}",
        )
    console = answer_console()
    print_figures([table])
    console.print(
        f"{result.views} views, {result.corners} corners; reprojection error camera {result.camera_rms_px:.4f} px, projector "
        f"{result.projector_rms_px:.4f} px, together {result.stereo_rms_px:.4f} px; corners found to "
        f"{result.corner_noise_px[0]:.4f} and {result.corner_noise_px[1]:.4f} px a coordinate"
    )


@command(app, "fringebench accept mine.toml --limit-um 50")
def accept(
    rig: opt.SceneName,
    limit_um: float | None = None,
    settings: opt.Settings = [],  # noqa: B006
    seed: opt.Seed = 0,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Acceptance test after VDI/VDE 2634-2 and ISO 10360-13: probing error, sphere distance, flatness.

    limit_um: Maximum permissible error of every measure; exit status 1 above it.
    """
    import scenes
    from fringebench import verbs

    loaded = scenes.load(rig, parse_overrides(settings))
    result = verbs.accept(loaded, seed, progress_steps(progress))
    worst, noise = result.worst(), result.noise()
    if as_json:
        print_json(result.to_dict())
    else:
        table = Table(
            "measure", "worst", "noise alone", title=escape(f"{result.scene}, acceptance")
        )
        for name, value in worst.items():
            from_noise = f"{noise[name] * 1e3:.1f} µm" if name in noise else ""
            table.add_row(name, f"{value * 1e3:.1f} µm", from_noise)
        console = answer_console()
        print_figures([table])
        console.print(
            f"volume diagonal {result.diagonal_mm:.3g} mm, spheres {result.sphere_mm:.3g} mm, bar {result.bar_mm:.4g} mm, plane "
            f"{result.plane_mm[0]:.3g} x {result.plane_mm[1]:.3g} mm; {len(result.positions)} positions"
        )
    if limit_um is not None and max(worst.values()) * 1e3 > limit_um:
        raise typer.Exit(1)
