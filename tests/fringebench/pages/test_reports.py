"""The report, opened in a real browser where there is one."""

import itertools
from pathlib import Path
from typing import Any

import pytest

import scenes
from evaluation.output.report import Grid, Listing, Paragraph, Report, Section
from fringebench.verbs import run


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a full-size run, which is what its limits are stated for."""
    folder = tmp_path_factory.mktemp("report")
    run(scenes.load("bench", {"sampling.samples": 4}), folder)
    return folder / "report.html"


@pytest.fixture
def page(tab: Any, report: Path) -> Any:
    """The report, open."""
    tab.goto(report.as_uri())
    return tab


def drawn_surface(page: Any) -> Any:
    surface = page.locator(".surface")
    surface.scroll_into_view_if_needed()
    page.wait_for_selector(".surface.drawn canvas")
    page.until(lambda: at_rest(page, surface))
    return surface


def at_rest(page: Any, surface: Any) -> bool:
    """Whether two pictures in a row are the same."""
    before = surface.screenshot()
    page.wait_for_timeout(500)
    return bool(surface.screenshot() == before)


@pytest.mark.slow
def test_report_is_small_enough_to_send(report: Path) -> None:
    assert report.stat().st_size < 15e6


def test_text_of_a_scene_cannot_become_markup() -> None:
    bad = "</script><script>alert(1)</script><img src=x onerror=alert(1)>"
    html = Report(
        bad, bad, [Section(bad, [Paragraph(bad), Grid([bad], [[bad]], bad), Listing(bad, bad)])]
    ).html()
    assert "<script>alert" not in html
    assert "<img src=x" not in html


@pytest.mark.slow
def test_report_opens_without_error_or_network_and_figures_have_size(page: Any) -> None:
    drawn_surface(page)
    assert page.said == []
    # Styles of the page's own canvases do not reach those of plotly.
    assert (
        page.evaluate(
            "() => getComputedStyle(document.querySelector('.surface canvas')).borderTopWidth"
        )
        == "0px"
    )
    sizes = page.eval_on_selector_all(
        "img", "all => all.map(i => i.naturalWidth * i.naturalHeight)"
    )
    assert len(sizes) >= 10
    assert min(sizes) > 10_000
    assert page.eval_on_selector_all("img", "all => all.every(i => i.alt.length > 10)")


@pytest.mark.slow
def test_program_of_the_3d_view_is_unpacked_when_it_comes_into_view(page: Any) -> None:
    # It takes seconds of processor time, which a reader of the tables does not need.
    page.wait_for_load_state("load")
    assert page.evaluate("() => typeof window.Plotly") == "undefined"
    drawn_surface(page)
    assert page.evaluate("() => typeof window.Plotly") == "object"


@pytest.mark.slow
def test_surface_turns_by_keyboard_and_shows_the_pixel_under_the_pointer(page: Any) -> None:
    surface = drawn_surface(page)
    before = surface.screenshot()
    page.get_by_role("button", name="from above").focus()
    for _ in range(4):
        page.keyboard.press("Enter")
    page.until(lambda: surface.screenshot() != before)
    box = surface.bounding_box()
    places = itertools.cycle((0.5, 0.45, 0.55, 0.4, 0.6))

    def shows_a_pixel() -> bool:
        fraction = next(places)
        page.mouse.move(box["x"] + box["width"] * fraction, box["y"] + box["height"] * fraction)
        page.wait_for_timeout(500)
        return "truth" in surface.text_content()

    page.until(shows_a_pixel)
    assert "pixel" in surface.text_content()


@pytest.mark.slow
def test_keyboard_reaches_links_tables_buttons_and_the_listing(page: Any) -> None:
    reached = set()
    for _ in range(80):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("() => document.activeElement.tagName"))
    assert {"A", "BUTTON", "CANVAS", "DIV", "INPUT", "SELECT", "SUMMARY"} <= reached


@pytest.mark.slow
@pytest.mark.parametrize("width", [360, 800])
def test_narrow_screen_scrolls_tables_not_the_page(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 700})
    drawn_surface(page)
    overflow = page.evaluate("() => document.documentElement.scrollWidth - window.innerWidth")
    assert overflow <= 0
    assert page.said == []


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_says_the_result_first_and_is_readable_in_light_and_dark(
    tab: Any, report: Path, scheme: str
) -> None:
    tab.set_viewport_size({"width": 900, "height": 900})
    tab.emulate_media(color_scheme=scheme)
    tab.goto(report.as_uri())
    headline = tab.locator(".headline")
    assert "predicted" in headline.inner_text()
    assert headline.bounding_box()["y"] < 200
    for selector in ("body", ".headline", ".caption", "a"):
        ratio = tab.evaluate(CONTRAST, selector)
        # WCAG 2.2, level AA for text.
        assert ratio >= 4.5, (selector, ratio)
    assert (tab.evaluate(LUMINANCE, "body") < 0.1) == (scheme == "dark")


LUMINANCE = """(selector) => {
  let node = document.querySelector(selector), paper = "rgba(0, 0, 0, 0)";
  for (; node && paper === "rgba(0, 0, 0, 0)"; node = node.parentElement) {
    paper = getComputedStyle(node).backgroundColor;
  }
  const part = (c) => { c /= 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; };
  const of = (text) => { const [r, g, b] = text.match(/[0-9.]+/g).map(Number);
    return 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b); };
  window.inkOf = (name) => of(getComputedStyle(document.querySelector(name)).color);
  return of(paper);
}"""
CONTRAST = f"""(selector) => {{
  const paper = ({LUMINANCE})(selector), ink = window.inkOf(selector);
  return (Math.max(paper, ink) + 0.05) / (Math.min(paper, ink) + 0.05);
}}"""


@pytest.mark.slow
def test_narrow_screen_says_that_tables_scroll(page: Any) -> None:
    assert page.locator(".hint:visible").count() == 0
    page.set_viewport_size({"width": 360, "height": 700})
    page.until(lambda: page.locator(".hint:visible").count() > 0)
