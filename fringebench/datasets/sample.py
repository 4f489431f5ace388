"""One sample: how it is drawn and made, and its record."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from evaluation.output.height_image import HeightCode, write_height_image
from fringebench.datasets.dataset_plan import (
    COLOUR,
    HEIGHT_TIFF,
    HEIGHTS,
    MODULATION,
    PICTURE,
    DatasetPlan,
)
from fringebench.datasets.pictures import (
    camera_picture,
    modulation_picture,
    modulation_step_dn,
    srgb,
    write_png,
    write_tiff,
)
from scenes.files.stack import Stack
from scenes.files.truth_maps import Truth
from scenes.labels.coco_format import categories, coco
from scenes.labels.pad_truth import board_truth
from scenes.randomise import realise
from scenes.scene import Scene
from scenes.scene_files import dumps, parse, save
from scenes.support.atomic_file import replacing
from scenes.support.errors import DatasetError, FringebenchError
from scenes.support.frozen import Frozen

if TYPE_CHECKING:
    from decode import Reconstruction
    from render import Transport

LABELS_FORMAT = 2

# Streams of random numbers; `scenes.realise` draws the scene from 0 and 1.
LIGHT, NOISE = 2, 3


class FileSum(Frozen):
    """A file's size and SHA-256."""

    bytes: int
    sha256: str


class Record(Frozen):
    """Status, counts and checksums of a sample; one row of the manifest."""

    index: int
    split: str
    status: Literal["made", "failed"]
    reason: str = ""
    """Why it failed."""
    pads: int = 0
    """Pads in view of the labels; 0 without a board."""
    defective: int = 0
    """Pads with one defect or more."""
    drawn: str = "{}"
    """What `randomise` drew, as JSON."""
    files: dict[str, FileSum] = {}
    """By name; empty if it failed."""

    @property
    def folder(self) -> str:
        """The sample's folder inside the data set."""
        return folder_of(self.index)


def folder_of(index: int) -> str:
    """A sample's folder in its data set: ``samples/000012``."""
    return f"samples/{index:06d}"


def seeds(seed: int, index: int, light_index: int | None = None) -> tuple[int, int]:
    """Seeds of a sample's light paths and of its noise."""
    lit = index if light_index is None else light_index
    light, noise = (
        np.random.SeedSequence((seed, of), spawn_key=(stream,)).generate_state(1, np.uint32)[0]
        for of, stream in ((lit, LIGHT), (index, NOISE))
    )
    return int(light), int(noise)


def attempt(plan: DatasetPlan, scene: Scene, index: int, folder: Path) -> Record:
    """Make sample `index` in an empty folder, or record why it cannot be made.

    `scene` is ``plan.load_scene()``. The files depend on the plan and the index alone. Raises `DatasetError` when files
    cannot be written: the output is at fault then, and the next sample would fail as well.
    """
    try:
        made = _Content.of(plan, scene, index)
    except FringebenchError as error:
        return failed(plan, index, str(error))
    except Exception as error:  # one broken sample must not end the run
        return failed(plan, index, f"{type(error).__name__}: {error}")
    try:
        made.write(folder, plan.sample_files)
        sums = {name: checksum(folder / name) for name in plan.sample_files}
    except (FringebenchError, OSError) as error:
        raise DatasetError(f"sample {index} cannot be written: {error}") from error
    pads = (made.labels["board"] or {}).get("pads", [])
    return Record(
        index=index,
        split=plan.split_of(index),
        status="made",
        pads=len(pads),
        defective=sum(bool(pad["defects"]) for pad in pads),
        drawn=json.dumps(made.labels["drawn"]),
        files=sums,
    )


def failed(plan: DatasetPlan, index: int, reason: str) -> Record:
    """The record of a sample that could not be made."""
    return Record(index=index, split=plan.split_of(index), status="failed", reason=reason)


def checksum(path: Path) -> FileSum:
    """Size and SHA-256 of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return FileSum(bytes=path.stat().st_size, sha256=digest)


@dataclass(frozen=True, eq=False)
class _Content:
    """A sample in memory."""

    scene: Scene
    stack: Stack
    truth: Truth
    measured: "Reconstruction | None"
    labels: dict[str, Any]
    colour: NDArray[np.float32] | None

    @classmethod
    def of(cls, plan: DatasetPlan, scene: Scene, index: int) -> "_Content":
        import decode
        import render
        from render.ring_lights import RINGS

        lit = plan.light_of(index)
        light, noise = seeds(plan.seed, index, lit)
        drawn = realise(scene, index, plan.seed, lit)
        # Of the first variant: render noise is relative to the sensor's, and all of them must share one light.
        first = realise(scene, lit * plan.variants, plan.seed, lit)
        transport, truth, colour = _light(dumps(first), light, plan.ring_light)
        transport = replace(transport, scene=drawn)
        stack = render.expose(transport, seed=noise)
        labels = {
            "format": LABELS_FORMAT,
            "index": index,
            "light_index": lit,
            "seed": plan.seed,
            "light_seed": light,
            "noise_seed": noise,
            "drawn": _drawn(scene, drawn),
            **_coco(drawn, index, PICTURE if plan.picture else "stack.exr"),
            "board": board_truth(drawn).model_dump(mode="json") if drawn.board else None,
        }
        if (reached := transport.render_noise or transport.phase_error) is not None:
            labels["light"] = reached.to_dict() | {"samples": transport.samples}
        if plan.ring_light:
            labels["rings"] = [asdict(ring) for ring in RINGS]
        if plan.heights:
            code = HeightCode.of_range(*drawn.height_range_mm)
            labels["height_png"] = asdict(code) | {"no_height": 0}
        if plan.modulation:
            labels["modulation_png"] = {
                "step_dn": modulation_step_dn(stack.sensor),
                "exposure_ms": min(stack.exposure_ms),
                "no_modulation": 0,
            }
        wanted = plan.heights or plan.modulation or plan.height_tiff
        measured = decode.reconstruct(stack) if wanted else None
        return cls(drawn, stack, truth, measured, labels, colour)

    def write(self, folder: Path, files: Sequence[str]) -> None:
        self.stack.write(folder / "stack.exr")
        self.truth.write(folder / "truth.exr")
        save(self.scene, folder / "scene.toml")
        if PICTURE in files:
            write_png(camera_picture(self.stack), folder / PICTURE)
        if self.colour is not None:
            write_png(srgb(self.colour), folder / COLOUR)
        if self.measured is not None:
            self._write_measured(self.measured, folder, files)
        with replacing(folder / "labels.json") as staged:
            staged.write_text(json.dumps(self.labels, indent=1, allow_nan=False), "utf-8")

    def _write_measured(
        self, measured: "Reconstruction", folder: Path, files: Sequence[str]
    ) -> None:
        if MODULATION in files:
            shown = modulation_picture(measured.modulation_dn, measured.exposure, self.stack)
            write_png(shown, folder / MODULATION)
        heights = np.where(measured.valid, measured.height_mm, np.nan)
        if HEIGHT_TIFF in files:
            write_tiff(heights, folder / HEIGHT_TIFF)
        if HEIGHTS[0] in files:
            code = HeightCode.of_range(*self.scene.height_range_mm)
            write_height_image(folder / HEIGHTS[0], heights, code)
            measured.write(folder / HEIGHTS[1])


@lru_cache(maxsize=1)
def _light(
    scene_text: str, seed: int, ring_light: bool
) -> "tuple[Transport, Truth, NDArray[np.float32] | None]":
    """Light, truth and colour picture of a scene; the next variant of a sample uses the same."""
    import render

    scene = parse(scene_text)
    surfaces = render.surfaces(scene)
    transport = render.trace(scene, seed=seed, surfaces=surfaces)
    colour = render.ring_light_picture(scene, seed, surfaces) if ring_light else None
    return transport, render.truth(scene, transport, surfaces), colour


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


def _coco(scene: Scene, index: int, file: str) -> dict[str, Any]:
    """COCO's keys, so that any reader loads ``labels.json``; without a board there is nothing to detect."""
    file_name = f"{folder_of(index)}/{file}"
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
