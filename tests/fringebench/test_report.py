"""The report, opened in a real browser where there is one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import scenes
from evaluation.report import Grid, Listing, Paragraph, Report, Section
from fringebench.run import run


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a full-size run, which is what its limits are stated for."""
    folder = tmp_path_factory.mktemp("report")
    run(scenes.load("bench", {"sampling.samples": 4}), folder)
    return folder / "report.html"


@pytest.fixture
def page(browser: Any, report: Path) -> Iterator[Any]:
    """The report, open; what the console said is in `page.said`."""
    tab = browser.new_page(viewport={"width": 1280, "height": 900})
    tab.said = []
    tab.on("console", lambda m: tab.said.append(m.text) if m.type == "error" else None)
    tab.on("pageerror", lambda e: tab.said.append(str(e)))
    tab.on("request", lambda r: tab.said.append(r.url) if r.url.startswith("http") else None)
    tab.goto(report.as_uri())
    yield tab
    tab.close()


def drawn_surface(page: Any) -> Any:
    surface = page.locator(".surface")
    surface.scroll_into_view_if_needed()
    page.wait_for_selector(".surface canvas", timeout=30_000)
    page.wait_for_timeout(1000)
    return surface


def test_the_file_is_small_enough_to_send(report: Path) -> None:
    assert report.stat().st_size < 15e6


def test_what_a_scene_says_cannot_become_markup() -> None:
    bad = "<script>alert(1)</script>"
    html = Report(
        bad, bad, [Section(bad, [Paragraph(bad), Grid([bad], [[bad]], bad), Listing(bad, bad)])]
    ).html()
    assert "<script>alert" not in html


@pytest.mark.slow
def test_it_opens_without_error_or_network_and_every_figure_has_size(page: Any) -> None:
    drawn_surface(page)
    assert page.said == []
    sizes = page.eval_on_selector_all(
        "img", "all => all.map(i => i.naturalWidth * i.naturalHeight)"
    )
    assert len(sizes) >= 10
    assert min(sizes) > 10_000
    assert page.eval_on_selector_all("img", "all => all.every(i => i.alt.length > 10)")


@pytest.mark.slow
def test_it_takes_longer_than_three_seconds_to_open(page: Any) -> None:
    opened = "() => performance.getEntriesByType('navigation')[0].loadEventEnd"
    page.wait_for_load_state("load")
    assert 0 < page.evaluate(opened) < 3000
    # What takes long, the 3-D view's program, is unpacked when it comes into view, not before.
    assert page.evaluate("() => typeof window.Plotly") == "undefined"


@pytest.mark.slow
def test_the_surface_draws_turns_by_keyboard_and_tells_the_pixel_under_the_pointer(
    page: Any,
) -> None:
    surface = drawn_surface(page)
    before = surface.screenshot()
    page.get_by_role("button", name="from above").focus()
    for _ in range(4):
        page.keyboard.press("Enter")
    page.wait_for_timeout(800)
    assert surface.screenshot() != before
    box = surface.bounding_box()
    text = ""
    for fraction in (0.5, 0.45, 0.55, 0.4, 0.6):
        page.mouse.move(box["x"] + box["width"] * fraction, box["y"] + box["height"] * fraction)
        page.wait_for_timeout(700)
        text = page.evaluate("() => document.querySelector('.surface').textContent")
        if "truth" in text:
            break
    assert "pixel" in text
    assert "truth" in text


@pytest.mark.slow
def test_the_keyboard_reaches_links_tables_buttons_and_the_listing(page: Any) -> None:
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("() => document.activeElement.tagName"))
    assert {"A", "BUTTON", "DIV", "SUMMARY"} <= reached


@pytest.mark.slow
@pytest.mark.parametrize("width", [360, 800])
def test_a_narrow_screen_scrolls_tables_not_the_page(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 700})
    drawn_surface(page)
    overflow = page.evaluate("() => document.documentElement.scrollWidth - window.innerWidth")
    assert overflow <= 0
    assert page.said == []
