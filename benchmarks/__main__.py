"""Run the benchmarks: `python -m benchmarks [--quick] [--only NAME ...] [--json FILE] [--markdown FILE]`.

Exit status: 0; 1 if a benchmark failed, or a full run missed a target; 2 for bad use. `--quick` takes small sizes, so its
targets are not judged.
"""

import argparse
import importlib
import importlib.util
import json
import os
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks import machine
from benchmarks.result import SCHEMA, Result, between, console, markdown, not_run, show

MODULES = {
    "cold": "Cold start",
    "trace": "Light, at equal samples",
    "quality": "Light, at equal phase error",
    "noise": "Light, to half the sensor's noise",
    "large": "Light, four million pixels",
    "cost": "What the pass costs against",
    "plate": "A cap and a step on a plate",
    "expose": "Exposing",
    "decode": "Decoding",
    "outside": "Decoding, against other people's decoders",
    "fusion": "Decoding several exposures",
    "exr": "Files",
    "run": "`fringebench run`, start to report",
    "memory": "Peak memory",
    "dataset": "Data sets",
}


def measured(name: str, quick: bool) -> tuple[list[Result], bool]:
    """Results of a benchmark, and whether it ran; one that fails gives a row with the reason."""
    module = importlib.import_module(f"benchmarks.{name}")
    try:
        return module.measure(quick), True
    except Exception as error:
        return [not_run(name, f"{type(error).__name__}: {error}")], False


def processor_s() -> float:
    """Processor time used so far by this process and its finished children, in s."""
    return sum(os.times()[:4])


def main() -> int:
    """Run the requested benchmarks, print and write the results."""
    known = [name for name in MODULES if importlib.util.find_spec(f"benchmarks.{name}")]
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="small sizes: under three minutes")
    parser.add_argument(
        "--only", action="append", choices=known, metavar="NAME", help=", ".join(known)
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="results as JSON (docs/benchmarks.md)"
    )
    parser.add_argument(
        "--markdown",
        type=Path,
        metavar="FILE",
        help="tables as Markdown; where FILE has the markers of docs/benchmarks.md, between them",
    )
    given = parser.parse_args()
    progress, out = Console(stderr=True), console()
    about = machine.describe()
    about["load_before"] = machine.load()
    made = datetime.now(UTC).isoformat(timespec="seconds")
    found: dict[str, list[Result]] = {}
    spent: dict[str, float] = {}
    busy: dict[str, float] = {}
    whole = True
    out.print(machine.sentence(about), highlight=False)
    for name in given.only or known:
        start, used = time.perf_counter(), processor_s()
        found[name], ran = measured(name, given.quick)
        spent[name] = round(time.perf_counter() - start, 1)
        busy[name] = round(processor_s() - used, 1)
        whole &= ran
        show(out, MODULES[name].replace("`", ""), found[name], not given.quick)
        progress.print(
            f"{name}: {spent[name]:.0f} s, {busy[name]:.0f} of processor", highlight=False
        )
    about["load_after"] = machine.load()
    when = (
        f"{made}{', quick: small sizes, no target judged' if given.quick else ''}. "
        f"Load {about['load_before']} before, {about['load_after']} after; {sum(spent.values()):.0f} s."
    )
    out.print(when, highlight=False)
    if given.json:
        everything: dict[str, Any] = {
            "schema": SCHEMA,
            "made": made,
            "quick": given.quick,
            "machine": about,
            "seconds": spent,
            "processor_seconds": busy,
            "results": [
                {"benchmark": name, **result.to_dict()} for name in found for result in found[name]
            ],
        }
        given.json.write_text(json.dumps(everything, indent=2, allow_nan=False) + "\n", "utf-8")
    if given.markdown:
        tables = [
            markdown(MODULES[name], results, not given.quick) for name, results in found.items()
        ]
        page = given.markdown.read_text("utf-8") if given.markdown.is_file() else ""
        given.markdown.write_text(
            between(page, "\n".join([f"{when} {machine.sentence(about)}.", "", *tables])), "utf-8"
        )
    missed = [r for results in found.values() for r in results if r.met is False]
    return int(not whole or bool(missed and not given.quick))


if __name__ == "__main__":
    raise SystemExit(main())
