"""Commands about rigs: twin, calibrate, accept."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fringebench.options import AsJson, SceneName, Settings, ShowProgress
from fringebench.progress import Mode, Steps
from scenes.errors import FileError
from scenes.replace_file import require_writable

Names = Annotated[
    list[str],
    typer.Option(
        "--name", metavar="PART=NAME", help="What the file calls a part: first_matrix=A; repeated."
    ),
]


def twin(
    calibration: Annotated[
        list[Path], typer.Argument(help="OpenCV calibration: one file, or several.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Scene TOML to write.")],
    distance_mm: Annotated[float, typer.Option(help="Working distance in front of the camera.")],
    camera_size: Annotated[
        tuple[int, int] | None,
        typer.Option(metavar="COLUMNS ROWS", help="If the file does not say."),
    ] = None,
    projector_size: Annotated[
        tuple[int, int] | None,
        typer.Option(metavar="COLUMNS ROWS", help="If the file does not say."),
    ] = None,
    mm_per_unit: Annotated[
        float, typer.Option(help="Millimetres per unit of the calibration: 1000 for metres.")
    ] = 1.0,
    second_to_first: Annotated[
        bool, typer.Option(help="R and T take projector points to the camera.")
    ] = False,
    name: Names = [],  # noqa: B006
    as_json: AsJson = False,
) -> None:
    """Turn a calibration into a scene: the user's own rig, rendered before a plate, a cap and a step."""
    import scenes
    from fringebench.twin import twin as make
    from scenes.opencv_calibration import Source

    source = Source(
        files=tuple(calibration),
        names=_names(name),
        mm_per_unit=mm_per_unit,
        second_to_first=second_to_first,
        distance_mm=distance_mm,
    )
    scene = make(source, output.stem, camera_size, projector_size)
    scenes.save(scene, output)
    if as_json:
        sys.stdout.write(json.dumps({"scene": str(output)}, indent=2) + "\n")
        return
    eye, light = scene.camera.projection(), scene.projectors[0].projection()
    sys.stdout.write(
        f"{output}: camera {eye.width} x {eye.height}, projector {light.width} x {light.height}, "
        f"z = 0 at {distance_mm:g} mm; next: fringebench run {output}\n"
    )


def calibrate(
    scene: SceneName = "bench",
    board: Annotated[str, typer.Option(help="checkerboard or charuco.")] = "checkerboard",
    poses: Annotated[int, typer.Option(help="Pictures of the chart.", min=4)] = 15,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Also write what OpenCV found (.yml, .xml, .json)."),
    ] = None,
    settings: Settings = [],  # noqa: B006
    seed: Annotated[int, typer.Option(help="Seed of poses, light and noise.", min=0)] = 0,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Render a chart in poses, run OpenCV's camera-projector calibration, and hold it against the rendered rig."""
    import scenes
    from fringebench.overrides import parse_overrides
    from fringebench.virtual_calibration import calibrate as run
    from scenes import opencv_calibration

    if board not in ("checkerboard", "charuco"):
        raise FileError(f"--board '{board}': choose checkerboard or charuco")
    loaded = scenes.load(scene, parse_overrides(settings))
    require_writable(output)
    landed = run(loaded, board, poses, seed, Steps(Console(stderr=True), progress))  # type: ignore[arg-type]
    if output:
        opencv_calibration.write(output, landed.found)
    if as_json:
        sys.stdout.write(json.dumps(landed.to_dict(), indent=2) + "\n")
        return
    table = Table("", "rendered", "found", "difference", title=escape(f"{loaded.name}, {board}"))
    for row, true, found, difference in landed.rows():
        relative = row.endswith(("fx_px", "fy_px", "baseline_mm"))
        table.add_row(
            row,
            f"{true:.5g}",
            f"{found:.6g}",
            f"{difference:+.3%}" if relative else f"{difference:+.4g}",
        )
    console = Console(highlight=False)
    console.print(table)
    console.print(
        f"{landed.views} views, {landed.corners} corners; reprojection error camera {landed.camera_rms_px:.4f} px, projector "
        f"{landed.projector_rms_px:.4f} px, together {landed.stereo_rms_px:.4f} px; corners found to "
        f"{landed.corner_noise_px[0]:.4f} and {landed.corner_noise_px[1]:.4f} px a coordinate"
    )


def accept(
    rig: SceneName,
    limit_um: Annotated[
        float | None,
        typer.Option(help="Largest error permitted in any measure; exit status 1 beyond."),
    ] = None,
    settings: Settings = [],  # noqa: B006
    seed: Annotated[int, typer.Option(help="Seed of light and noise.", min=0)] = 0,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Acceptance test after VDI/VDE 2634-2 and ISO 10360-13: probing error, sphere distance, flatness."""
    import scenes
    from fringebench.acceptance import accept as run
    from fringebench.overrides import parse_overrides

    loaded = scenes.load(rig, parse_overrides(settings))
    result = run(loaded, seed, Steps(Console(stderr=True), progress))
    worst, noise = result.worst(), result.noise()
    if as_json:
        sys.stdout.write(json.dumps(result.to_dict(), indent=2) + "\n")
    else:
        table = Table(
            "measure", "worst", "noise alone", title=escape(f"{result.scene}, acceptance")
        )
        for name, value in worst.items():
            told = f"{noise[name] * 1e3:.1f} µm" if name in noise else ""
            table.add_row(name, f"{value * 1e3:.1f} µm", told)
        console = Console(highlight=False)
        console.print(table)
        console.print(
            f"volume diagonal {result.diagonal_mm:.3g} mm, spheres {result.sphere_mm:.3g} mm, bar {result.bar_mm:.4g} mm, plane "
            f"{result.plane_mm[0]:.3g} x {result.plane_mm[1]:.3g} mm; {len(result.positions)} positions"
        )
    if limit_um is not None and max(worst.values()) * 1e3 > limit_um:
        raise typer.Exit(1)


def _names(given: list[str]) -> dict[str, str]:
    names = {}
    for text in given:
        part, equals, name = text.partition("=")
        if not equals or not part or not name:
            raise FileError(f"--name '{text}': write PART=NAME, such as first_matrix=cam_K")
        names[part] = name
    return names


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command(epilog="Example: fringebench twin procam.yml -o mine.toml --distance-mm 600")(twin)
    app.command(epilog="Example: fringebench calibrate bench --poses 20 --board charuco")(calibrate)
    app.command(epilog="Example: fringebench accept mine.toml --limit-um 50")(accept)
