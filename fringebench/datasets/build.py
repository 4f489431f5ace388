"""Make a data set: what is missing is made, by processes or a cluster; killed at any moment, the next run goes on.

A sample counts as made once its record stands in ``records/``; when all are made, the records become the manifest.
"""

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from fringebench.datasets import coco_files, manifest
from fringebench.datasets import plan as plans
from fringebench.datasets.cluster import maker_of, on_cluster
from fringebench.datasets.contents import (
    RECORDS,
    keep_record,
    read_manifest,
    read_plan,
    records_of,
)
from fringebench.datasets.maker import made_with
from fringebench.datasets.manifest import Manifest
from fringebench.datasets.plan import Plan
from fringebench.datasets.processes import in_processes
from fringebench.datasets.sample import FILES, FileSum, Record, checksum
from fringebench.datasets.store import STAGING, Store, open_store
from fringebench.datasets.verify import Problem, problems
from scenes.errors import DatasetError

Progress = Callable[[int, int, int], None]
"""Called with samples done, samples failed, and samples in all."""
Made = Generator[tuple[Record, Path | None]]


@dataclass(frozen=True)
class Built:
    """What a run did."""

    where: str
    plan: Plan
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
    """Samples that came out otherwise than the manifest says, and were left as they were."""


def build(
    plan: Plan,
    where: str | Path,
    workers: int = 1,
    scheduler: str | None = None,
    strict: bool = False,
    progress: Progress | None = None,
) -> Built:
    """Make the plan's data set in a folder or at an fsspec URL, or go on with the one that is there.

    `workers` processes of one core each, or the Dask cluster at `scheduler`; the bytes are the same. A sample that
    cannot be made is recorded with its reason; `strict` stops at the first instead.

    Raises `DatasetError` for another data set at `where`, an output that cannot be written, a run that still writes
    there, or when no sample could be made.
    """
    store = open_store(where)
    start = time.perf_counter()
    with store.alone():
        mine = _maker(scheduler)
        plan = plan.model_copy(update={"made_with": mine})
        there = store.read(plans.NAME)
        if there is not None:
            old = Plan.loads(there.decode(errors="replace"), f"{where}/{plans.NAME}")
            plan.require_same(old, str(where))
            old.require_maker(mine)
        if there is None or old != plan:
            store.write(plans.NAME, plan.dumps().encode())
        store.remove(STAGING)
        records = records_of(store)
        missing = [index for index in range(plan.count) if index not in records]
        _say(progress, records, plan.count)
        with closing(_make(plan, missing, store, workers, scheduler)) as making:
            for record, folder in making:
                _keep(store, record, folder)
                records[record.index] = record
                _say(progress, records, plan.count)
                if strict and record.status == "failed":
                    raise DatasetError(
                        f"sample {record.index} cannot be made: {record.reason} (what was made so far is kept; "
                        "without --strict the others are made all the same)"
                    )
        ordered = tuple(records[index] for index in sorted(records))
        if missing or store.read(manifest.NAME) is None or store.list(RECORDS):
            _finish(plan, store, ordered)
    if all(record.status == "failed" for record in ordered):
        raise DatasetError(
            f"none of the {plan.count} samples could be made; sample 0: {ordered[0].reason}"
        )
    return Built(str(where), plan, ordered, len(missing), time.perf_counter() - start)


def repair(
    where: str | Path,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Repaired:
    """Make missing, altered and failed samples again, and the files that sum them up.

    A sample that comes out otherwise than its record says is left alone and named. Raises as `build` does.
    """
    store = open_store(where)
    with store.alone():
        plan = read_plan(store)
        plan.require_maker(_maker(scheduler))
        store.remove(STAGING)
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
                    _keep(store, record, folder)
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
    plan: Plan, indices: Sequence[int], store: Store, workers: int, scheduler: str | None
) -> Made:
    if workers < 1:
        raise DatasetError(f"workers = {workers}: needs at least 1")
    if not indices:
        return _none()
    if scheduler is not None:
        return on_cluster(plan, indices, store.where, scheduler)
    return in_processes(plan, indices, store, min(workers, len(indices)))


def _none() -> Made:
    yield from ()


def _keep(store: Store, record: Record, folder: Path | None) -> None:
    """Put a sample in place, then its record: the record says that the sample is whole."""
    if folder is not None:
        store.put(folder, record.folder)
    elif record.status == "failed":
        store.remove(record.folder)
    elif not set(FILES) <= set(store.list(record.folder)):
        raise DatasetError(
            f"a worker says it put sample {record.index} at '{store.where}', but it is not there: workers of a cluster "
            "must share that folder with this machine; or give a URL that all of them reach"
        )
    keep_record(store, record)


def _require_own_plan(store: Store, found: Sequence[Problem], plan: Plan) -> None:
    """A plan that somebody altered would make other samples; one that grew has not been summed up yet."""
    altered = any(p.file == plans.NAME and p.what == "altered" for p in found)
    listed = read_manifest(store) if altered else None
    if listed and len(listed.records) == plan.count:
        raise DatasetError(
            f"'{store.where}/{plans.NAME}' was altered since the data set was made, and samples are made from it: "
            "put the original back"
        )


def _finish(plan: Plan, store: Store, records: tuple[Record, ...]) -> None:
    """Labels of each split, the manifest, and then no more need for single records."""
    sums: dict[str, FileSum] = {}
    with store.staging() as folder:
        staged = coco_files.write(plan, store, records, folder)
        (folder / plans.NAME).write_text(plan.dumps(), "utf-8")
        sums[plans.NAME] = checksum(folder / plans.NAME)
        for name, path in staged.items():
            sums[name] = checksum(path)
            store.put(path, name)
        store.put(folder / plans.NAME, plans.NAME)
    store.write(manifest.NAME, Manifest(records, sums).to_bytes())
    store.remove(RECORDS)


def _say(progress: Progress | None, records: dict[int, Record], count: int) -> None:
    if progress:
        lost = sum(record.status == "failed" for record in records.values())
        progress(len(records), lost, count)
