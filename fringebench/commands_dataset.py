"""``fringebench dataset``: make, go on with, verify or repair a data set."""

import json
import os
import sys
from typing import Annotated, Any, Self

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from fringebench.options import PhaseError, ShowProgress, scene_names
from fringebench.overrides import parse_overrides
from fringebench.progress import Lines, Mode
from scenes.errors import DatasetError

GATE_FAILED = 1
INTERRUPTED = 130


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command("dataset", epilog="Example: fringebench dataset spi --count 1000 -o boards")(
        dataset
    )


def dataset(
    scene: Annotated[
        str | None,
        typer.Argument(help="A shipped scene's name, or a TOML file.", autocompletion=scene_names),
    ] = None,
    count: Annotated[int | None, typer.Option(help="How many samples.", min=1)] = None,
    output: Annotated[
        str | None, typer.Option("-o", "--output", help="A folder, or any URL that fsspec opens.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Sample i depends on this and on i alone.", min=0)] = 0,
    workers: Annotated[
        int | None, typer.Option(help="Processes of one core each. Default: all cores.", min=1)
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask cluster, tcp://host:8786.")
    ] = None,
    split: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=SHARE",
            help="A split's share; may be repeated. Default: train=0.8 val=0.1 test=0.1.",
        ),
    ] = [],  # noqa: B006
    strict: Annotated[
        bool, typer.Option("--strict", help="Stop at the first sample that cannot be made.")
    ] = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="Compare every file with its checksum; make nothing.")
    ] = False,
    repair: Annotated[
        bool, typer.Option("--repair", help="Make missing, altered and failed samples again.")
    ] = False,
    settings: Annotated[
        list[str],
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Override a key of the scene; may be repeated."
        ),
    ] = [],  # noqa: B006
    phase_error: PhaseError = None,
    progress: ShowProgress = Mode.AUTO,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Make a data set of random samples of a scene, or go on with one that was interrupted.

    Each sample is a folder with frames, truth, scene and labels; the same seed gives the same bytes on any number of
    workers. With --verify or --repair only -o is needed.
    """
    if output is None:
        raise DatasetError("nothing says where the data set lies: give a folder or URL with -o")
    if workers is not None and scheduler is not None:
        raise DatasetError(
            "--workers and --scheduler exclude each other: a cluster has its own workers"
        )
    processes = workers or _cores()
    if repair:
        status, answer = _repair(output, processes, scheduler, progress)
    elif verify:
        status, answer = _verify(output, progress)
    else:
        if scene is None or count is None:
            raise DatasetError("give a scene and --count, or --verify or --repair with -o")
        status, answer = _build(
            (scene, parse_overrides(settings, phase_error)),
            output,
            (count, seed, _splits(split)),
            (processes, scheduler, strict),
            progress,
        )
    if as_json:
        sys.stdout.write(json.dumps(answer.pop("json"), indent=2, allow_nan=False) + "\n")
    else:
        Console().print("\n".join(answer["text"]), highlight=False, markup=False)
    if status:
        raise typer.Exit(status)


def _build(
    what: tuple[str, dict[str, Any]],
    where: str,
    size: tuple[int, int, dict[str, float] | None],
    means: tuple[int, str | None, bool],
    mode: Mode,
) -> tuple[int, dict[str, Any]]:
    import scenes
    from fringebench.datasets.build import build
    from fringebench.datasets.plan import Plan

    (scene, overrides), (count, seed, splits) = what, size
    plan = Plan.of(scenes.load(scene, overrides), count, seed, splits)
    workers, scheduler, strict = means
    try:
        with _Bar("samples", mode) as bar:
            built = build(plan, where, workers, scheduler, strict, bar.update)
    except KeyboardInterrupt:
        sys.stderr.write(
            f"fringebench: interrupted; the samples made so far are kept in '{where}': the same command goes on\n"
        )
        raise typer.Exit(INTERRUPTED) from None
    from fringebench.datasets.report import write_report

    report = write_report(where)
    split_counts = {
        name: sum(r.split == name and r.status == "made" for r in built.records)
        for name in plan.splits
    }
    rate = 60.0 * built.made / built.seconds if built.made else None
    lost = [{"index": r.index, "reason": r.reason} for r in built.failed]
    shown = ", ".join(f"{n} {name}" for name, n in split_counts.items())
    pace = f", {rate:.1f} samples/min" if rate else ""
    text = [f"{len(built.records)} samples in {where} ({shown}); {built.made} made now{pace}"]
    text += [f"see {report}"]
    text += [f"sample {r['index']} could not be made: {r['reason']}" for r in lost[:10]]
    if len(lost) > 10:
        text.append(f"and {len(lost) - 10} more: see status and reason in manifest.parquet")
    return 0, {
        "text": text,
        "json": {
            "where": where,
            "samples": len(built.records),
            "made": built.made,
            "failed": lost,
            "splits": split_counts,
            "seconds": built.seconds,
            "samples_per_minute": rate,
        },
    }


def _verify(where: str, mode: Mode) -> tuple[int, dict[str, Any]]:
    from fringebench.datasets.verify import verify

    with _Bar("checked", mode) as bar:
        found = verify(where, bar.update)
    text = [f"{p.file}: {p.what}" for p in found] or [f"{where}: every file is as it was made"]
    if found:
        text.append("fringebench dataset --repair makes them again")
    listed = [{"file": p.file, "problem": p.what, "index": p.index} for p in found]
    return (GATE_FAILED if found else 0), {
        "text": text,
        "json": {"where": where, "problems": listed},
    }


def _repair(
    where: str, workers: int, scheduler: str | None, mode: Mode
) -> tuple[int, dict[str, Any]]:
    from fringebench.datasets.build import repair

    with _Bar("repaired", mode) as bar:
        done = repair(where, workers, scheduler, bar.update)
    text = [f"{p.file}: {p.what}" for p in done.problems]
    text.append(f"{len(done.repaired)} samples made again")
    text += [
        f"sample {index} came out otherwise than the manifest says, and was left as it was"
        for index in done.differing
    ]
    listed = [{"file": p.file, "problem": p.what, "index": p.index} for p in done.problems]
    answer = {
        "where": where,
        "problems": listed,
        "repaired": list(done.repaired),
        "differing": list(done.differing),
    }
    return (GATE_FAILED if done.differing else 0), {"text": text, "json": answer}


def _splits(given: list[str]) -> dict[str, float] | None:
    """``["train=0.9", "test=0.1"]`` as shares by name, None for none."""
    shares = {}
    for item in given:
        name, _, share = item.partition("=")
        try:
            shares[name.strip()] = float(share)
        except ValueError:
            raise DatasetError(
                f"--split '{item}': write name=share, e.g. --split train=0.9 --split test=0.1"
            ) from None
    return shares or None


def _cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


class _Bar:
    """A bar with rate and time left, on a terminal; lines where asked for; nothing when piped."""

    def __init__(self, what: str, mode: Mode) -> None:
        console = Console(stderr=True)
        self._what = what
        self._lines = Lines(console, what, resumes=True) if mode is Mode.PLAIN else None
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            console=console,
            disable=mode is not Mode.AUTO or not console.is_terminal,
            speed_estimate_period=600.0,
        )
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def update(self, done: int, bad: int, total: int) -> None:
        """Samples done, samples that went wrong, samples in all."""
        if self._lines is not None:
            self._lines.report(done / total, f"{done} of {total}, {bad} bad")
        if self._task is None:
            # What was there before this run is no measure of its speed.
            self._task = self._progress.add_task(self._what, total=total, completed=done, rate="")
            return
        speed = self._progress.tasks[0].speed
        rate = f"{60.0 * speed:.1f}/min" if speed else ""
        what = f"{self._what}, {bad} bad" if bad else self._what
        self._progress.update(self._task, completed=done, description=what, rate=rate)
