"""Compare every file of a data set with its checksum in the manifest."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fringebench.datasets.contents import read_manifest, read_plan, records_of
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.manifest import MANIFEST_FILE
from fringebench.datasets.sample import FileSum, Record, checksum
from fringebench.datasets.store import Store, open_store
from scenes.support.errors import DatasetError

What = Literal["missing", "altered", "damaged", "not made", "surplus"]


@dataclass(frozen=True)
class Problem:
    """One missing, altered or extra file."""

    file: str
    what: What
    index: int | None = None
    """The sample it belongs to."""


def verify(
    where: str | Path, progress: Callable[[int, int, int], None] | None = None
) -> tuple[Problem, ...]:
    """What is missing, altered, not made or extra in a data set (a folder or URL); nothing is changed. `progress` as of
    `build`.
    """
    store = open_store(where)
    return tuple(problems(store, read_plan(store), progress))


def problems(
    store: Store, plan: DatasetPlan, progress: Callable[[int, int, int], None] | None = None
) -> Iterator[Problem]:
    """The problems of an open store."""
    own: Mapping[str, FileSum] = {}
    try:
        listed = read_manifest(store)
        if listed is None:
            yield Problem(MANIFEST_FILE, "missing")
        else:
            own = listed.files
    except DatasetError:
        yield Problem(MANIFEST_FILE, "damaged")
    for name, sums in own.items():
        yield from _compare(store, name, sums, None)
    records = records_of(store)
    bad = 0
    for index in range(plan.count):
        found = list(_of_sample(store, plan, index, records.get(index)))
        yield from found
        bad += bool(found)
        if progress:
            progress(index + 1, bad, plan.count)
    whole = {r.folder.split("/")[-1] for r in records.values() if r.status == "made"}
    for name in store.list("samples"):
        known = name.isdecimal() and int(name) < plan.count
        if name not in whole and not known:
            yield Problem(f"samples/{name}", "surplus")


def _of_sample(
    store: Store, plan: DatasetPlan, index: int, record: Record | None
) -> Iterator[Problem]:
    if record is None:
        yield Problem(f"samples/{index:06d}", "not made", index)
    elif record.status == "made":
        for name in plan.sample_files:
            stated = record.files.get(name)
            if stated is None:
                yield Problem(f"{record.folder}/{name}", "not made", index)
            else:
                yield from _compare(store, f"{record.folder}/{name}", stated, index)
        for name in sorted(set(store.list(record.folder)) - set(plan.sample_files)):
            yield Problem(f"{record.folder}/{name}", "surplus", index)


def _compare(store: Store, name: str, stated: FileSum, index: int | None) -> Iterator[Problem]:
    with store.local(name) as path:
        if path is None:
            yield Problem(name, "missing", index)
        elif checksum(path) != stated:
            yield Problem(name, "altered", index)
