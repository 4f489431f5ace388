"""Make a data set, by processes or a cluster. A run makes what is missing, so a killed run is continued by the next.

A sample counts as made once its record is in ``records/``; when all are made, the records become the manifest.
"""

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from fringebench.datasets import coco_files
from fringebench.datasets.contents import RECORDS, keep_record, read_manifest, read_plan, records_of
from fringebench.datasets.dataset_plan import PLAN_FILE, DatasetPlan
from fringebench.datasets.execution.cluster import maker_of, on_cluster
from fringebench.datasets.execution.maker import made_with
from fringebench.datasets.execution.processes import in_processes
from fringebench.datasets.manifest import MANIFEST_FILE, Manifest
from fringebench.datasets.sample import FileSum, Record, checksum
from fringebench.datasets.store import Store, open_store
from fringebench.datasets.verification import Problem, problems
from scenes.randomise import realise
from scenes.support.errors import DatasetError, FringebenchError

# Samples that are tried before a run that none of them can be drawn for is refused.
TRIED = 8

Progress = Callable[[int, int, int], None]
"""Called with samples done, samples failed, and samples in all."""
Made = Generator[tuple[Record, Path | None]]


@dataclass(frozen=True)
class Built:
    """What a run did."""

    where: str
    plan: DatasetPlan
    records: tuple[Record, ...]
    """Every sample's, in order."""
    made: int
    """Samples made by this run, failed ones included."""
    seconds: float

    @property
    def failed(self) -> tuple[Record, ...]:
        """Samples that could not be made."""
        return tuple(record for record in self.records if record.status == "failed")


@dataclass(frozen=True)
class Repaired:
    """What a repair found and did."""

    problems: tuple[Problem, ...]
    repaired: tuple[int, ...]
    """Samples made again."""
    differing: tuple[int, ...]
    """Samples that differ from the manifest when made again; the old files were kept."""


def build(
    plan: DatasetPlan,
    where: str | Path,
    workers: int = 1,
    scheduler: str | None = None,
    strict: bool = False,
    progress: Progress | None = None,
) -> Built:
    """Make the plan's data set in a folder or an fsspec URL, or continue the one there; `progress` gets samples done,
    failed, in all.

    The bytes are the same for any number of workers. `scheduler` is the address of a Dask scheduler. A sample that
    cannot be made is recorded with its reason, or stops the run if `strict`. Raises `DatasetError` for another data set
    at `where`, an output that cannot be written, a run that still writes there, or when no sample could be made.
    """
    store = open_store(where)
    start = time.perf_counter()
    with store.alone():
        mine = _maker(scheduler)
        plan = plan.model_copy(update={"made_with": mine})
        there = store.read(PLAN_FILE)
        if there is not None:
            old = DatasetPlan.loads(there.decode(errors="replace"), f"{where}/{PLAN_FILE}")
            plan.require_same(old, str(where))
            old.require_maker(mine)
        if there is None:
            _require_drawable(plan)
        if there is None or old != plan:
            store.write(PLAN_FILE, plan.dumps().encode())
        store.clear_staging()
        records = records_of(store)
        missing = [index for index in range(plan.count) if index not in records]
        _report_progress(progress, records, plan.count)
        with closing(_make(plan, missing, store, workers, scheduler)) as making:
            for record, folder in making:
                _keep(plan, store, record, folder)
                records[record.index] = record
                _report_progress(progress, records, plan.count)
                if strict and record.status == "failed":
                    raise DatasetError(
                        f"sample {record.index} cannot be made: {record.reason} (what was made so far is kept; "
                        "without --strict the others are still made)"
                    )
        ordered = tuple(records[index] for index in sorted(records))
        if missing or store.read(MANIFEST_FILE) is None or store.list(RECORDS):
            _finish(plan, store, ordered)
    if all(record.status == "failed" for record in ordered):
        raise DatasetError(
            f"none of the {plan.count} samples could be made; sample 0: {ordered[0].reason}"
        )
    return Built(str(where), plan, ordered, len(missing), time.perf_counter() - start)


def _require_drawable(plan: DatasetPlan) -> None:
    """`DatasetError` if sample 0 cannot be drawn, nor those after it, which distinguishes a rare draw from a wrong plan."""
    scene, reasons = plan.load_scene(), []
    for index in range(min(plan.count, TRIED)):
        try:
            realise(scene, index, plan.seed, plan.light_of(index))
        except FringebenchError as error:
            reasons.append(str(error))
        else:
            return
    raise DatasetError(
        f"none of the first {len(reasons)} samples can be drawn, and nothing was written; sample 0: {reasons[0]}"
    )


def repair(
    where: str | Path,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Repaired:
    """Make missing, altered and failed samples again, and the labels and manifest; arguments and errors as of `build`.

    A sample that differs from its record when made again keeps its files.
    """
    store = open_store(where)
    with store.alone():
        plan = read_plan(store)
        plan.require_maker(_maker(scheduler))
        store.clear_staging()
        found = tuple(problems(store, plan))
        records = records_of(store)
        _require_own_plan(store, found, plan)
        for problem in found:
            if problem.what == "surplus":
                store.remove(problem.file)
        broken = {p.index for p in found if p.index is not None and p.what != "surplus"}
        broken |= {record.index for record in records.values() if record.status == "failed"}
        again = sorted(broken)
        repaired: list[int] = []
        differing: list[int] = []
        with closing(_make(plan, again, store, workers, scheduler)) as making:
            for count, (record, folder) in enumerate(making, start=1):
                known = records.get(record.index)
                if known and known.status == "made" and known != record:
                    differing.append(record.index)
                else:
                    _keep(plan, store, record, folder)
                    records[record.index] = record
                    if record.status == "made":
                        repaired.append(record.index)
                if progress:
                    progress(count, len(differing), len(again))
        if found and not differing:
            _finish(plan, store, tuple(records[index] for index in sorted(records)))
    return Repaired(found, tuple(sorted(repaired)), tuple(sorted(differing)))


def _maker(scheduler: str | None) -> dict[str, str]:
    return made_with() if scheduler is None else maker_of(scheduler)


def _make(
    plan: DatasetPlan, indices: Sequence[int], store: Store, workers: int, scheduler: str | None
) -> Made:
    if workers < 1:
        raise DatasetError(f"workers = {workers}: give 1 or more")
    if not indices:
        return _none()
    if scheduler is not None:
        return on_cluster(plan, indices, store.where, scheduler)
    return in_processes(plan, indices, store, min(workers, len(indices)))


def _none() -> Made:
    yield from ()


def _keep(plan: DatasetPlan, store: Store, record: Record, folder: Path | None) -> None:
    """Put a sample in place, then its record: the record says that the sample is whole."""
    if folder is not None:
        store.put(folder, record.folder)
    elif record.status == "failed":
        store.remove(record.folder)
    elif not set(plan.sample_files) <= set(store.list(record.folder)):
        raise DatasetError(
            f"a worker says it put sample {record.index} at '{store.where}', but it is not there: workers of a cluster "
            "must share that folder with this machine; or give a URL that all of them reach"
        )
    keep_record(store, record)


def _require_own_plan(store: Store, found: Sequence[Problem], plan: DatasetPlan) -> None:
    """`DatasetError` for an altered plan, which would make other samples; one that has grown is not in the manifest yet."""
    altered = any(p.file == PLAN_FILE and p.what == "altered" for p in found)
    listed = read_manifest(store) if altered else None
    if listed and len(listed.records) == plan.count:
        raise DatasetError(
            f"'{store.where}/{PLAN_FILE}' was altered since the data set was made, and samples are made from it: "
            "put the original back"
        )


def _finish(plan: DatasetPlan, store: Store, records: tuple[Record, ...]) -> None:
    """Write the labels of each split and the manifest; remove single records."""
    sums: dict[str, FileSum] = {}
    with store.staging() as folder:
        staged = coco_files.write(plan, store, records, folder)
        (folder / PLAN_FILE).write_text(plan.dumps(), "utf-8")
        sums[PLAN_FILE] = checksum(folder / PLAN_FILE)
        for name, path in staged.items():
            sums[name] = checksum(path)
            store.put(path, name)
        store.put(folder / PLAN_FILE, PLAN_FILE)
    store.write(MANIFEST_FILE, Manifest(records, sums).to_bytes())
    store.remove(RECORDS)


def _report_progress(progress: Progress | None, records: dict[int, Record], count: int) -> None:
    if progress:
        lost = sum(record.status == "failed" for record in records.values())
        progress(len(records), lost, count)
