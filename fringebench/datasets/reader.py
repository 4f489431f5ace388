"""Read a data set: `Dataset(path)[i]` is a sample whose files are opened when they are asked for.

Map-style, as PyTorch's ``DataLoader`` expects it, without torch: it has ``__len__`` and ``__getitem__`` and can be pickled.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

from fringebench.datasets.contents import finished, read_plan
from fringebench.datasets.manifest import MANIFEST_FILE
from fringebench.datasets.pictures import read_png
from fringebench.datasets.sample import Record
from fringebench.datasets.store import Store, open_store
from scenes.files.stack import Stack
from scenes.files.truth_maps import Truth
from scenes.labels.pad_truth import BoardTruth
from scenes.scene_files import parse
from scenes.support.errors import DatasetError, nearest

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from decode import Reconstruction
    from scenes.scene import Scene

T = TypeVar("T")
F = TypeVar("F")


@dataclass(frozen=True)
class Sample:
    """One sample of a data set; each file is read once, when first asked for. `FileError` if it is damaged."""

    record: Record
    store: Store

    @property
    def index(self) -> int:
        """Its number in the data set."""
        return self.record.index

    @property
    def split(self) -> str:
        """The split it belongs to."""
        return self.record.split

    @property
    def drawn(self) -> dict[str, Any]:
        """Dotted key -> value of what `randomise` drew for it."""
        drawn: dict[str, Any] = json.loads(self.record.drawn)
        return drawn

    @cached_property
    def stack(self) -> Stack:
        """The raw frames with patterns, exposures, sensor and calibration."""
        return self._read("stack.exr", Stack.read)

    @property
    def frames(self) -> NDArray[np.generic]:
        """Digital numbers, (exposure, frame, row, col)."""
        return self.stack.frames

    @cached_property
    def picture(self) -> NDArray[np.uint8]:
        """``picture.png``: (row, col), 0 to 255."""
        return self._read("picture.png", read_png)

    @cached_property
    def colour(self) -> NDArray[np.uint8]:
        """``colour.png``: (row, col, channel), 0 to 255; only in data sets made with `ring_light`."""
        return self._read("colour.png", read_png)

    @cached_property
    def modulation_dn(self) -> NDArray[np.floating]:
        """``modulation.png`` in DN at the shortest exposure, (row, col), 0 where it is not known; only in data sets made with `modulation`."""
        numbers = self._read("modulation.png", read_png)
        step_dn: float = self.labels["modulation_png"]["step_dn"]
        return step_dn * numbers

    @cached_property
    def reconstruction(self) -> Reconstruction:
        """Measured heights; only in data sets made with `heights`."""
        from decode import Reconstruction

        return self._read("reconstruction.exr", Reconstruction.read)

    @cached_property
    def truth(self) -> Truth:
        """Truth maps, (row, col): height, points, normals, labels, light."""
        return self._read("truth.exr", Truth.read)

    @cached_property
    def labels(self) -> dict[str, Any]:
        """The whole of ``labels.json``: COCO's keys, and `board`."""
        labels: dict[str, Any] = json.loads(self._text("labels.json"))
        return labels

    @cached_property
    def board(self) -> BoardTruth | None:
        """Truth of every pad; None for a scene without a board."""
        board = self.labels["board"]
        return None if board is None else BoardTruth.model_validate(board)

    @cached_property
    def scene(self) -> Scene:
        """The scene as drawn: `render.trace` of it with the `light_seed` of `labels` gives this sample's light."""
        return parse(self._text("scene.toml"), where=self._name("scene.toml"))

    def _read(self, file: str, read: Callable[[Path], F]) -> F:
        with self.store.local(self._name(file)) as path:
            return read(path or self._missing(file))

    def _name(self, file: str) -> str:
        return f"{self.record.folder}/{file}"

    def _text(self, file: str) -> str:
        content = self.store.read(self._name(file))
        return self._missing(file) if content is None else content.decode()

    def _missing(self, file: str) -> Any:
        place = f"'{self.store.where}/{self._name(file)}'"
        if not self.record.files.get(file):
            raise DatasetError(
                f"{place} is not part of this data set: make one with --picture, --heights, --height-tiff, "
                "--ring-light or --modulation"
            )
        raise DatasetError(f"{place} is missing: fringebench dataset --repair makes it again")


class Dataset(Generic[T]):
    """The samples of a data set, or of one split of it, in order; those that failed are left out.

    `where` is a folder or any fsspec URL. `transform` is applied to each sample as it is taken. Raises `DatasetError`
    where there is no whole data set, or no such split.

    >>> from fringebench import Dataset
    >>> for sample in Dataset("boards", split="train"):  # doctest: +SKIP
    ...     print(sample.index, sample.frames.shape, sample.truth.height_mm.max())
    """

    @overload
    def __init__(
        self: Dataset[Sample], where: str | Path, split: str | None = None, transform: None = None
    ) -> None: ...
    @overload
    def __init__(
        self: Dataset[T],
        where: str | Path,
        split: str | None = None,
        *,
        transform: Callable[[Sample], T],
    ) -> None: ...
    def __init__(
        self,
        where: str | Path,
        split: str | None = None,
        transform: Callable[[Sample], T] | None = None,
    ) -> None:
        self._store = open_store(where)
        self.where = where
        """The folder or URL."""
        self.plan = read_plan(self._store)
        """The plan it was made from."""
        listed = finished(self._store, self.plan)
        if split is not None and split not in self.plan.splits:
            raise DatasetError(
                f"no split '{split}' in '{where}': {nearest(split, self.plan.splits)}"
            )
        self.records = tuple(
            record
            for record in listed.records
            if record.status == "made" and split in (None, record.split)
        )
        """Of each sample, in order of index."""
        self._transform = transform

    @property
    def manifest_sha256(self) -> str:
        """SHA-256 of the manifest, which holds those of all files."""
        return hashlib.sha256(self._store.read(MANIFEST_FILE) or b"").hexdigest()

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, i: int) -> T:
        """Sample `i`, counted among these; `IndexError` beyond the last, as iteration expects."""
        sample = Sample(self.records[i], self._store)
        return self._transform(sample) if self._transform else sample  # type: ignore[return-value]

    def __iter__(self) -> Iterator[T]:
        return (self[i] for i in range(len(self)))
