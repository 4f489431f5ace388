"""``fringebench pads``, inspect a board's paste and how good that is; ``fringebench board``, look at its files."""

from collections import Counter
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from fringebench.cli import shared_options as opt
from fringebench.cli.outputs import check_outputs
from fringebench.cli.overrides import parse_overrides
from fringebench.cli.registration import command
from fringebench.cli.terminal import print_figures, print_json, progress_steps, say
from fringebench.pages.figure_tables import figure_table, number
from fringebench.progress import Mode

if TYPE_CHECKING:
    from fringebench.experiments.pad_inspection import Inspection
    from scenes import Scene

app = typer.Typer()


@command(app, "fringebench pads spi --budget")
def pads(
    source: Annotated[
        str, typer.Argument(metavar="SCENE_OR_STACK", autocompletion=opt.scene_names)
    ] = "spi",
    output: Path | None = None,
    truth: Path | None = None,
    board: Annotated[str | None, typer.Option(metavar="SCENE")] = None,
    restart_pad_ids: bool = False,
    threshold_um: Annotated[float, typer.Option(min=0.0)] = 40.0,
    budget: bool = False,
    gauge: bool = False,
    settings: opt.Settings = [],  # noqa: B006
    phase_error: opt.PhaseError = None,
    render_noise: opt.RenderNoise = None,
    seed: opt.Seed = 0,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Measure a board's paste as an inspection machine does: volume, area, height, offset and defects against the truth.

    Of a scene, of frames made from one, or of real frames with --board.

    source: A shipped scene's name, a TOML file, or frames (stack.exr).
    output: Measured pads as CSV, in the columns of SPI machines.
    truth: True pads as CSV, in the same columns.
    board: For frames of a real board: the scene whose board has its artwork.
    restart_pad_ids: PadID restarts on each board of a panel, as on some machines.
    threshold_um: Height above the pad from which paste counts, µm.
    budget: Error budget: what metal, grains, noise and the threshold contribute.
    gauge: Gauge study: repeats, sensors and places.
    """
    import scenes
    from evaluation.inspection.spi_csv import write_spi_csv
    from scenes.support.errors import SceneError

    check_outputs({"-o": output, "--truth": truth}, [source])
    frames = Path(source).suffix.lower() == ".exr"
    _check_use(frames, board, truth, budget or gauge)
    overrides = parse_overrides(settings, phase_error, render_noise)
    steps = progress_steps(progress)
    if board is not None:
        artwork = scenes.load(board, overrides)
        _capture(source, artwork, output, restart_pad_ids, threshold_um, as_json)
        return
    from evaluation.scoring.error_budget import RENDER_NOISE
    from fringebench.experiments.pad_inspection import DEVICES, inspect, inspect_stack, pad_budget
    from fringebench.experiments.pad_inspection import gauge as study

    if frames:
        stack = scenes.Stack.read(source)
        if not stack.scene:
            raise SceneError(f"'{source}' names no scene: give the board's artwork with --board")
        loaded = scenes.parse(stack.scene, overrides, where=f"the scene of '{source}'")
        found = inspect_stack(stack, loaded, threshold_um * 1e-3)
    else:
        loaded = scenes.load(source, overrides)
        found = inspect(loaded, seed, threshold_um * 1e-3, steps=steps)
    for pads_, path in ((found.measured, output), (found.board.pads, truth)):
        if path is not None:
            write_spi_csv(
                pads_, found.board, path, panel=loaded.name, restart_pad_ids=restart_pad_ids
            )
    answer: dict[str, Any] = {
        "threshold_um": threshold_um,
        "threshold_bias_percent": found.threshold_bias_percent,
        "errors": asdict(found.errors),
        "warp": _warp(found),
        "confusion": found.confusion.to_dict(),
        "pads": [asdict(pad) for pad in found.measured],
    }
    taken = f"pads against truth; the {threshold_um:g} um threshold alone removes {-found.threshold_bias_percent:.1f} %"
    tables = [_errors({"as measured": found.errors}, taken), _gates(answer["confusion"])]
    if budget:
        rows = pad_budget(loaded, seed, steps)
        answer["budget"] = {name: asdict(errors) for name, errors in rows.items()}
        answer["absent"] = [cause for cause in (*DEVICES, RENDER_NOISE) if cause not in rows]
        title = "one cause at a time, pads of 0.3 mm and more; absent: " + ", ".join(
            answer["absent"]
        )
        tables.append(_errors(rows, title))
    if gauge:
        result = study(loaded, seed, threshold_mm=threshold_um * 1e-3, steps=steps)
        answer["gauge"] = result.to_dict()
        tables.append(_study(answer["gauge"]))
    if as_json:
        print_json(answer)
        return
    print_figures(tables)


def _warp(found: "Inspection") -> dict[str, float] | None:
    """Measured tilt and bow; None where the pads do not fix them."""
    from evaluation.inspection.pad_measurement import measured_warp
    from scenes.support.errors import ScoreError

    try:
        return asdict(measured_warp(found.measured, found.board))
    except ScoreError:
        return None


def _check_use(frames: bool, board: str | None, truth: Path | None, traces: bool) -> None:
    """`SceneError` for options that exclude each other."""
    from scenes.support.errors import SceneError

    if frames and traces:
        raise SceneError("--budget and --gauge trace a scene again: give the scene, not its frames")
    if board is not None and not frames:
        raise SceneError(
            "--board is for frames of a real board: give a stack, for example stack.exr"
        )
    if board is not None and truth is not None:
        raise SceneError("the truth of real frames is not known: leave out --truth")


def _capture(
    source: str,
    artwork: "Scene",
    output: Path | None,
    restart: bool,
    threshold_um: float,
    as_json: bool,
) -> None:
    """Measure real frames: verdicts at the usual limits, without a truth."""
    import scenes
    from evaluation.inspection.pad_limits import PadLimits, judge
    from evaluation.inspection.spi_csv import write_spi_csv
    from fringebench.experiments.pad_inspection import measure_capture

    nominal, measured = measure_capture(scenes.Stack.read(source), artwork, threshold_um * 1e-3)
    if output is not None:
        write_spi_csv(measured, nominal, output, panel=Path(source).stem, restart_pad_ids=restart)
    counts = Counter(
        verdict
        for pad, true in zip(measured, nominal.pads, strict=True)
        for verdict in judge(pad, true, PadLimits())
    )
    if as_json:
        pads = [asdict(pad) for pad in measured]
        print_json({"threshold_um": threshold_um, "verdicts": dict(counts), "pads": pads})
        return
    rows = [(name, str(count)) for name, count in counts.most_common()]
    table = figure_table(f"{len(measured)} pads measured", "verdict", ["pads"], rows)
    print_figures([table])


def _errors(errors: dict[str, Any], title: str) -> Table:
    figures = "pads", "not seen", "vol. %", "sd %", "worst %", "area %", "h µm", "offs. µm"
    rows = [
        [
            name,
            str(e.pads),
            str(e.unmeasured),
            number(e.volume_bias_percent, 1, 2, signed=True),
            f"{e.volume_sd_percent:.2f}",
            f"{e.volume_max_percent:.1f}",
            number(e.area_bias_percent, 1, 1, signed=True),
            number(e.height_bias_mm, 1e3, 2, signed=True),
            f"{1e3 * e.offset_rms_mm:.2f}",
        ]
        for name, e in errors.items()
    ]
    # Without vertical lines the widest figures fit into 80 columns.
    return figure_table(title, "", figures, rows, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))


def _gates(confusion: dict[str, Any]) -> Table:
    keys = ("caught", "escaped", "false_calls", "passed")
    rows = [[name, *(str(gate[k]) for k in keys)] for name, gate in confusion["gates"].items()]
    figures = (key.replace("_", " ") for key in keys)
    return figure_table("accept or reject, measured against true", "limit", figures, rows)


def _study(study: dict[str, Any]) -> Table:
    table = Table(title="gauge study of volume, % of nominal", title_justify="left")
    for name in ("EV", "reprod.", "GRR", "% of tolerance", "% of study", "categories"):
        table.add_column(name, justify="right")
    shown = {"ev": 3, "reproducibility": 3, "grr": 3}
    shown |= {"grr_percent_of_tolerance": 1, "grr_percent_of_study": 1, "distinct_categories": 0}
    table.add_row(*(f"{study[name]:.{digits}f}" for name, digits in shown.items()))
    return table


class Action(StrEnum):
    """What to do with a board's files."""

    CHECK = "check"


@command(app, "fringebench board check gerbers -o board.png")
def board_files(
    action: Action,
    folder: Path,
    output: Path | None = None,
    bottom: bool = False,
    as_json: opt.AsJson = False,
) -> None:
    """Read the layers of one side of a board with two independent readers, and list pads outside the outline.

    The second reader is gerbonara. Status 1: they differ by more than 0.2 % of a layer's area, or pads are outside.

    action: check: read the files twice.
    folder: Folder of the board's Gerber files.
    output: Picture (PNG) of paste over copper over outline.
    bottom: The bottom side.
    """
    from fringebench.experiments.board_check import check_board
    from scenes.support.atomic_file import replacing

    assert action is Action.CHECK
    check_outputs({"-o": output}, [])
    found = check_board(folder, "bottom" if bottom else "top")
    if output is not None:
        with replacing(output) as staged:
            found.picture.savefig(staged, format="png", dpi=200)
    if as_json:
        layers = [asdict(layer) | {"agrees": layer.agrees} for layer in found.layers]
        print_json({"pads": found.pads, "outside": list(found.outside), "layers": layers})
    else:
        rows = []
        for layer in found.layers:
            figures = (layer.area_mm2, layer.second_mm2, layer.apart_mm2)
            cells = ["-" if f is None else f"{f:.4f}" for f in figures]
            rows.append([f"{layer.role}: {layer.file}", *cells, layer.note or str(layer.agrees)])
        names = ["mm2", "second reader", "apart", "agrees"]
        title = f"{found.pads} paste openings"
        print_figures([figure_table(title, "layer", names, rows)])
        if found.outside:
            say(f"outside the outline, not printed: {', '.join(found.outside)}")
    if found.outside or not all(layer.agrees for layer in found.layers):
        raise typer.Exit(1)
