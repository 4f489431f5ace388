"""``manifest.parquet``: one row a sample, with its split, status and file checksums."""

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from fringebench.datasets.dataset_plan import EVERY_FILE
from fringebench.datasets.sample import FileSum, Record
from scenes.support.errors import DatasetError

MANIFEST_FILE = "manifest.parquet"
# Header entry that holds the checksums of the data set's own files.
KEY = b"fringebench"
# Header entry with the SHA-256 of the whole file, taken with this entry all zeros: page checksums do not cover the
# footer.
DIGEST_KEY = b"fringebench.sha256"
NO_DIGEST = b"0" * 64
MANIFEST_FORMAT = 2

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
    """Every sample's record, in order, and the checksums of the data set's own files."""

    records: tuple[Record, ...]
    files: Mapping[str, FileSum] = field(default_factory=dict)
    """Name -> checksum: ``dataset.toml``, ``coco/train.json`` and so on."""

    def to_bytes(self) -> bytes:
        """As Parquet; the same records give the same bytes. Missing files have null checksums."""
        rows: dict[str, Sequence[object]] = {
            name: [getattr(record, name) for record in self.records] for name, _ in _PLAIN
        }
        columns = list(_PLAIN)
        for name in EVERY_FILE:
            stem = name.replace(".", "_")
            sums = [record.files.get(name) for record in self.records]
            rows[f"{stem}_bytes"] = [s and s.bytes for s in sums]
            rows[f"{stem}_sha256"] = [s and s.sha256 for s in sums]
            columns += [(f"{stem}_bytes", pa.int64()), (f"{stem}_sha256", pa.string())]
        own = {name: sums.model_dump() for name, sums in sorted(self.files.items())}
        table = pa.Table.from_pydict(rows, schema=pa.schema(columns))
        text = json.dumps({"format": MANIFEST_FORMAT, "files": own})
        sink = io.BytesIO()
        with pq.ParquetWriter(
            sink, table.schema, compression="zstd", write_page_checksum=True
        ) as writer:
            writer.write_table(table)
            # Of the file and not of the table, whose header is written twice.
            writer.add_key_value_metadata({KEY: text.encode(), DIGEST_KEY: NO_DIGEST})
        content = sink.getvalue()
        return content.replace(NO_DIGEST, hashlib.sha256(content).hexdigest().encode())

    @classmethod
    def of_bytes(cls, content: bytes, where: str) -> "Manifest":
        """What `to_bytes` gave; `DatasetError` for anything else."""
        try:
            file = pq.ParquetFile(io.BytesIO(content), page_checksum_verification=True)
            table, entries = file.read(), file.metadata.metadata or {}
            header = json.loads(entries[KEY])
            if header["format"] != MANIFEST_FORMAT:
                raise DatasetError(
                    f"'{where}' has format {header['format']}, this version reads {MANIFEST_FORMAT}"
                )
            stated = entries[DIGEST_KEY]
            blank = content.replace(stated, NO_DIGEST) if len(stated) == len(NO_DIGEST) else b""
            if hashlib.sha256(blank).hexdigest().encode() != stated:
                raise DatasetError(f"'{where}' is damaged: its content does not match its checksum")
            rows = table.to_pylist()
            own = {name: FileSum(**sums) for name, sums in header["files"].items()}
            return cls(tuple(_record(row) for row in rows), own)
        except (pa.ArrowException, OSError, KeyError, TypeError, ValueError, ValidationError) as e:
            raise DatasetError(
                f"'{where}' is damaged or is not the manifest of a data set ({_first_line(e)})"
            ) from e


def _record(row: dict[str, object]) -> Record:
    files = {}
    for name in EVERY_FILE:
        stem = name.replace(".", "_")
        # Absent in data sets made before there was such a file.
        size, digest = row.get(f"{stem}_bytes"), row.get(f"{stem}_sha256")
        if digest is not None:
            files[name] = FileSum.model_validate({"bytes": size, "sha256": digest})
    plain = {name: row[name] for name, _ in _PLAIN if name != "folder"}
    return Record.model_validate(plain | {"files": files})


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
