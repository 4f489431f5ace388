"""One COCO file for each split, ``coco/train.json`` and so on, merged from the samples' labels.

Written piece by piece: the labels of ten thousand boards are a gigabyte and need not fit into memory.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.sample import Record
from fringebench.datasets.store import Store
from scenes.labels.coco_format import categories
from scenes.support.errors import DatasetError


def write(
    plan: DatasetPlan, store: Store, records: tuple[Record, ...], folder: Path
) -> dict[str, Path]:
    """Write every split's file into a local folder; name in the data set -> path. Empty splits get one too.

    Images and annotations come in the order of samples, image ids are index + 1, annotation ids count from 1.
    """
    return {
        f"coco/{split}.json": _write(store, [r for r in records if r.split == split], folder, split)
        for split in plan.splits
    }


def _write(store: Store, records: list[Record], folder: Path, split: str) -> Path:
    path = folder / f"{split}.json"
    made = [record for record in records if record.status == "made"]
    with path.open("w", encoding="utf-8") as file:
        file.write('{"info": {"description": ' + json.dumps(split) + ', "version": "1.0"},\n')
        file.write('"licenses": [],\n"categories": ' + json.dumps(categories()) + ",\n")
        file.write('"images": [')
        file.writelines(_listed(_entries(store, made, "images")))
        file.write('],\n"annotations": [')
        notes = enumerate(_entries(store, made, "annotations"), start=1)
        file.writelines(_listed(note | {"id": number} for number, note in notes))
        file.write("]}\n")
    return path


def _entries(store: Store, records: list[Record], key: str) -> Iterator[dict[str, Any]]:
    for record in records:
        name = f"{record.folder}/labels.json"
        content = store.read(name)
        if content is None:
            raise DatasetError(
                f"'{store.where}/{name}' is missing: fringebench dataset --repair makes it again"
            )
        yield from json.loads(content)[key]


def _listed(entries: Iterator[dict[str, Any]]) -> Iterator[str]:
    for i, entry in enumerate(entries):
        yield ("\n" if i == 0 else ",\n") + json.dumps(entry)
