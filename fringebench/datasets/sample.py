"""One sample: what it is drawn from, how it is made, and the record kept of it."""

import hashlib
import json
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fringebench.datasets.plan import Plan
from scenes.board_labels import board_truth
from scenes.coco import categories, coco
from scenes.errors import DatasetError, FringebenchError
from scenes.frozen import Frozen
from scenes.load import save
from scenes.realise import realise
from scenes.replace_file import replacing
from scenes.scene import Scene

FILES = ("stack.exr", "truth.exr", "scene.toml", "labels.json")
LABELS_FORMAT = 1
# Streams of random numbers beside those that `scenes.realise` draws the scene from (0 and 1).
LIGHT, NOISE = 2, 3


class FileSum(Frozen):
    """A file's size and SHA-256."""

    bytes: int
    sha256: str


class Record(Frozen):
    """What is known of a sample; one row of the manifest."""

    index: int
    split: str
    status: Literal["made", "failed"]
    reason: str = ""
    """Why it failed."""
    pads: int = 0
    """Pads in view of the labels; 0 without a board."""
    defective: int = 0
    """Pads with at least one defect."""
    drawn: str = "{}"
    """What `randomise` drew, as JSON."""
    files: dict[str, FileSum] = {}
    """By name; empty if it failed."""

    @property
    def folder(self) -> str:
        """The sample's folder inside the data set."""
        return folder_of(self.index)


def folder_of(index: int) -> str:
    """Where a sample lies in its data set: ``samples/000012``."""
    return f"samples/{index:06d}"


def seeds(seed: int, index: int) -> tuple[int, int]:
    """Seeds of a sample's light paths and of its noise."""
    light, noise = (
        np.random.SeedSequence((seed, index), spawn_key=(stream,)).generate_state(1, np.uint32)[0]
        for stream in (LIGHT, NOISE)
    )
    return int(light), int(noise)


def attempt(plan: Plan, scene: Scene, index: int, folder: Path) -> Record:
    """Make sample `index` in an empty folder, or record why it cannot be made.

    `scene` is ``plan.load_scene()``. The files depend on the plan and the index alone. Raises `DatasetError` when files
    cannot be written: that is the output's failure, not the sample's, and the next one would fail as well.
    """
    try:
        made = _Content.of(plan, scene, index)
    except FringebenchError as error:
        return failed(plan, index, str(error))
    except Exception as error:  # one broken sample must not take a night's run with it
        return failed(plan, index, f"{type(error).__name__}: {error}")
    try:
        made.write(folder)
        sums = {name: checksum(folder / name) for name in FILES}
    except (FringebenchError, OSError) as error:
        raise DatasetError(f"sample {index} cannot be written: {error}") from error
    pads = (made.labels["board"] or {}).get("pads", [])
    return Record(
        index=index,
        split=plan.split_of(index),
        status="made",
        pads=len(pads),
        defective=sum(bool(pad["defects"]) for pad in pads),
        drawn=json.dumps(made.drawn),
        files=sums,
    )


def failed(plan: Plan, index: int, reason: str) -> Record:
    """The record of a sample that could not be made."""
    return Record(index=index, split=plan.split_of(index), status="failed", reason=reason)


def checksum(path: Path) -> FileSum:
    """Size and SHA-256 of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return FileSum(bytes=path.stat().st_size, sha256=digest)


class _Content:
    """A sample in memory."""

    def __init__(self, scene: Scene, stack: Any, truth: Any, labels: dict[str, Any]) -> None:
        self.scene, self.stack, self.truth, self.labels = scene, stack, truth, labels

    @classmethod
    def of(cls, plan: Plan, scene: Scene, index: int) -> "_Content":
        import render

        light, noise = seeds(plan.seed, index)
        drawn = realise(scene, index, plan.seed)
        surfaces = render.surfaces(drawn)
        transport = render.trace(drawn, seed=light, surfaces=surfaces)
        truth = render.truth(drawn, transport, surfaces)
        stack = render.expose(transport, seed=noise)
        labels = {
            "format": LABELS_FORMAT,
            "index": index,
            "seed": plan.seed,
            "light_seed": light,
            "noise_seed": noise,
            "drawn": _drawn(scene, drawn),
            **_coco(drawn, index),
            "board": board_truth(drawn).model_dump(mode="json") if drawn.board else None,
        }
        if transport.phase_error is not None:
            labels["light"] = transport.phase_error.to_dict() | {"samples": transport.samples}
        return cls(drawn, stack, truth, labels)

    @property
    def drawn(self) -> dict[str, Any]:
        drawn: dict[str, Any] = self.labels["drawn"]
        return drawn

    def write(self, folder: Path) -> None:
        self.stack.write(folder / "stack.exr")
        self.truth.write(folder / "truth.exr")
        save(self.scene, folder / "scene.toml")
        with replacing(folder / "labels.json") as beside:
            beside.write_text(json.dumps(self.labels, indent=1, allow_nan=False), "utf-8")


def _drawn(scene: Scene, drawn: Scene) -> dict[str, Any]:
    """Dotted key -> value of everything `randomise` set."""
    tree = drawn.model_dump(mode="json")
    values = {}
    for key in scene.randomise:
        node: Any = tree
        for part in key.split("."):
            node = node[int(part)] if isinstance(node, list) else node[part]
        values[key] = node
    return values


def _coco(scene: Scene, index: int) -> dict[str, Any]:
    """COCO's keys, so that a stock reader takes ``labels.json`` as it is; without a board there is nothing to detect."""
    file_name = f"{folder_of(index)}/stack.exr"
    if scene.board is not None:
        return coco(scene, file_name, index + 1)
    width, height = scene.camera.resolution
    image = {"id": index + 1, "file_name": file_name, "width": width, "height": height}
    return {
        "info": {"description": scene.description, "version": "1.0"},
        "licenses": [],
        "images": [image],
        "annotations": [],
        "categories": categories(),
    }
