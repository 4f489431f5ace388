"""A data set as WebDataset shards: plain tar files of whole samples, read in order and without seeking.

An entry is ``000012.picture.png``: the text before the first dot is the sample's key, the rest the field's name.
``labels.json`` is the field ``labels.txt``: Hugging Face's `datasets` makes columns of JSON, each of the type that the first
five samples have in it, and fails on a sample whose masks are of the other kind.
"""

import io
import tarfile
from pathlib import Path

from fringebench.datasets.contents import finished, read_plan
from fringebench.datasets.store import open_store
from scenes.support.errors import DatasetError

SHARDS = "webdataset"
FIELDS = {"labels.json": "labels.txt"}


def write_shards(where: str | Path, samples: int = 100) -> dict[str, int]:
    """Write the samples of a finished data set as tar files, next to them in ``webdataset/``: name of each shard -> its
    samples.

    The same data set gives the same bytes. Raises `DatasetError` if it is not finished, or a sample's file is missing.
    """
    store = open_store(where)
    plan = read_plan(store)
    listed = finished(store, plan)
    store.remove(SHARDS)
    written = {}
    for split in plan.splits:
        own = [r for r in listed.records if r.split == split and r.status == "made"]
        for number, start in enumerate(range(0, len(own), samples)):
            name = f"{SHARDS}/{split}-{number:06d}.tar"
            with store.staging() as folder:
                path = folder / "shard.tar"
                with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as shard:
                    for record in own[start : start + samples]:
                        for file in plan.sample_files:
                            content = store.read(f"{record.folder}/{file}")
                            if content is None:
                                raise DatasetError(
                                    f"'{where}/{record.folder}/{file}' is missing: --repair makes it again"
                                )
                            entry = tarfile.TarInfo(f"{record.index:06d}.{FIELDS.get(file, file)}")
                            entry.size = len(content)
                            shard.addfile(entry, io.BytesIO(content))
                store.put(path, name)
            written[name] = len(own[start : start + samples])
    return written
