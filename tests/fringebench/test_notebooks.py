"""Results show themselves: a short repr, an HTML view for notebooks, and a figure."""

import base64
import io
import re
from typing import Any

import numpy as np
import pytest
from PIL import Image

import fringebench as fb


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    scene = fb.load("bench", {"camera.resolution": [48, 36], "sampling.samples": 2})
    light = fb.trace(scene)
    truth = fb.render.truth(scene, light)
    stack = fb.expose(light)
    rec = fb.reconstruct(stack)
    return {
        "Transport": light, "Truth": truth, "Stack": stack, "Reconstruction": rec, "Score": fb.score(rec, truth)
    }  # fmt: skip


NAMES = ("Transport", "Truth", "Stack", "Reconstruction", "Score")


@pytest.mark.parametrize("name", NAMES)
def test_repr_is_one_short_line(results: dict[str, Any], name: str) -> None:
    text = repr(results[name])
    assert text.startswith(f"<{name}: ")
    assert len(text) < 400
    assert "\n" not in text
    assert "array(" not in text


@pytest.mark.parametrize("name", NAMES)
def test_html_has_facts_and_the_picture_that_plot_draws(results: dict[str, Any], name: str) -> None:
    assert results[name].plot().axes
    html = results[name]._repr_html_()
    assert html.startswith(f"<b>{name}</b>")
    data = re.search(r"data:image/png;base64,([^']+)'", html)
    assert data
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(data[1]))).convert("L"))
    assert len(np.unique(picture)) > 20
    assert len(html) < 500_000


def test_labels_are_shown_by_name(results: dict[str, Any]) -> None:
    truth = results["Truth"]
    shown = [text.get_text() for axes in truth.plot().axes for text in axes.get_yticklabels()]
    assert set(truth.labels) <= set(shown)


def test_text_in_html_is_escaped(results: dict[str, Any]) -> None:
    from dataclasses import replace

    score = replace(results["Score"], scene="<script>")
    assert "<script>" not in score._repr_html_()
