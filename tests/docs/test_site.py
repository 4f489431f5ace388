"""The site builds with warnings as errors, its links work, and it fetches nothing from outside."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import scenes
from tests.commands import ROOMS, ROOT

DOCS = ROOT / "docs"
# What a browser loads by itself: scripts, styles, pictures, frames; a link that is clicked is not.
LOADED = re.compile(
    r"""<(?:script|img|iframe|source|video)[^>]*\ssrc=["'](?:https?:)?//|"""
    r"""<link[^>]*rel=["'](?:stylesheet|preload|preconnect|icon)["'][^>]*href=["'](?:https?:)?//""",
    re.IGNORECASE,
)
LOADED_BY_STYLE = re.compile(r"""@import\s+["']?(?:https?:)?//|url\(\s*["']?(?:https?:)?//""")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; the build fails on the first kind of warning, dead links included."""
    pytest.importorskip("sphinx", reason="Sphinx is not installed (pip install fringebench[docs])")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, "-d", str(folder / "doctrees"), str(DOCS), str(folder / "html")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "html"


@pytest.mark.slow
def test_scene_reference_lists_keys_of_every_table(site: Path) -> None:
    reference = (site / "scene-reference.html").read_text("utf-8")
    for key in ("height_range_mm", "irradiance_w_m2", "quantum_efficiency", "periods_px"):
        assert key in reference
    assert (site / "scene.schema.json").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("room", ROOMS)
def test_api_page_has_every_public_name(site: Path, room: str) -> None:
    module = __import__(room)
    page = (site / "api" / f"{room}.html").read_text("utf-8")
    missing = [name for name in module.__all__ if name not in ROOMS and name not in page]
    assert not missing


@pytest.mark.slow
def test_front_page_opens_with_a_picture_and_the_table_that_matters(site: Path) -> None:
    page = (site / "index.html").read_text("utf-8")
    picture, table = page.index("front.webp"), page.index("saturation ignored")
    assert picture < table < page.index("three uses")


@pytest.mark.slow
def test_site_fetches_nothing_from_outside(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert not LOADED.search(page.read_text("utf-8")), page.name
    for style in site.rglob("*.css"):
        assert not LOADED_BY_STYLE.search(style.read_text("utf-8")), style.name


def test_gallery_shows_every_scene_in_small_pictures() -> None:
    text = (DOCS / "gallery.md").read_text("utf-8")
    for name in scenes.shipped():
        assert f"## {name}\n" in text
        assert (DOCS / "gallery" / f"{name}.webp").stat().st_size < 100_000


def test_readme_table_is_that_of_the_gallery() -> None:
    gallery = runpy.run_path(str(DOCS / "make_gallery.py"), run_name="make_gallery")
    scores = json.loads((DOCS / "gallery" / "scores.json").read_text("utf-8"))
    assert gallery["front_table"](scores["bench"]) in (ROOT / "README.md").read_text("utf-8")
