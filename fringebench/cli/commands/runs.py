"""The pipeline as a whole, and what is shipped and installed: run, scenes, chapter, doctor."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from fringebench.cli import shared_options as opt
from fringebench.cli.overrides import parse_overrides
from fringebench.cli.registration import command
from fringebench.cli.terminal import answer_console, print_figures, print_json, progress_steps, say
from fringebench.progress import Mode

app = typer.Typer()

NAIVE_TITLE = "one exposure, saturation ignored (the textbook's warning)"


@command(app, "fringebench run solder --set camera.resolution=[320,240] -o out")
def run(
    scene: opt.SceneName = "bench",
    output: opt.Folder = None,
    settings: opt.Settings = [],  # noqa: B006
    phase_error: opt.PhaseError = None,
    render_noise: opt.RenderNoise = None,
    seed: opt.Seed = 0,
    fusion: opt.Fusion = "max-modulation",
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Trace light, expose, decode and score a scene; write every file and a report, and print the scores."""
    import scenes
    from fringebench import verbs
    from scenes.support.paths import as_file_name

    loaded = scenes.load(scene, parse_overrides(settings, phase_error, render_noise))
    folder = output or Path(f"fringebench-{as_file_name(loaded.name)}")
    result = verbs.run(loaded, folder, seed, fusion, progress_steps(progress))
    if as_json:
        print_json(result.score.to_dict())
        return
    from fringebench.experiments.noise_summary import describe, describe_regions
    from fringebench.pages.score_tables import (
        extra_tables,
        fused_title,
        outliers_in_words,
        score_table,
    )

    console = answer_console()
    fused = score_table(result.score, fused_title(len(result.stack.exposure_ms), fusion))
    print_figures([score_table(result.naive, NAIVE_TITLE), fused, *extra_tables(result.score)])
    said = describe(result.score.light) if result.score.light else describe_regions(result.score)
    for line in filter(None, (said, outliers_in_words(result.score))):
        console.print(line, soft_wrap=True)
    spent = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in result.seconds.items())
    say(f"files in {result.folder}  ({spent})")


@command(app, "fringebench scenes bench > mine.toml")
def list_scenes(
    name: Annotated[str | None, typer.Argument()] = None,
    schema: bool = False,
    settings: opt.Settings = [],  # noqa: B006
    as_json: opt.AsJson = False,
) -> None:
    """List the shipped scenes, print one's TOML, or print the schema.

    name: Print this scene's TOML.
    schema: Print the JSON schema of scene files.
    """
    import scenes

    if schema:
        print_json(scenes.schema())
    elif name:
        if as_json:
            print_json(scenes.load(name, parse_overrides(settings)).model_dump(mode="json"))
        elif settings:
            sys.stdout.write(scenes.dumps(scenes.load(name, parse_overrides(settings))))
        else:
            sys.stdout.write(scenes.source(name))
    else:
        listed = {n: scenes.load(n).description for n in scenes.shipped()}
        if as_json:
            print_json(listed)
        else:
            from rich.table import Table

            table = Table("scene", "what it shows")
            for shipped, description in listed.items():
                table.add_row(shipped, description)
            print_figures([table])


@command(app, "fringebench chapter -o figures --json")
def chapter(
    output: opt.Folder = None,
    seed: opt.Seed = 0,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Repeat the textbook chapter's experiments; compare its figures with theory and with what is measured."""
    from fringebench.experiments.textbook import run as run_chapter
    from fringebench.pages.chapter_page import chapter_report, chapter_table

    result = run_chapter(output, seed, progress_steps(progress), chapter_report)
    if as_json:
        print_json(result.to_dict())
        return
    print_figures([chapter_table(result)])
    if output:
        say(f"figures in {output}")


@command(app, "fringebench doctor --json")
def doctor(as_json: opt.AsJson = False) -> None:
    """Show what this machine has, and what to do about what is missing."""
    from fringebench.diagnosis import diagnose

    diagnosis = diagnose()
    if as_json:
        print_json(diagnosis.to_dict())
    else:
        from fringebench.pages.score_tables import doctor_table

        print_figures([doctor_table(diagnosis)])
        for problem in diagnosis.problems:
            answer_console().print(f"[bold red]missing:[/] {escape(problem)}")
    if not diagnosis.healthy:
        raise typer.Exit(2)
