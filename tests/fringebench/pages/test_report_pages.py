"""Every command's page: what it shows, and that a browser shows it."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenes
from evaluation.gate.equivalence import Estimate, compare
from evaluation.gate.regression import JudgedFigure
from evaluation.scoring.error_budget import budget, variants
from fringebench.datasets.building import build
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.overview_page import example_panels, write_report
from fringebench.datasets.reader import Dataset
from fringebench.exchange.viewer import read_view, write_view
from fringebench.experiments.chapter_experiment import CAPTURES
from fringebench.experiments.hdr_comparison import compare as compare_strategies
from fringebench.experiments.textbook import ChapterResult, ChapterRow
from fringebench.gate.regression_result import Regression
from fringebench.pages.budget_page import budget_figure, budget_report
from fringebench.pages.chapter_page import CAPTIONS, chapter_report
from fringebench.pages.compare_page import compare_report
from fringebench.pages.regress_page import regress_report

SMALL = {"camera.resolution": [64, 48], "sampling.samples": 2}
PAGES = ("chapter", "compare", "regress", "budget", "dataset", "view")


def _regression() -> Regression:
    rows = []
    for metric, new in (("bias_mm", 0.5), ("systematic_mm", 0.1), ("silent_fraction", 0.11)):
        old = Estimate(0.1, 0.01, 8)
        estimate = Estimate(new, 0.01, 8)
        rows.append(
            JudgedFigure("sweep", "ink", metric, estimate, old, compare(estimate, old, 0.1))
        )
    place = "throughout the region, rows 48 to 101, columns 193 to 198"
    places = {("sweep", "ink", "bias_mm"): place}
    return Regression("my:decoder", "base.json", (0, 1, 2), tuple(rows), {}, places=places)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, small_run: Path) -> Path:
    """One page of each command."""
    out = tmp_path_factory.mktemp("pages")
    scene = scenes.load("bench", SMALL)
    compared = compare_strategies(scene, ["max-modulation", "censored-ml"], 2)
    compare_report(compared, scenes.dumps(scene), {"all": 1.0}).write(out / "compare.html")
    regress_report(_regression(), {}).write(out / "regress.html")
    rng = np.random.default_rng(0)
    errors = {on: rng.normal(0.0, 1e-3 * (1 + len(on)), (2, 8, 8)) for on in variants(["a", "b"])}
    found = budget("bench", ["a", "b"], errors, {"base": np.ones((8, 8), bool)})
    budget_report(found, scenes.dumps(scene), 0, {}).write(out / "budget.html")
    row = ChapterRow("apex_clean_mm", 5.994, 5.994, 5.993, f"over {CAPTURES} captures")
    figure = budget_figure(found)
    chapter_report(ChapterResult((row,)), dict.fromkeys(CAPTIONS, figure), {}, 0, {}).write(
        out / "chapter.html"
    )
    build(DatasetPlan.of(scenes.load("spi", SMALL), 2, 0), out / "set")
    write_report(out / "set")
    (out / "set" / "report.html").rename(out / "dataset.html")
    write_view(read_view(small_run / "stack.exr"), "stack.exr", out / "view.html")
    return out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("chapter", ["apex_clean_mm", "5.9940", "5.9930"]),
        ("compare", ["max-modulation", "censored-ml", "Cramér", "solder"]),
        ("regress", ["Failed: 1 of 3 figures, in 1 region", "sweep / ink", "✗"]),
        ("budget", ["interaction", "method itself", "base"]),
        ("dataset", ["train", "spi", "dataset.toml", "2 samples with"]),
        ("view", ["saturated", "calibration"]),
    ],
)
def test_page_shows_what_its_command_found(pages: Path, name: str, words: list[str]) -> None:
    text = (pages / f"{name}.html").read_text("utf-8")
    for word in words:
        assert word in text
    assert "<img" in text
    # Neither a table nor a sentence has a signed zero.
    assert not re.search(
        r"[-−]0(\.0+)?(?=[<\s])",
        re.sub(r"<pre.*?</pre>|<script.*?</script>", "", text, flags=re.DOTALL),
    )
    assert "http://" not in text.replace("http://www.w3.org", "")


def test_data_set_with_its_page_is_verified(pages: Path) -> None:
    from fringebench.datasets.verification import verify

    write_report(pages / "set")
    assert verify(pages / "set") == ()


def test_examples_of_a_data_set_share_one_scale(pages: Path) -> None:
    panels = example_panels(list(Dataset(pages / "set")))
    for unit in ("DN", "mm"):
        shown = [panel for panel in panels if panel.unit == unit]
        assert len(shown) == 2
        assert shown[0].limits == shown[1].limits
        everything = np.concatenate([np.ravel(panel.values) for panel in shown])
        low, high = shown[0].limits or (0.0, 0.0)
        assert np.mean((everything < low) | (everything > high)) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_page_fits_a_narrow_screen_and_has_no_empty_figures(
    pages: Path, tab: Any, name: str
) -> None:
    tab.goto((pages / f"{name}.html").as_uri())
    sizes = tab.eval_on_selector_all("img", "all => all.map(i => i.clientWidth * i.clientHeight)")
    assert sizes
    assert min(sizes) > 10_000
    tab.set_viewport_size({"width": 360, "height": 700})
    assert tab.evaluate("() => document.documentElement.scrollWidth - window.innerWidth") <= 0
    assert tab.evaluate(BROKEN_WORDS) == []
    tab.set_viewport_size({"width": 1400, "height": 900})
    # No table is clipped on a wide screen.
    tab.until(lambda: tab.locator(".hint:visible").count() == 0)
    assert max(tab.evaluate(LOPSIDED), default=0.0) < 2.0, "a row of figures is half empty"
    assert tab.said == []


# Short words that a cell breaks into several lines.
BROKEN_WORDS = """() => [...document.querySelectorAll("td, th")].flatMap((cell) => {
  const text = cell.firstChild, range = document.createRange();
  if (text?.nodeType !== Node.TEXT_NODE) { return []; }
  return [...text.data.matchAll(/[a-z]{3,12}/g)].filter((word) => {
    range.setStart(text, word.index);
    range.setEnd(text, word.index + word[0].length);
    return range.getClientRects().length > 1;
  }).map((word) => word[0]);
})"""
# For each row of figures: by how much its empty space on the left differs from that on the right, px.
LOPSIDED = """() => [...document.querySelectorAll(".figures")].flatMap((box) => {
  const rows = {}, around = box.getBoundingClientRect();
  for (const figure of box.children) {
    const { top, left, right } = figure.getBoundingClientRect();
    const row = (rows[top] ??= { left: around.right, right: around.left });
    Object.assign(row, { left: Math.min(row.left, left), right: Math.max(row.right, right) });
  }
  return Object.values(rows).map((row) => Math.abs(row.left - around.left - (around.right - row.right)));
})"""


@pytest.mark.slow
def test_printed_page_fits_its_figures(pages: Path, tab: Any) -> None:
    tab.goto((pages / "compare.html").as_uri())
    tab.emulate_media(media="print")
    tab.set_viewport_size({"width": 794, "height": 1123})  # A4 at 96 dpi
    widths = tab.eval_on_selector_all("img", "all => all.map(i => i.getBoundingClientRect().right)")
    assert max(widths) <= 794
    assert tab.locator("nav").is_hidden()
