"""What a data set holds and what it cannot show: sections of its page, and the same as ``README.md``."""

import json
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from evaluation.output.height_image import HeightCode
from evaluation.output.report import Grid, Listing, Paragraph, Section
from fringebench.datasets.dataset_plan import HEIGHTS, MODULATION
from fringebench.datasets.manifest import MANIFEST_FILE
from fringebench.datasets.pictures import modulation_step_dn
from fringebench.datasets.reader import Dataset, Sample
from fringebench.datasets.shards import SHARDS
from fringebench.datasets.store import open_store
from scenes.labels.coco_format import CATEGORIES, IPC_NAMES
from scenes.scene import Scene

CARD_FILE = "README.md"
# Ends of the classes of area ratio; 0.66 is IPC-7525's limit.
RATIOS = (0.0, 0.5, 0.66, 1.0, np.inf)
LIMITS = (
    "Rendered, not photographed: a model trained on it needs a test on real boards before it is used.",
    "Deposits are height fields without overhangs; the mask follows copper in vertical steps; there are no parts; legend, "
    "holes and fiducials only where the plan has them.",
    "How volumes scatter with area ratio is a model with one published anchor (documentation, page on boards), "
    "unless the plan states a table.",
    "Defects are drawn at the stated probabilities, which are higher than on a real line, and independently of each other.",
)


def write_card(where: str | Path) -> str:
    """Write ``README.md`` into a finished data set; returns its path. Raises `DatasetError` where there is none."""
    found: Dataset[Sample] = Dataset(where)
    scene = found.plan.load_scene()
    lines = [
        *_front_matter(found),
        f"# {len(found)} samples of {scene.name}",
        "",
        scene.description,
    ]
    for section in card_sections(found):
        lines += ["", f"## {section.title}", ""]
        for block in section.blocks:
            lines += _markdown(block)
    open_store(where).write(CARD_FILE, ("\n".join(lines) + "\n").encode())
    return f"{where}/{CARD_FILE}"


def card_sections(found: Dataset[Sample]) -> list[Section]:
    """Content, classes, volumes, draws, limits and checksums of a data set."""
    plan, scene = found.plan, found.plan.load_scene()
    classes: dict[str, Counter[str]] = {split: Counter() for split in plan.splits}
    shares: list[tuple[float, float]] = []
    for sample in found:
        names = (CATEGORIES[n["category_id"] - 1] for n in sample.labels["annotations"])
        classes[sample.split].update(names)
        pads = (sample.labels["board"] or {"pads": []})["pads"]
        # Pads without defects, once for each light: what printing alone does.
        shares += [
            (p["area_ratio"], 100.0 * p["volume_mm3"] / p["nominal_volume_mm3"])
            for p in pads
            if not p["defects"] and sample.index % plan.variants == 0
        ]
    camera = scene.camera.projection()
    width, height = scene.camera.resolution
    x0, x1 = camera.points_at(0.0)[height // 2, [0, -1], 0]
    sensor = {key: value for key, value in scene.sensor.model_dump().items() if value}
    content = [
        ["picture", f"{width} x {height} px, {1e3 * abs(x1 - x0) / (width - 1):.1f} um per pixel"],
        ["frames", f"{len(scene.frames)} per exposure, {len(scene.projectors)} projector(s)"],
        ["sensor", ", ".join(f"{key} {value}" for key, value in sensor.items())],
        ["files of a sample", ", ".join(plan.sample_files)],
        *([[HEIGHTS[0], str(HeightCode.of_range(*scene.height_range_mm))]] if plan.heights else []),
        *([[MODULATION, _modulation(scene)]] if plan.modulation else []),
        ["samples per light", str(plan.variants)],
    ]
    balance = [
        [name, IPC_NAMES.get(name, "-"), *(str(classes[split][name]) for split in plan.splits)]
        for name in CATEGORIES
    ]
    sections = [
        Section("Content", [Grid(("what", "value"), content, words=True)]),
        Section("Classes", [Grid(("class", "IPC-7527", *plan.splits), balance, "Annotations")]),
    ]
    if shares:
        sections.append(Section("Volumes", [_volumes(np.array(shares))]))
    if drawn := _drawn(found):
        sections.append(Section("Drawn values", [drawn]))
    digest = found.manifest_sha256
    sections += [
        Section("Known limits", [Paragraph(text) for text in LIMITS]),
        Section(
            "Checksums",
            [
                Paragraph(f"SHA-256 of {MANIFEST_FILE}, which has that of every file: {digest}"),
                Listing("dataset.toml", plan.dumps()),
            ],
        ),
    ]
    return sections


def _modulation(scene: Scene) -> str:
    step_dn = modulation_step_dn(scene.sensor)
    return f"modulation_dn = {step_dn:.9g} * number, at the shortest exposure; 0: no modulation"


def _volumes(shares: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> Grid:
    rows = []
    for low, high in pairwise(RATIOS):
        own = shares[(shares[:, 0] >= low) & (shares[:, 0] < high), 1]
        if len(own):
            cv = 100.0 * own.std() / own.mean()
            name = f"{low:g} to {high:g}" if np.isfinite(high) else f"from {low:g}"
            rows.append([name, str(len(own)), f"{own.mean():.1f}", f"{cv:.1f}"])
    columns = ("area ratio", "pads", "volume, % of nominal", "coefficient of variation, %")
    return Grid(columns, rows, "Pads without a defect")


def _drawn(found: Dataset[Sample]) -> Grid | None:
    drawn = [json.loads(record.drawn) for record in found.records]
    rows = []
    for key, distribution in found.plan.scene.get("randomise", {}).items():
        values = [d[key] for d in drawn if isinstance(d.get(key), int | float)]
        seen = f"{min(values):.4g} to {max(values):.4g}" if values else "-"
        rows.append([key, json.dumps(distribution), seen])
    return Grid(("key", "distribution", "seen"), rows, words=True) if rows else None


def _front_matter(found: Dataset[Sample]) -> list[str]:
    """Where Hugging Face's `datasets` finds the shards."""
    shards = open_store(found.where).list(SHARDS)
    if not shards:
        return []
    splits = [s for s in found.plan.splits if any(name.startswith(f"{s}-") for name in shards)]
    files = [f"  - split: {s}\n    path: {SHARDS}/{s}-*.tar" for s in splits]
    return ["---", "configs:", "- config_name: default", "  data_files:", *files, "---", ""]


def _markdown(block: object) -> Sequence[str]:
    if isinstance(block, Grid):
        head = "| " + " | ".join(block.columns) + " |"
        rows = ["| " + " | ".join(row) + " |" for row in block.rows]
        rule = "|" + " --- |" * len(block.columns)
        return [*([block.caption + ":", ""] if block.caption else []), head, rule, *rows, ""]
    if isinstance(block, Listing):
        return ["", f"{block.title}:", "", "```toml", block.text.rstrip(), "```", ""]
    assert isinstance(block, Paragraph)
    return [f"- {block.text}"]
