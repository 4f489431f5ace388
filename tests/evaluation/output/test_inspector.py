"""The pixel inspector: what it holds of a pixel, and that a browser shows it by mouse and keyboard."""

import base64
import gzip
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import decode
import scenes
from evaluation.output.inspector import MAX_BYTES, Inspector, inspector_of
from evaluation.output.report import Report, Section
from evaluation.output.scene_pictures import reason_map

SIZE = (12, 16)


def stack_of(size: tuple[int, int] = SIZE, exposures: int = 2) -> scenes.Stack:
    """Fringes of 16 px seen one to one, the longer exposures clipped."""
    shown = scenes.PhaseShift(steps=4, periods_px=(16.0,)).frames()
    column = np.broadcast_to(np.arange(size[1]) + 0.5, size)
    frames = np.array(
        [
            [np.minimum(40 + 120 * (e + 1) * f.commanded(column), 255) for f in shown]
            for e in range(exposures)
        ]
    )
    times = tuple(2.0**e for e in range(exposures))
    sensor = scenes.SimpleSensor(bits=8)
    return scenes.Stack(
        frames.round().astype(np.uint8), shown, times, sensor, projector_resolution=(16, 12)
    )


def unpacked(text: str, dtype: str) -> Any:
    return np.frombuffer(gzip.decompress(base64.b64decode(text)), dtype)


def test_inspector_holds_every_sample_and_result_of_its_pixels() -> None:
    stack = stack_of()
    rec = decode.reconstruct(stack, height="phase")
    shown = json.loads(inspector_of(stack, rec).to_json())
    samples = unpacked(shown["samples"], "<u2").reshape(*SIZE, 2, 4)
    np.testing.assert_array_equal(samples, np.moveaxis(stack.frames, (0, 1), (2, 3)))
    order = {value["title"]: value["data"] for value in shown["values"]}["fringe order"]
    np.testing.assert_array_equal(unpacked(order, "<f4").reshape(SIZE), rec.fringe_order)


def test_reasons_have_the_colours_of_the_picture_beside_it() -> None:
    stack = stack_of(exposures=1)
    rec = decode.reconstruct(stack, height="phase")
    reason = np.resize(np.array([0, 3, 13, 12], np.uint8), SIZE)
    rec = replace(rec, reason=reason)
    shown = json.loads(inspector_of(stack, rec).to_json())["maps"][-1]["image"]
    png = base64.b64decode(shown.partition(",")[2])
    image = reason_map(rec).axes[0].images[0]
    drawn = image.to_rgba(np.asarray(image.get_array()), bytes=True)[..., :3]
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(png))), drawn)


def test_large_stack_is_thinned_but_keeps_listed_pixels() -> None:
    stack = stack_of((600, 900))
    inspector = Inspector((), stack, listed={"here": (599, 1)})
    shown = json.loads(inspector.to_json())
    samples = unpacked(shown["samples"], "<u2").reshape(-1, 2, 4)
    assert samples[:-1].size <= MAX_BYTES
    np.testing.assert_array_equal(samples[-1], stack.frames[..., 599, 1])
    first, stride, _, across = shown["grid"]
    assert stride > 1
    np.testing.assert_array_equal(
        samples[across + 2], stack.frames[..., first + stride, first + 2 * stride]
    )


@pytest.mark.slow
def test_pixel_is_chosen_by_mouse_and_by_keyboard(tab: Any, tmp_path: Path) -> None:
    stack = stack_of()
    rec = decode.reconstruct(stack, height="phase")
    page = tmp_path / "page.html"
    Report("Pixels", "", [Section("Pixels", [inspector_of(stack, rec)])]).write(page)
    tab.set_viewport_size({"width": 1000, "height": 900})
    tab.emulate_media(color_scheme="dark")
    tab.goto(page.as_uri())
    table = "document.querySelector('.pixel table')"

    def shows(pixel: str) -> None:
        tab.wait_for_function(f"() => {table}.innerText.includes('{pixel}')")

    shows("(8, 6)")
    cursors = "() => [...document.querySelectorAll('canvas')].map((map) => map.toDataURL())"
    before = tab.evaluate(cursors)
    # Height, first frame, reasons.
    assert len(before) == 3
    canvas = tab.locator("canvas").first
    box = canvas.bounding_box()
    canvas.click(position={"x": box["width"] * 2.5 / 16, "y": box["height"] * 3.5 / 12})
    shows("(2, 3)")
    # The cursors of all maps follow.
    assert all(new != old for new, old in zip(tab.evaluate(cursors), before, strict=True))
    # The click gave the map the keyboard.
    assert tab.evaluate("() => document.activeElement.tagName") == "CANVAS"
    canvas.press("ArrowRight")
    canvas.press("ArrowDown")
    shows("(3, 4)")
    tab.locator("summary").click()
    cells = tab.locator(".numbers tbody td").all_inner_texts()
    wanted = [int(v) for v in stack.frames[:, :, 4, 3].T.ravel()]
    assert [int(cell.split()[0]) for cell in cells] == wanted
    saturated = [value >= stack.saturation_dn for value in wanted]
    assert [cell.endswith("saturated") for cell in cells] == saturated
    assert any(saturated)
    tab.locator(".samples").scroll_into_view_if_needed()
    tab.wait_for_selector(".samples .scatterlayer .trace", state="attached")
    # The fitted sinusoid passes through samples without noise, clipped ones left out.
    worst = tab.evaluate(
        """() => { const all = document.querySelector('.samples').data; const [dots, line] = all.slice(0, 2);
        return Math.max(...dots.x.map((x, i) => Math.abs(line.y[line.x.indexOf(x)] - dots.y[i]))); }"""
    )
    assert worst < 1.0
    assert tab.said == []
