"""Is a data set still what its manifest says? Every file is read and its checksum compared."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fringebench.datasets import manifest
from fringebench.datasets.contents import read_manifest, read_plan, records_of
from fringebench.datasets.plan import Plan
from fringebench.datasets.sample import FILES, FileSum, Record, checksum
from fringebench.datasets.store import Store, open_store
from scenes.errors import DatasetError

What = Literal["missing", "altered", "damaged", "not made", "surplus"]


@dataclass(frozen=True)
class Problem:
    """One thing that is not as it should be."""

    file: str
    what: What
    index: int | None = None
    """The sample it belongs to."""


def verify(
    where: str | Path, progress: Callable[[int, int, int], None] | None = None
) -> tuple[Problem, ...]:
    """What is missing, altered, not made or too much in a data set; nothing is changed.

    `progress` is called with samples checked, samples with problems, and samples in all. Raises `DatasetError` where
    there is no data set.
    """
    store = open_store(where)
    return tuple(problems(store, read_plan(store), progress))


def problems(
    store: Store, plan: Plan, progress: Callable[[int, int, int], None] | None = None
) -> Iterator[Problem]:
    """The same for a store at hand."""
    own: Mapping[str, FileSum] = {}
    try:
        listed = read_manifest(store)
        if listed is None:
            yield Problem(manifest.NAME, "missing")
        else:
            own = listed.files
    except DatasetError:
        yield Problem(manifest.NAME, "damaged")
    for name, sums in own.items():
        yield from _compare(store, name, sums, None)
    records = records_of(store)
    bad = 0
    for index in range(plan.count):
        found = list(_of_sample(store, index, records.get(index)))
        yield from found
        bad += bool(found)
        if progress:
            progress(index + 1, bad, plan.count)
    whole = {r.folder.split("/")[-1] for r in records.values() if r.status == "made"}
    for name in store.list("samples"):
        known = name.isdecimal() and int(name) < plan.count
        if name not in whole and not known:
            yield Problem(f"samples/{name}", "surplus")


def _of_sample(store: Store, index: int, record: Record | None) -> Iterator[Problem]:
    if record is None:
        yield Problem(f"samples/{index:06d}", "not made", index)
    elif record.status == "made":
        for name in FILES:
            yield from _compare(store, f"{record.folder}/{name}", record.files[name], index)
        for name in sorted(set(store.list(record.folder)) - set(FILES)):
            yield Problem(f"{record.folder}/{name}", "surplus", index)


def _compare(store: Store, name: str, stated: FileSum, index: int | None) -> Iterator[Problem]:
    with store.local(name) as path:
        if path is None:
            yield Problem(name, "missing", index)
        elif checksum(path) != stated:
            yield Problem(name, "altered", index)
