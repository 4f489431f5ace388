"""``manifest.parquet``: one row a sample, with its split, its fate and its files' checksums."""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from fringebench.datasets.sample import FILES, FileSum, Record
from scenes.errors import DatasetError

NAME = "manifest.parquet"
# Header entry that holds the checksums of the data set's own files.
KEY = b"fringebench"
FORMAT = 1

_PLAIN = [
    ("index", pa.int64()),
    ("split", pa.string()),
    ("status", pa.string()),
    ("reason", pa.string()),
    ("folder", pa.string()),
    ("pads", pa.int32()),
    ("defective", pa.int32()),
    ("drawn", pa.string()),
]


@dataclass(frozen=True)
class Manifest:
    """Every sample's record, in order, and the checksums of the files beside the samples."""

    records: tuple[Record, ...]
    files: Mapping[str, FileSum] = field(default_factory=dict)
    """Name -> checksum: ``dataset.toml``, ``coco/train.json`` and so on."""

    def to_bytes(self) -> bytes:
        """As Parquet; the same records give the same bytes. Missing files have null checksums."""
        rows: dict[str, Sequence[object]] = {
            name: [getattr(record, name) for record in self.records] for name, _ in _PLAIN
        }
        columns = list(_PLAIN)
        for name in FILES:
            stem = name.replace(".", "_")
            sums = [record.files.get(name) for record in self.records]
            rows[f"{stem}_bytes"] = [s and s.bytes for s in sums]
            rows[f"{stem}_sha256"] = [s and s.sha256 for s in sums]
            columns += [(f"{stem}_bytes", pa.int64()), (f"{stem}_sha256", pa.string())]
        own = {name: sums.model_dump() for name, sums in sorted(self.files.items())}
        header = {KEY: json.dumps({"format": FORMAT, "files": own}).encode()}
        table = pa.Table.from_pydict(rows, schema=pa.schema(columns, metadata=header))
        sink = io.BytesIO()
        pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
        return sink.getvalue()

    @classmethod
    def of_bytes(cls, content: bytes, where: str) -> "Manifest":
        """What `to_bytes` gave; `DatasetError` for anything else."""
        try:
            table = pq.read_table(io.BytesIO(content), page_checksum_verification=True)
            header = json.loads((table.schema.metadata or {})[KEY])
            if header["format"] != FORMAT:
                raise DatasetError(
                    f"'{where}' has format {header['format']}, this version reads {FORMAT}"
                )
            rows = table.to_pylist()
            own = {name: FileSum(**sums) for name, sums in header["files"].items()}
            return cls(tuple(_record(row) for row in rows), own)
        except (pa.ArrowException, OSError, KeyError, TypeError, ValueError, ValidationError) as e:
            raise DatasetError(
                f"'{where}' is damaged, or no manifest of a data set ({_first_line(e)})"
            ) from e


def _record(row: dict[str, object]) -> Record:
    files = {}
    for name in FILES:
        stem = name.replace(".", "_")
        size, digest = row[f"{stem}_bytes"], row[f"{stem}_sha256"]
        if digest is not None:
            files[name] = FileSum.model_validate({"bytes": size, "sha256": digest})
    plain = {name: row[name] for name, _ in _PLAIN if name != "folder"}
    return Record.model_validate(plain | {"files": files})


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
