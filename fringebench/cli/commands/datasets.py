"""``fringebench dataset``: make, continue, verify or repair a data set."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fringebench.cli import shared_options as opt
from fringebench.cli.overrides import parse_overrides
from fringebench.cli.registration import command
from fringebench.cli.terminal import print_json, progress_steps, say
from fringebench.progress import Mode

if TYPE_CHECKING:
    from fringebench.datasets.dataset_plan import DatasetPlan
    from fringebench.datasets.verification import Problem

app = typer.Typer()

GATE_FAILED = 1
INTERRUPTED = 130


@command(app, "fringebench dataset spi --count 1000 -o boards")
def dataset(
    scene: Annotated[str | None, typer.Argument(autocompletion=opt.scene_names)] = None,
    count: opt.CountOrNone = None,
    output: str | None = None,
    seed: opt.Seed = 0,
    workers: opt.CountOrNone = None,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS")] = None,
    split: Annotated[list[str], typer.Option(metavar="NAME=SHARE")] = [],  # noqa: B006
    picture: Annotated[bool, typer.Option("--picture/--no-picture")] = True,
    ring_light: bool = False,
    heights: bool = False,
    modulation: bool = False,
    height_tiff: bool = False,
    variants: opt.Count = 1,
    format_: Annotated[str, typer.Option("--format", metavar="folder|webdataset")] = "folder",
    card: bool = False,
    strict: bool = False,
    verify: bool = False,
    repair: bool = False,
    settings: opt.Settings = [],  # noqa: B006
    phase_error: opt.PhaseError = None,
    render_noise: opt.RenderNoise = None,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Make a data set of random samples of a scene, or continue one that was interrupted.

    Each sample is a folder with frames, truth, scene, labels and a picture; the same seed gives the same bytes on any number of
    workers. With --verify or --repair only -o is needed.

    scene: A shipped scene's name, or a TOML file.
    count: How many samples.
    output: A folder, or any URL that fsspec opens.
    seed: Sample i depends on this and on i alone.
    workers: Processes of one core each. Default: all cores.
    scheduler: A Dask cluster, tcp://host:8786.
    split: A split's share; may be repeated. Default: train=0.8 val=0.1 test=0.1.
    picture: picture.png in each sample: 8 bits, what a 2-D camera sees; for COCO.
    ring_light: colour.png in each sample: a 2-D camera's colour picture under red, green and blue ring lights.
    heights: Measured heights in each sample: height.png, reconstruction.exr.
    modulation: Measured fringe amplitude in each sample: modulation.png, 16 bits.
    height_tiff: Measured heights in each sample: height.tiff, mm in 32 bits of floating point.
    variants: Samples that share one light: only noise, and what is drawn for sensor and exposures, differ.
    format_: webdataset: tar shards as well.
    card: Data card: README.md, and its tables in report.html.
    strict: Stop at the first sample that cannot be made.
    verify: Compare every file with its checksum; make nothing.
    repair: Make missing, altered and failed samples again.
    """
    from scenes.support.errors import DatasetError
    from scenes.support.memory import cores

    if output is None:
        raise DatasetError("no place for the data set: give a folder or URL with -o")
    if workers is not None and scheduler is not None:
        raise DatasetError(
            "--workers and --scheduler exclude each other: a cluster has its own workers"
        )
    processes = workers or cores()
    if repair:
        answer = _repair(output, processes, scheduler, progress)
    elif verify:
        answer = _verify(output, progress)
    else:
        if scene is None or count is None:
            raise DatasetError("give a scene and --count, or --verify or --repair with -o")
        if format_ not in ("folder", "webdataset"):
            raise DatasetError(f"--format '{format_}': use folder or webdataset")
        import scenes
        from fringebench.datasets.dataset_plan import DatasetPlan

        loaded = scenes.load(scene, parse_overrides(settings, phase_error, render_noise))
        plan = DatasetPlan.of(
            loaded,
            count,
            seed,
            _splits(split),
            picture=picture,
            heights=heights,
            variants=variants,
            ring_light=ring_light,
            modulation=modulation,
            height_tiff=height_tiff,
        )
        answer = _build(plan, output, processes, scheduler, strict, progress)
        if format_ == "webdataset":
            from fringebench.datasets.shards import write_shards

            shards = write_shards(output)
            answer.text.append(
                f"{len(shards)} shard{'s' * (len(shards) > 1)} in {output}/webdataset"
            )
            answer.data["shards"] = shards
        from fringebench.datasets.overview_page import write_report

        answer.text.append(f"see {write_report(output, card)}")
        if card:
            from fringebench.datasets.data_card import write_card

            answer.text.append(f"see {write_card(output)}")
    if as_json:
        print_json(answer.data)
    else:
        say("\n".join(answer.text))
    if answer.status:
        raise typer.Exit(answer.status)


@dataclass(frozen=True)
class _Answer:
    """Lines to read, data for a program, and the exit status."""

    text: list[str]
    data: dict[str, Any]
    status: int = 0


def _build(
    plan: "DatasetPlan", where: str, workers: int, scheduler: str | None, strict: bool, mode: Mode
) -> _Answer:
    from fringebench.datasets.building import build
    from fringebench.datasets.store import open_store
    from scenes.support.errors import DatasetError

    if not open_store(where).lasting:
        raise DatasetError(
            f"'{where}' is in the memory of this command and lost when it ends: give a folder or another URL"
        )
    try:
        with _counted("samples", mode) as update:
            built = build(plan, where, workers, scheduler, strict, update)
    except KeyboardInterrupt:
        sys.stderr.write(
            f"fringebench: interrupted; the samples made so far are kept in '{where}': the same command continues\n"
        )
        raise typer.Exit(INTERRUPTED) from None
    split_counts = {
        name: sum(r.split == name and r.status == "made" for r in built.records)
        for name in plan.splits
    }
    rate = 60.0 * built.made / built.seconds if built.made else None
    lost = [{"index": r.index, "reason": r.reason} for r in built.failed]
    shown = ", ".join(f"{n} {name}" for name, n in split_counts.items())
    pace = f", {rate:.1f} samples/min" if rate else ""
    text = [f"{len(built.records)} samples in {where} ({shown}); {built.made} made now{pace}"]
    text += [f"sample {r['index']} could not be made: {r['reason']}" for r in lost[:10]]
    if len(lost) > 10:
        text.append(f"and {len(lost) - 10} more: see status and reason in manifest.parquet")
    data: dict[str, Any] = {
        "where": where,
        "samples": len(built.records),
        "made": built.made,
        "failed": lost,
    }
    data |= {"splits": split_counts, "seconds": built.seconds, "samples_per_minute": rate}
    return _Answer(text, data)


def _verify(where: str, mode: Mode) -> _Answer:
    from fringebench.datasets.verification import verify

    with _counted("checked", mode) as update:
        found = verify(where, update)
    text = [f"{p.file}: {p.what}" for p in found] or [f"{where}: every file is unchanged"]
    if found:
        text.append("fringebench dataset --repair makes them again")
    return _Answer(text, {"where": where, "problems": _listed(found)}, GATE_FAILED if found else 0)


def _repair(where: str, workers: int, scheduler: str | None, mode: Mode) -> _Answer:
    from fringebench.datasets.building import repair

    with _counted("repaired", mode) as update:
        done = repair(where, workers, scheduler, update)
    text = [f"{p.file}: {p.what}" for p in done.problems]
    text.append(f"{len(done.repaired)} samples made again")
    text += [
        f"sample {index} differs from the manifest when made again; its files were kept"
        for index in done.differing
    ]
    data: dict[str, Any] = {"where": where, "problems": _listed(done.problems)}
    data |= {"repaired": list(done.repaired), "differing": list(done.differing)}
    return _Answer(text, data, GATE_FAILED if done.differing else 0)


def _listed(problems: "Iterable[Problem]") -> list[dict[str, Any]]:
    return [{"file": p.file, "problem": p.what, "index": p.index} for p in problems]


def _splits(given: list[str]) -> dict[str, float] | None:
    """``["train=0.9", "test=0.1"]`` as shares by name, None for none."""
    from scenes.support.errors import DatasetError

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


@contextmanager
def _counted(what: str, mode: Mode) -> Iterator[Callable[[int, int, int], None]]:
    """Show samples done, samples that failed, and samples in all."""
    start = time.monotonic()
    first: int | None = None
    with progress_steps(mode).shown(what, resumes=True) as show:

        def count(done: int, failed: int, total: int) -> None:
            nonlocal first
            first = done if first is None else first
            parts = [f"{done} of {total}"]
            if failed:
                parts.append(f"{failed} failed")
            if done > first:
                parts.append(f"{60.0 * (done - first) / (time.monotonic() - start):.1f}/min")
            show(done / total, ", ".join(parts))

        yield count
