"""An error in a scene file names the line of the key."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import scenes
from scenes.support.errors import SceneError
from scenes.support.toml_lines import line_of

TRICKY = '''\
# a comment with [table] and key = 1
title = """
[camera]
fx_px = 1
"""
camera.lens = { focus_mm = 3.0, rings = [
  1,
  2,
] }
"quoted key" = 1
parts = [ # one a line
  { a = 1 },

  { a = 2 } ]

[[objects]]
label = "a"
[objects.shape]
kind = "box"
[[objects]]
label = "b"
[objects.shape]
kind = "cap"
[[objects.shape.holes]]
radius_mm = 1.0
'''


LINES: dict[tuple[str | int, ...], int | None] = {
    ("title",): 2,
    ("camera",): 6,
    ("camera", "lens", "focus_mm"): 6,
    ("camera", "lens", "rings", 1): 6,
    ("camera", "fx_px"): 6,
    ("quoted key",): 10,
    ("parts",): 11,
    ("parts", 0, "a"): 12,
    ("parts", 1, "a"): 14,
    ("objects",): 16,
    ("objects", 0): 16,
    ("objects", 0, "shape"): 18,
    ("objects", 1, "label"): 21,
    ("objects", 1, "shape", "kind"): 23,
    ("objects", 1, "shape", "holes", 0, "radius_mm"): 25,
    ("objects", 1, "material"): 20,
    ("nothing",): None,
}


def test_line_of_a_key_is_found() -> None:
    assert {location: line_of(TRICKY, location) for location in LINES} == LINES


def _leaves(tree: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _leaves(value, (*at, key))
    elif isinstance(tree, list) and tree and isinstance(tree[0], dict):
        for index, value in enumerate(tree):
            yield from _leaves(value, (*at, index))
    else:
        yield at


def test_every_key_of_the_shipped_scenes_is_found_on_its_line() -> None:
    for name in scenes.shipped():
        text = scenes.source(name)
        lines = text.splitlines()
        for location in _leaves(tomllib.loads(text)):
            line = line_of(text, location)
            assert line is not None, (name, location)
            assert str(location[-1]) in lines[line - 1], (name, location)


def test_errors_name_the_line_of_a_value_that_is_not_overridden(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    wrong = {"steps = 4": "steps = 2", 'label = "ink"': 'labl = "ink"', '"emva1288"': '"emva"'}
    text = scenes.source("bench")
    for right, mistake in wrong.items():
        text = text.replace(right, mistake)
    file.write_text(text)
    lines = text.splitlines()
    expected = (
        ("steps = 2", "patterns.steps"),
        ('labl = "ink"', "unknown key 'objects.3.labl'"),
        ('kind = "emva"', "sensor.kind: there is no 'emva'"),
    )
    with pytest.raises(SceneError) as raised:
        scenes.load(file)
    said = str(raised.value).splitlines()
    for line, message in expected:
        assert any(t.startswith(f"{file}:{lines.index(line) + 1}: {message}") for t in said)
    ink = tomllib.loads(scenes.source("bench"))["objects"][3]
    with pytest.raises(SceneError, match=r"mine\.toml: patterns\.steps"):
        scenes.load(file, {"patterns.steps": 1, "objects.3": ink, "sensor.kind": "emva1288"})


def test_long_statement_is_skipped() -> None:
    assert line_of("a = [\n" + "1,\n" * 100_000 + "]\n[camera]\n", ("camera",)) is None
