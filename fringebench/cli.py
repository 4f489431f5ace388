"""The command line. Exit status: 0 done, 1 a gate failed, 2 bad input or use; 70 a fault of ours."""

import io
import json
import os
import sys
import traceback
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from typer.core import TyperGroup

import scenes
from fringebench.commands_compare import register as register_compare
from fringebench.commands_dataset import register as register_dataset
from fringebench.commands_import import register as register_import
from fringebench.commands_pads import register as register_pads
from fringebench.commands_regress import register as register_regress
from fringebench.commands_rig import register as register_rig
from fringebench.commands_view import register as register_view
from fringebench.options import AsJson, Fusion, PhaseError, SceneName, Seed, Settings, ShowProgress
from fringebench.overrides import exposed_otherwise, parse_overrides
from fringebench.progress import Mode, Steps
from scenes.errors import DecodeError, FringebenchError, FringebenchWarning
from scenes.paths import as_file_name
from scenes.replace_file import require_writable

# What a shell reports for a command that Ctrl-C ended, and for one whose reader went away (| head).
INTERRUPTED, UNREAD = 130, 141
# "Internal software error" (sysexits.h): neither a gate's verdict nor the user's mistake.
FAULT = 70
NAIVE_TITLE = "one exposure, saturation ignored (what the chapter warns of)"


class _Commands(TyperGroup):
    """Ctrl-C is answered by us, with what was kept; typer would say "Aborted" and give status 1, a failed gate's."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stopped:
            kept = f"; {stopped}" if str(stopped) else "; no file is left half written"
            sys.stderr.write(f"fringebench: interrupted{kept}\n")
            raise typer.Exit(INTERRUPTED) from None
        except BrokenPipeError:
            # Typer would give status 1 here as well.
            _unheard()
            raise typer.Exit(UNREAD) from None


app = typer.Typer(
    name="fringebench",
    cls=_Commands,
    help="Render structured-light scenes, decode them, and score the heights against the mesh that was rendered.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

Output = Annotated[Path | None, typer.Option("-o", "--output", help="Where to write.")]
Input = Annotated[Path, typer.Argument(help="An EXR file of the step before.")]


@app.command(epilog="Example: fringebench run solder --set camera.resolution=[320,240] -o out")
def run(
    scene: SceneName = "bench",
    output: Output = None,
    settings: Settings = [],  # noqa: B006
    phase_error: PhaseError = None,
    seed: Seed = 0,
    fusion: Fusion = "max-modulation",
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """The whole way: trace, expose, decode, score; writes every file and prints the score table."""
    loaded = scenes.load(scene, parse_overrides(settings, phase_error))
    folder = output or Path(f"fringebench-{as_file_name(loaded.name)}")

    from fringebench.run import run as run_scene

    result = run_scene(loaded, folder, seed, fusion, _steps(progress))
    if as_json:
        _print_json(result.score.to_dict())
        return
    from fringebench.light import told
    from fringebench.tables import feature_table, fused_title, score_table

    console = _console()
    console.print(score_table(result.naive, NAIVE_TITLE))
    console.print(score_table(result.score, fused_title(len(result.stack.exposure_ms), fusion)))
    if result.score.features:
        console.print(feature_table(result.score))
    if result.score.light:
        console.print(told(result.score.light), highlight=False, soft_wrap=True)
    spent = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in result.seconds.items())
    sys.stdout.write(f"files in {result.folder}  ({spent})\n")


@app.command("scenes", epilog="Example: fringebench scenes bench > mine.toml")
def list_scenes(
    name: Annotated[str | None, typer.Argument(help="Print this scene's TOML.")] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of scene files.")
    ] = False,
    settings: Settings = [],  # noqa: B006
    as_json: AsJson = False,
) -> None:
    """List the shipped scenes, print one's TOML, or print the schema."""
    if schema:
        _print_json(scenes.schema())
    elif name:
        if as_json:
            _print_json(scenes.load(name, parse_overrides(settings)).model_dump(mode="json"))
        elif settings:
            sys.stdout.write(scenes.dumps(scenes.load(name, parse_overrides(settings))))
        else:
            sys.stdout.write(scenes.source(name))
    else:
        listed = {n: scenes.load(n).description for n in scenes.shipped()}
        if as_json:
            _print_json(listed)
        else:
            from rich.table import Table

            table = Table("scene", "what it shows")
            for shipped, description in listed.items():
                table.add_row(shipped, description)
            _console().print(table)


@app.command("render", epilog="Example: fringebench render step -o transport.exr --truth truth.exr")
def render_scene(
    scene: SceneName,
    output: Annotated[Path, typer.Option("-o", "--output", help="Transport file.")] = Path(
        "transport.exr"
    ),
    truth: Annotated[Path | None, typer.Option(help="Also write the truth maps here.")] = None,
    settings: Settings = [],  # noqa: B006
    phase_error: PhaseError = None,
    seed: Seed = 0,
    samples: Annotated[
        int | None,
        typer.Option(help="Light paths per pixel; with --phase-error, of each pass.", min=1),
    ] = None,
    depth: Annotated[
        int | None, typer.Option(help="Surfaces light may meet; 1: direct only.", min=1)
    ] = None,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Trace a scene's light transport, once, for all its patterns."""
    loaded = scenes.load(scene, parse_overrides(settings, phase_error))
    require_writable(output, truth)
    import render
    from fringebench.light import figures, told

    steps = _steps(progress)
    with steps.step("trace light") as done:
        surfaces = render.surfaces(loaded)
        transport = render.trace(
            loaded,
            seed=seed,
            samples=samples,
            depth=depth,
            progress=done,
            phase_error_rad=phase_error,
            surfaces=surfaces,
        )
        transport.write(output)
    if truth:
        with steps.step("truth"):
            render.truth(loaded, transport, surfaces).write(truth)
    if as_json:
        written = {"transport": str(output), "truth": str(truth) if truth else None}
        traced = {"samples": transport.samples, "depth": transport.depth}
        light = figures(transport)
        _print_json(written | traced | ({"light": light} if light else {}))
        return
    channels = sum(len(basis.channels) for basis in transport.bases)
    rows, columns = transport.ambient.shape
    sys.stdout.write(
        f"{output}: {columns} x {rows} px, {channels} channels, {transport.samples} samples per pixel\n"
    )
    if truth:
        sys.stdout.write(f"{truth}: {', '.join(transport.labels)}\n")
    if light := figures(transport):
        _console().print(told(light), highlight=False, soft_wrap=True)


@app.command(
    epilog="Example: fringebench expose transport.exr -o stack.exr --exposure-ms 2 --exposure-ms 8"
)
def expose(
    transport: Input,
    output: Annotated[Path, typer.Option("-o", "--output", help="Stack file.")] = Path("stack.exr"),
    exposure_ms: Annotated[
        list[float], typer.Option(help="Exposure time; may be repeated. Default: the scene's own.")
    ] = [],  # noqa: B006
    settings: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override a key of sensor, exposures or patterns; may be repeated.",
        ),
    ] = [],  # noqa: B006
    seed: Seed = 0,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Turn transport into frames of digital numbers: exposures, noise, clipping."""
    import render

    light = render.Transport.read(transport)
    scene = exposed_otherwise(light.scene, settings)
    require_writable(output)
    with _steps(progress).step("expose") as done:
        stack = render.expose(
            light,
            seed=seed,
            sensor=scene.sensor,
            exposures=exposure_ms or scene.exposures,
            patterns=scene.patterns,
            progress=done,
        )
        stack.write(output)
    if as_json:
        levels = {"exposure_ms": stack.exposure_ms, "saturation_dn": stack.saturation_dn}
        _print_json({"stack": str(output), "shape": stack.frames.shape} | levels)
        return
    times = ", ".join(f"{time:.4g}" for time in stack.exposure_ms)
    frames, rows, columns = stack.frames.shape[1:]
    sys.stdout.write(f"{output}: {frames} frames at {times} ms, {columns} x {rows} px\n")


@app.command(
    "decode", epilog="Example: fringebench decode stack.exr -o reconstruction.exr --fusion single"
)
def decode_stack(
    stack: Input,
    output: Annotated[Path, typer.Option("-o", "--output", help="Reconstruction file.")] = Path(
        "reconstruction.exr"
    ),
    fusion: Fusion = "max-modulation",
    unwrap: Annotated[
        str | None, typer.Option(help="Unwrapping: temporal, row-scan, quality-guided.")
    ] = None,
    height: Annotated[
        str | None,
        typer.Option(
            help="Height: triangulation, reference-plane, linear; phase: none, phases only."
        ),
    ] = None,
    c_px_per_mm: Annotated[
        float | None,
        typer.Option(
            help="Fringe shift per mm of height, for a linear height without calibration."
        ),
    ] = None,
    gamma: Annotated[
        str | None,
        typer.Option(help="Undo this gamma in the phase; 'estimate': from the fringes' harmonics."),
    ] = None,
    roi: Annotated[
        tuple[int, int, int, int] | None,
        typer.Option(metavar="ROW0 ROW1 COL0 COL1", help="Decode only this region."),
    ] = None,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Reconstruct heights from a stack."""
    import decode

    number: float | str | None = gamma
    if gamma is not None and gamma != "estimate":
        try:
            number = float(gamma)
        except ValueError:
            raise DecodeError(f"--gamma '{gamma}': give a number, or 'estimate'") from None
    require_writable(output)

    with _steps(progress).step("decode"):
        reconstruction = decode.reconstruct(
            scenes.Stack.read(stack),
            fusion=fusion,
            unwrap=unwrap,
            height=height,
            c_px_per_mm=c_px_per_mm,
            gamma=number,
            roi=roi,
        )
        reconstruction.write(output)
    if as_json:
        told = {"reasons": reconstruction.reason_fractions(), "settings": reconstruction.settings}
        _print_json({"reconstruction": str(output)} | told)
        return
    shares = dict(reconstruction.reason_fractions())
    measured = f"{shares.pop('ok'):.1%} of the pixels measured"
    lost = "".join(f"; {reason} {share:.2%}" for reason, share in shares.items())
    sys.stdout.write(f"{output}: {measured}{lost}\n")


@app.command(epilog="Example: fringebench evaluate reconstruction.exr truth.exr --json")
def evaluate(
    reconstruction: Input,
    truth: Annotated[Path, typer.Argument(help="The truth file.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Also write scores JSON here.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score a reconstruction against the truth."""
    import decode
    import evaluation

    score = evaluation.score(decode.Reconstruction.read(reconstruction), scenes.Truth.read(truth))
    if output:
        score.write(output)
    if as_json:
        _print_json(score.to_dict())
        return
    from fringebench.tables import feature_table, score_table

    _console().print(score_table(score, escape(str(reconstruction))))
    if score.features:
        _console().print(feature_table(score))


@app.command(epilog="Example: fringebench chapter -o figures --json")
def chapter(
    output: Output = None,
    seed: Seed = 0,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """The chapter's three captures: its figures as PNGs, and chapter beside theory beside measured."""
    from fringebench.chapter import run as run_chapter

    result = run_chapter(output, seed, _steps(progress))
    if as_json:
        _print_json(result.to_dict())
        return
    from fringebench.tables import chapter_table

    _console().print(chapter_table(result))
    if output:
        sys.stdout.write(f"figures in {output}\n")


@app.command(epilog="Example: fringebench doctor --json")
def doctor(as_json: AsJson = False) -> None:
    """What this machine has, and what to do about what is missing."""
    from fringebench.doctor import diagnose

    diagnosis = diagnose()
    if as_json:
        _print_json(diagnosis.to_dict())
    else:
        from fringebench.tables import doctor_table

        _console().print(doctor_table(diagnosis))
        for problem in diagnosis.problems:
            _console().print(f"[bold red]missing:[/] {escape(problem)}")
    if not diagnosis.healthy:
        raise typer.Exit(2)


register_compare(app)
register_regress(app)
register_dataset(app)
register_pads(app)
register_import(app)
register_rig(app)
register_view(app)


def main() -> None:
    """Run the command line; errors a user can mend are one message and status 2."""
    warnings.showwarning = _warn
    sys.exit(_status())


def _status() -> Any:
    """Run a command, and give its exit status once all that it said has arrived."""
    # A program that was started without them (`>&-`) has none.
    sys.stdout = sys.stdout or io.StringIO()
    sys.stderr = sys.stderr or io.StringIO()
    for stream in (sys.stdout, sys.stderr):
        # A terminal without micrometres, or a name that is no UTF-8, is no reason to lose an answer.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        status: Any = 0
        try:
            app()
        except SystemExit as leaving:
            status = leaving.code
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        sys.stderr.write("fringebench: interrupted\n")
        return INTERRUPTED
    except FringebenchError as error:
        sys.stderr.write(f"fringebench: {error}\n")
    except MemoryError:
        sys.stderr.write(
            "fringebench: out of memory; use fewer pixels, frames or exposures, or a larger machine\n"
        )
    except BrokenPipeError:
        _unheard()
        return status or UNREAD
    except OSError as error:
        where = "the answer" if error.filename is None else f"'{error.filename}'"
        sys.stderr.write(
            f"fringebench: {where} cannot be written or read: {error.strerror or error}\n"
        )
        _unheard()
    except Exception:
        traceback.print_exc()
        sys.stderr.write(
            "fringebench: this is a fault of fringebench, not of yours: please report it\n"
        )
        return FAULT
    return 2


def _unheard() -> None:
    """Nothing more can be said: let what is left go nowhere, or Python complains at its end."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _warn(message: Warning | str, category: type[Warning], *where: Any, **line: Any) -> None:
    """Ours in one line, as errors are; others as Python shows them."""
    text = (
        f"fringebench: {message}\n"
        if issubclass(category, FringebenchWarning)
        else warnings.formatwarning(message, category, *where[:2])
    )
    sys.stderr.write(text)


def _console() -> Console:
    return Console()


def _steps(mode: Mode) -> Steps:
    return Steps(Console(stderr=True), mode)


def _print_json(value: Any) -> None:
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
