"""Results of benchmarks as a table, Markdown and JSON."""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from rich.console import Console
from rich.table import Table

SCHEMA = 1
# Width of a table if standard output is no terminal.
WIDTH = 170
BEGIN, END = "<!-- measured -->", "<!-- end of measured -->"
Sense = Literal["at least", "at most"]
Reads = Literal["x faster", "x baseline"]


@dataclass(frozen=True)
class Target:
    """Target for the ratio of a result, or for its value."""

    of: Literal["ratio", "value"]
    sense: Sense
    limit: float

    def met_by(self, number: float) -> bool:
        """Whether that number meets the target."""
        return number >= self.limit if self.sense == "at least" else number <= self.limit


@dataclass(frozen=True)
class Result:
    """One measurement and its baseline. `value` None: not run, for the reason in `note`."""

    name: str
    value: float | None
    """Wall-clock time or rate, or another quantity."""
    unit: str
    baseline: str = ""
    """Name of the baseline, measured in the same run."""
    baseline_value: float | None = None
    ratio: float | None = None
    """Median ratio of paired runs, or the ratio of the values."""
    reads: Reads = "x baseline"
    """`x faster`: baseline over value; `x baseline`: value over baseline."""
    processor_value: float | None = None
    """`value` from the processor time of all threads, which other programs hardly change."""
    processor_baseline: float | None = None
    processor_ratio: float | None = None
    target: Target | None = None
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one, or if it was not run."""
        number = self.ratio if self.target and self.target.of == "ratio" else self.value
        return None if self.target is None or number is None else self.target.met_by(number)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self) | {"met": self.met}


def not_run(name: str, why: str) -> Result:
    """A row with the reason why there is no number."""
    return Result(name, None, "", note=f"not run: {why}")


def digits(number: float | None, unit: str = "") -> str:
    """Three significant digits, without exponent if that is readable."""
    if number is None:
        return ""
    size = abs(number)
    text = f"{number:.0f}" if 100 <= size < 1e6 else f"{number:#.3g}".rstrip(".")
    return f"{text} {unit}".strip()


def cells(result: Result, judged: bool = True) -> tuple[str, ...]:
    """Row of a result: name, value, baseline, ratio, ratio by processor time, target and, if `judged`, whether it is met."""
    target = result.target
    promised = ""
    if target:
        unit = result.unit if target.of == "value" else ""
        verdict = {True: "met", False: "MISSED", None: "?"}[result.met]
        promised = f"{'>=' if target.sense == 'at least' else '<='} {target.limit:g} {unit}".strip()
        promised += f": {verdict}" if judged else ""
    baseline = digits(result.baseline_value, result.unit)
    return (
        result.name,
        "not run" if result.value is None else digits(result.value, result.unit),
        f"{result.baseline}: {baseline}" if baseline else result.baseline,
        "" if result.ratio is None else f"{digits(result.ratio)} {result.reads}",
        digits(result.processor_ratio),
        promised,
    )


COLUMNS = ("measured", "value", "baseline, same run", "ratio", "by processor", "target")


def show(console: Console, title: str, results: Sequence[Result], judged: bool = True) -> None:
    """Print the table and the notes below it."""
    shown = Table(*COLUMNS, title=title, title_justify="left", title_style="bold")
    for result in results:
        missed = judged and result.met is False
        shown.add_row(*cells(result, judged), style="red" if missed else None)
    console.print(shown)
    for name, note in notes(results):
        console.print(f"  {name}: {note}", highlight=False, markup=False, style="dim")


def notes(results: Sequence[Result]) -> list[tuple[str, str]]:
    """Names and notes; neighbours with the same note share it."""
    listed: list[tuple[str, str]] = []
    for result in results:
        if listed and listed[-1][1] == result.note:
            listed[-1] = (f"{listed[-1][0]}; {result.name}", result.note)
        elif result.note:
            listed.append((result.name, result.note))
    return [("; ".join(dict.fromkeys(names.split("; "))), note) for names, note in listed]


def console() -> Console:
    """Standard output, wide enough for a row if it is no terminal."""
    out = Console()
    return out if out.is_terminal else Console(width=WIDTH)


def markdown(title: str, results: Sequence[Result], judged: bool = True) -> str:
    """The table as Markdown, notes below."""
    lines = [f"### {title}", "", "| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|"]
    lines += ["| " + " | ".join(cells(result, judged)) + " |" for result in results]
    below = [f"- {name}: {note}" for name, note in notes(results)]
    return "\n".join([*lines, "", *below, *([""] if below else [])])


def between(text: str, tables: str) -> str:
    """A page with the text between its markers replaced; only the tables for a page without markers."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    return f"{before}{begin}\n{tables}\n{end}{after}" if begin and end else tables


def main(name: str, doc: str | None, measure: Callable[[bool], list[Result]]) -> int:
    """One benchmark as a program: prints its table; status 1 if a target is missed by a full run."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small sizes; targets are not judged")
    quick = parser.parse_args().quick
    results = measure(quick)
    show(console(), name, results, judged=not quick)
    return int(not quick and any(result.met is False for result in results))
