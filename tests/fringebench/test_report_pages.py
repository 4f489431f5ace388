"""Every command's page: what it shows, and that a browser shows it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenes
from evaluation.budget import budget, variants
from evaluation.equivalence import Estimate, compare
from evaluation.regression import Row
from fringebench.budget_report import budget_figure, budget_report
from fringebench.chapter import CAPTURES, ChapterResult
from fringebench.chapter import Row as ChapterRow
from fringebench.chapter_report import CAPTIONS, chapter_report
from fringebench.compare import compare as compare_strategies
from fringebench.compare_report import compare_report
from fringebench.datasets.build import build
from fringebench.datasets.plan import Plan
from fringebench.datasets.report import write_report
from fringebench.regress import Regression
from fringebench.regress_report import regress_report
from fringebench.run import run
from fringebench.view import view, write_view

SMALL = {"camera.resolution": [64, 48], "sampling.samples": 2}
PAGES = ("chapter", "compare", "regress", "budget", "dataset", "view")


def _regression() -> Regression:
    rows = []
    for metric, new in (("bias_mm", 0.5), ("systematic_mm", 0.1), ("silent_fraction", 0.11)):
        old = Estimate(0.1, 0.01, 8)
        estimate = Estimate(new, 0.01, 8)
        rows.append(Row("sweep", "ink", metric, estimate, old, compare(estimate, old, 0.1)))
    return Regression("my:decoder", "baseline.json", tuple(rows), {})


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
    build(Plan.of(scenes.load("spi", SMALL), 2, 0), out / "set")
    write_report(out / "set")
    (out / "set" / "report.html").rename(out / "dataset.html")
    run(scenes.load("step", SMALL), out / "run")
    write_view(view(out / "run" / "stack.exr"), "stack.exr", out / "view.html")
    return out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("chapter", ["apex_clean_mm", "5.9940", "5.9930"]),
        ("compare", ["max-modulation", "censored-ml", "Cramér", "solder"]),
        ("regress", ["1 of 3 figures failed", "sweep / ink: bias", "worse"]),
        ("budget", ["interaction", "method itself", "base"]),
        ("dataset", ["train", "spi", "dataset.toml"]),
        ("view", ["saturated", "calibration"]),
    ],
)
def test_a_page_lacks_what_its_command_found(pages: Path, name: str, words: list[str]) -> None:
    text = (pages / f"{name}.html").read_text("utf-8")
    for word in words:
        assert word in text
    assert "<img" in text
    assert "http://" not in text.replace("http://www.w3.org", "")


def test_a_data_set_with_its_page_is_called_damaged(pages: Path) -> None:
    from fringebench.datasets.verify import verify

    write_report(pages / "set")
    assert verify(pages / "set") == ()


@pytest.fixture
def tab(browser: Any) -> Iterator[Any]:
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.said = []
    page.on("console", lambda m: page.said.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda e: page.said.append(str(e)))
    page.on("request", lambda r: page.said.append(r.url) if r.url.startswith("http") else None)
    yield page
    page.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_page_breaks_on_a_narrow_screen_or_has_empty_figures(
    pages: Path, tab: Any, name: str
) -> None:
    tab.goto((pages / f"{name}.html").as_uri())
    sizes = tab.eval_on_selector_all("img", "all => all.map(i => i.clientWidth * i.clientHeight)")
    assert sizes
    assert min(sizes) > 10_000
    tab.set_viewport_size({"width": 360, "height": 700})
    assert tab.evaluate("() => document.documentElement.scrollWidth - window.innerWidth") <= 0
    assert tab.said == []


@pytest.mark.slow
def test_a_printed_page_has_no_room_for_its_figures(pages: Path, tab: Any) -> None:
    tab.goto((pages / "compare.html").as_uri())
    tab.emulate_media(media="print")
    tab.set_viewport_size({"width": 794, "height": 1123})  # A4 at 96 dpi
    widths = tab.eval_on_selector_all("img", "all => all.map(i => i.getBoundingClientRect().right)")
    assert max(widths) <= 794
    assert tab.locator("nav").is_hidden()
