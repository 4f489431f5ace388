"""The plan and the records of a data set."""

from pydantic import ValidationError

from fringebench.datasets.dataset_plan import PLAN_FILE, DatasetPlan
from fringebench.datasets.manifest import MANIFEST_FILE, Manifest
from fringebench.datasets.sample import Record
from fringebench.datasets.store import Store
from scenes.support.errors import DatasetError

# Records of samples made since the manifest was written, one file each.
RECORDS = "records"


def read_plan(store: Store) -> DatasetPlan:
    """The plan of the data set in a store; `DatasetError` if there is none."""
    text = store.read(PLAN_FILE)
    if text is None:
        raise DatasetError(
            f"'{store.where}' holds no data set ({PLAN_FILE} is missing): make one with fringebench dataset"
        )
    return DatasetPlan.loads(text.decode(errors="replace"), f"{store.where}/{PLAN_FILE}")


def read_manifest(store: Store) -> Manifest | None:
    """The manifest, None if it is missing; `DatasetError` if it is damaged."""
    content = store.read(MANIFEST_FILE)
    if content is None:
        return None
    return Manifest.of_bytes(content, f"{store.where}/{MANIFEST_FILE}")


def finished(store: Store, plan: DatasetPlan) -> Manifest:
    """The manifest, if it lists all samples of the plan; `DatasetError` for a set that a run has yet to finish."""
    listed = read_manifest(store)
    if listed is None or len(listed.records) < plan.count:
        raise DatasetError(
            f"the data set at '{store.where}' is not finished: run fringebench dataset again to continue it"
        )
    return listed


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
    """Write a sample's record: from then on it counts as made."""
    store.write(f"{RECORDS}/{record.index:06d}.json", record.model_dump_json().encode())
