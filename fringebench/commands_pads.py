"""``fringebench pads``: inspect a board's paste, and say how good the inspection is."""

import json
import sys
from dataclasses import asdict
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

import scenes
from fringebench.options import AsJson, PhaseError, SceneName, Seed, Settings, ShowProgress
from fringebench.overrides import parse_overrides
from fringebench.progress import Mode, Steps


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command("pads", epilog="Example: fringebench pads spi --budget")(pads)


def pads(
    scene: SceneName = "spi",
    threshold_um: Annotated[
        float, typer.Option(help="What stands higher above its pad is paste.", min=0.0)
    ] = 40.0,
    budget: Annotated[
        bool, typer.Option("--budget", help="What metal, grains, noise and the threshold take.")
    ] = False,
    gauge: Annotated[
        bool, typer.Option("--gauge", help="Gauge study: repeats, sensors and places.")
    ] = False,
    settings: Settings = [],  # noqa: B006
    phase_error: PhaseError = None,
    seed: Seed = 0,
    progress: ShowProgress = Mode.AUTO,
    as_json: AsJson = False,
) -> None:
    """Measure a board's paste as an inspection machine does: volume, area, height, offset and defects against the truth."""
    loaded = scenes.load(scene, parse_overrides(settings, phase_error))
    from fringebench.pads import gauge as study
    from fringebench.pads import inspect, pad_budget
    from fringebench.tables import wide_console

    steps = Steps(Console(stderr=True), progress)
    answer: dict[str, Any] = {}
    tables: list[Table] = []
    found = inspect(loaded, seed, threshold_um * 1e-3, steps=steps)
    answer |= {
        "threshold_um": threshold_um,
        "threshold_bias_percent": found.threshold_bias_percent,
        "errors": asdict(found.errors),
        "confusion": found.confusion.to_dict(),
        "pads": [asdict(pad) for pad in found.measured],
    }
    taken = f"pads against truth; the {threshold_um:g} um threshold alone takes {-found.threshold_bias_percent:.1f} %"
    tables += [_errors({"as taken": found.errors}, taken), _gates(answer["confusion"])]
    if budget:
        rows = pad_budget(loaded, seed, steps)
        answer["budget"] = {name: asdict(errors) for name, errors in rows.items()}
        tables.append(_errors(rows, "one cause at a time, pads of 0.3 mm and more"))
    if gauge:
        result = study(loaded, seed, threshold_mm=threshold_um * 1e-3, steps=steps)
        answer["gauge"] = result.to_dict()
        tables.append(_study(answer["gauge"]))
    if as_json:
        sys.stdout.write(json.dumps(answer, indent=2, allow_nan=False) + "\n")
        return
    console = wide_console()
    for table in tables:
        console.print(table)


def _errors(rows: dict[str, Any], title: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("", no_wrap=True)
    for name in ("pads", "unseen", "vol. %", "sd %", "worst %", "area %", "h µm", "offs. µm"):
        table.add_column(name, justify="right")
    for name, e in rows.items():
        table.add_row(
            name,
            str(e.pads),
            str(e.unmeasured),
            f"{e.volume_bias_percent:+.2f}",
            f"{e.volume_sd_percent:.2f}",
            f"{e.volume_max_percent:.2f}",
            f"{e.area_bias_percent:+.2f}",
            f"{1e3 * e.height_bias_mm:+.2f}",
            f"{1e3 * e.offset_rms_mm:.2f}",
        )
    return table


def _gates(confusion: dict[str, Any]) -> Table:
    table = Table(title="accept or reject, measured against true", title_justify="left")
    table.add_column("limit")
    for name in ("caught", "escaped", "false calls", "passed"):
        table.add_column(name, justify="right")
    for name, gate in confusion["gates"].items():
        table.add_row(name, *(str(gate[k]) for k in ("caught", "escaped", "false_calls", "passed")))
    return table


def _study(study: dict[str, Any]) -> Table:
    table = Table(title="gauge study of volume, % of nominal", title_justify="left")
    for name in ("EV", "reprod.", "GRR", "% of tolerance", "% of study", "categories"):
        table.add_column(name, justify="right")
    table.add_row(
        f"{study['ev']:.3f}",
        f"{study['reproducibility']:.3f}",
        f"{study['grr']:.3f}",
        f"{study['grr_percent_of_tolerance']:.1f}",
        f"{study['grr_percent_of_study']:.1f}",
        str(study["distinct_categories"]),
    )
    return table
