"""What tests of every room share."""

import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import fringebench
from fringebench.cli.app import main
from tests.commands import Done

Call = Callable[..., Done]


@pytest.fixture(scope="session")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of `step` with 24 x 18 pixels, for all tests: copy it before you change it."""
    folder = tmp_path_factory.mktemp("run")
    size = {"camera.resolution": [24, 18], "sampling.samples": 2}
    fringebench.run(fringebench.load("step", size), folder)
    return folder


CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
# A page that takes longer hangs. It is no limit of speed: a loaded machine draws 3-D views in software.
PAGE_TIMEOUT_MS = 300_000
# No sandbox (CI runs as root), software WebGL, and none of the browser's own traffic.
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-quic",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
]


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Run the command line in this process."""

    def run(*words: object) -> Done:
        monkeypatch.setattr(sys, "argv", ["fringebench", *map(str, words)])
        try:
            main()
            status = 0
        except SystemExit as leaving:
            status = int(leaving.code or 0)
        return Done(status, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A real browser for the pages, where there is one: headless Chromium under Playwright."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=CHROMIUM, args=FLAGS, timeout=PAGE_TIMEOUT_MS
        )
        yield chromium
        chromium.close()


@pytest.fixture
def tab(browser: Any) -> Iterator[Any]:
    """An empty page; errors in it and requests to the network are collected in `said`.

    `page.until(holds)` waits until something holds, however slow the machine is.
    """
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(PAGE_TIMEOUT_MS)
    page.said = []
    page.on("console", lambda m: page.said.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda e: page.said.append(str(e)))
    page.on("request", lambda r: page.said.append(r.url) if r.url.startswith("http") else None)
    page.until = lambda holds: wait_until(page, holds)
    yield page
    page.close()


def wait_until(page: Any, holds: Callable[[], bool]) -> None:
    """Ask again and again, while the page goes on."""
    for _ in range(PAGE_TIMEOUT_MS // 200):
        if holds():
            return
        page.wait_for_timeout(200)
    raise AssertionError(f"still not so after {PAGE_TIMEOUT_MS / 1000:.0f} s")
