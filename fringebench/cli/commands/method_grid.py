"""The command that compares ways of measuring: methods."""

from typing import Annotated

import typer

from fringebench.cli import shared_options as opt
from fringebench.cli.registration import command
from fringebench.cli.terminal import print_figures, print_json, progress_steps, say
from fringebench.progress import Mode

app = typer.Typer()


@command(app, "fringebench methods --method active-stereo --surface matt --surface mirror -o out")
def methods(
    method: list[str] = [],  # noqa: B006
    surface: list[str] = [],  # noqa: B006
    output: opt.Folder = None,
    resolution: Annotated[tuple[int, int], typer.Option(metavar="COLUMNS ROWS")] = (200, 150),
    samples: opt.Count = 32,
    seed: opt.Seed = 0,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Measure every surface by every method: fringe projection, stereo by phase, dots or texture, deflectometry.

    With -o: methods.json, methods.png and report.html. All pairs take some minutes.

    method: fringe-projection, phase-stereo, active-stereo, passive-stereo or deflectometry; may be repeated. Default: all.
    surface: matt, glossy, black, translucent, solder, grains, mirror or step; may be repeated. Default: all.
    resolution: Pixels of the cameras.
    samples: As sampling.samples of a scene.
    """
    from fringebench import verbs

    steps = progress_steps(progress)
    found = verbs.methods(method or None, surface or None, output, resolution, samples, seed, steps)
    if as_json:
        print_json(found.to_dict())
        return
    from fringebench.pages.method_map_page import map_table

    print_figures([map_table(found)])
    if output:
        say(f"page in {output / 'report.html'}")
