"""Arguments and options that several commands share."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from fringebench.progress import Mode


def scene_names(incomplete: str) -> Iterator[str]:
    """What the shell completes a scene to: shipped names, TOML files and folders."""
    import scenes

    yield from (name for name in scenes.shipped() if name.startswith(incomplete))
    start = Path(incomplete)
    folder = start if incomplete.endswith("/") else start.parent
    if folder.is_dir():
        for path in sorted(folder.iterdir()):
            text = str(path) + ("/" if path.is_dir() else "")
            if text.startswith(incomplete) and (path.is_dir() or path.suffix == ".toml"):
                yield text


def fusion_rules(incomplete: str) -> list[str]:
    """What the shell completes a fusion rule to."""
    import decode

    return [name for name in decode.rules() if name.startswith(incomplete)]


SceneName = Annotated[
    str, typer.Argument(help="A shipped scene's name, or a TOML file.", autocompletion=scene_names)
]
Settings = Annotated[
    list[str],
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a key of the scene; may be repeated."
    ),
]
Folder = Annotated[Path | None, typer.Option("-o", "--output", help="Folder to write.")]
PhaseError = Annotated[
    float | None,
    typer.Option(
        "--phase-error",
        metavar="RAD",
        help="Trace until render noise moves the phase of 95 % of lit pixels by less (phase_error_rad in [sampling]).",
    ),
]
RenderNoise = Annotated[
    float | None,
    typer.Option(
        "--render-noise",
        metavar="SHARE",
        help="Trace until render noise is below this share of the sensor's noise in each label (render_noise in [sampling]).",
    ),
]
Count = Annotated[int, typer.Option(min=1)]
CountOrNone = Annotated[int | None, typer.Option(min=1)]
Listed = Annotated[
    str | None, typer.Option(metavar="LIST", help="Names separated by commas; all by default.")
]
Region = Annotated[tuple[int, int, int, int] | None, typer.Option(metavar="ROW0 ROW1 COL0 COL1")]
Seed = Annotated[int, typer.Option(help="Seed of light paths and sensor noise.", min=0)]
Fusion = Annotated[str, typer.Option(help="Exposure fusion rule.", autocompletion=fusion_rules)]
PartNames = Annotated[
    list[str],
    typer.Option(
        "--name",
        metavar="PART=NAME",
        help="The file's own name of a part, e.g. second_distortion=D2; may be repeated.",
    ),
]
MmPerUnit = Annotated[
    float | None, typer.Option(help="Millimetres per unit of the calibration: 1000 for metres.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
ShowProgress = Annotated[
    Mode,
    typer.Option(
        "--progress",
        help="auto: bars on a terminal, lines when piped and the work is long. plain: lines. none: nothing.",
    ),
]
