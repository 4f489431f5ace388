"""A data set as a page: counts, some samples as pictures, and the drawn values."""

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import scenes
from evaluation.output.plots import MEASURED, spread
from evaluation.output.report import (
    Block,
    Grid,
    Headline,
    Listing,
    Paragraph,
    Picture,
    Report,
    Section,
)
from evaluation.output.sheet import Panel, contact_sheet
from fringebench.datasets.data_card import card_sections
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.reader import Dataset, Sample
from fringebench.datasets.sample import Record
from fringebench.datasets.store import Store, open_store
from fringebench.pages.origin import provenance

REPORT_FILE = "report.html"
SHOWN = 8
FAILURES = 20
PARAMETERS = 12


def write_report(where: str | Path, card: bool = False) -> str:
    """Write ``report.html`` into a finished data set; returns its path. Raises `DatasetError` where there is no data set.

    With `card` it has the tables of the data card, for which every sample's labels are read.
    """
    store = open_store(where)
    found: Dataset[Sample] = Dataset(where)
    store.write(REPORT_FILE, _report(found, store, card).html().encode())
    return f"{where}/{REPORT_FILE}"


def _report(found: Dataset[Sample], store: Store, card: bool) -> Report:
    from fringebench.datasets.contents import records_of

    plan, records = found.plan, list(records_of(store).values())
    scene = plan.load_scene()
    sections = [Section("Samples", _counts(plan, records))]
    if len(found):
        some = [found[int(i)] for i in np.unique(np.linspace(0, len(found) - 1, SHOWN).round())]
        sheet = contact_sheet(example_panels(some), columns=4, thumb_px=240)
        sections.append(
            Section(
                "Examples",
                [
                    Picture(
                        sheet,
                        "Mean of the frames of the middle exposure, and true height; all on the same scales.",
                        wide=True,
                    )
                ],
            )
        )
    drawn = _drawn(found.records)
    if drawn is not None:
        sections.append(
            Section(
                "What was drawn", [Picture(drawn, "How often each value was drawn.", wide=True)]
            )
        )
    if card:
        sections += card_sections(found)[:-1]
    about = provenance(scenes.dumps(scene), plan.seed, {})
    listing = Listing("dataset.toml", plan.dumps())
    return Report(
        f"fringebench: {len(found)} samples of {scene.name}",
        scene.description,
        [*sections, Section(about.title, [*about.blocks, listing])],
        _headline(records),
    )


def _headline(records: Sequence[Record]) -> Headline:
    """How many samples there are, and what they hold."""
    made = [record for record in records if record.status == "made"]
    pads, defective = sum(r.pads for r in made), sum(r.defective for r in made)
    text = f"{len(made)} samples"
    if pads:
        text += f" with {pads} pads, {defective} of them with a defect"
    missing = len(records) - len(made)
    text += f"; {missing} could not be made." if missing else "; all were made."
    return Headline(text, "attention" if missing else "good")


def _counts(plan: DatasetPlan, records: Sequence[Record]) -> list[Block]:
    rows = []
    for split in plan.splits:
        own = [r for r in records if r.split == split]
        made = [r for r in own if r.status == "made"]
        pads, defective = sum(r.pads for r in made), sum(r.defective for r in made)
        rows.append([split, *map(str, (len(made), len(own) - len(made), pads, defective))])
    blocks: list[Block] = [Grid(("split", "made", "failed", "pads", "pads with a defect"), rows)]
    failed = [record for record in records if record.status == "failed"]
    if failed:
        listed = [[str(r.index), r.reason] for r in failed[:FAILURES]]
        blocks.append(
            Grid(("sample", "reason"), listed, "Samples that could not be made", words=True)
        )
    if len(failed) > FAILURES:
        blocks.append(Paragraph(f"And {len(failed) - FAILURES} more: see manifest.parquet."))
    return blocks


def example_panels(samples: Sequence[Sample]) -> list[Panel]:
    """Light and true height of each sample, each on a scale that all share."""
    stacks = [sample.stack for sample in samples]
    lights = [s.frames[len(s.exposure_ms) // 2].mean(axis=0, dtype=np.float64) for s in stacks]
    heights = [sample.truth.height_mm for sample in samples]
    dn, mm = (spread(np.concatenate([x.ravel() for x in images])) for images in (lights, heights))
    return [
        panel
        for sample, light, height in zip(samples, lights, heights, strict=True)
        for panel in (
            Panel(f"{sample.index} ({sample.split})", light, "DN", "gray", dn),
            Panel("true height", height, "mm", limits=mm),
        )
    ]


def _drawn(records: Sequence[Record]) -> Figure | None:
    """Histograms of the drawn values; None if nothing was drawn."""
    values: dict[str, list[Any]] = {}
    for record in records:
        for key, value in json.loads(record.drawn).items():
            if isinstance(value, int | float | str):
                values.setdefault(key, []).append(value)
    shown = list(values.items())[:PARAMETERS]
    if not shown:
        return None
    columns = min(3, len(shown))
    lines = -(-len(shown) // columns)
    figure = Figure(figsize=(3.6 * columns, 2.2 * lines), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, (key, of_key) in zip(panels, shown, strict=False):
        if any(isinstance(value, str) for value in of_key):
            counts = Counter(map(str, of_key))
            axes.bar(list(counts), list(counts.values()), color=MEASURED)
        else:
            axes.hist(of_key, bins=int(np.clip(np.sqrt(len(of_key)), 5, 50)), color=MEASURED)
        axes.set_title(key, fontsize="small")
        axes.set_ylabel("samples", fontsize="small")
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    return figure
