"""What a data set holds: its plan, and the records of its samples."""

from pydantic import ValidationError

from fringebench.datasets import manifest
from fringebench.datasets import plan as plans
from fringebench.datasets.manifest import Manifest
from fringebench.datasets.plan import Plan
from fringebench.datasets.sample import Record
from fringebench.datasets.store import Store
from scenes.errors import DatasetError

# Records of samples made since the manifest was written, one file each.
RECORDS = "records"


def read_plan(store: Store) -> Plan:
    """The plan of the data set in a store; `DatasetError` if there is none."""
    text = store.read(plans.NAME)
    if text is None:
        raise DatasetError(
            f"'{store.where}' holds no data set ({plans.NAME} is missing): make one with fringebench dataset"
        )
    return Plan.loads(text.decode(errors="replace"), f"{store.where}/{plans.NAME}")


def read_manifest(store: Store) -> Manifest | None:
    """The manifest, None if it is missing; `DatasetError` if it is damaged."""
    content = store.read(manifest.NAME)
    if content is None:
        return None
    return Manifest.of_bytes(content, f"{store.where}/{manifest.NAME}")


def records_of(store: Store) -> dict[int, Record]:
    """Index -> record of every sample made so far: the manifest's, and those since. A damaged one counts as none."""
    try:
        listed = read_manifest(store)
    except DatasetError:
        listed = None
    records = {record.index: record for record in listed.records} if listed else {}
    for name in store.list(RECORDS):
        text = store.read(f"{RECORDS}/{name}")
        try:
            record = Record.model_validate_json(text or b"")
        except ValidationError:
            continue
        records[record.index] = record
    return records


def keep_record(store: Store, record: Record) -> None:
    """Write a sample's record: from now on it counts as made."""
    store.write(f"{RECORDS}/{record.index:06d}.json", record.model_dump_json().encode())
