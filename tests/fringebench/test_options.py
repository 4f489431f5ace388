"""What every command has in common: an example in its help, scene names completed, progress where work is long."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

import scenes
from fringebench.cli import app
from fringebench.options import fusion_rules, scene_names

LONG = {
    "run", "render", "expose", "decode", "chapter", "compare", "regress", "budget", "dataset", "import", "calibrate",
    "accept", "stereo", "pads",
}  # fmt: skip
CHANCE = {
    "run", "render", "expose", "chapter", "compare", "regress", "budget", "dataset", "calibrate", "accept", "pads",
}  # fmt: skip


def commands() -> Iterator[tuple[str, Any]]:
    group: Any = typer.main.get_command(app)
    yield from group.commands.items()


def test_a_command_has_no_example_or_one_that_cannot_be_parsed() -> None:
    for name, command in commands():
        example = re.sub(r"^Example: fringebench ", "", command.epilog or "")
        assert example.split()[0] == name, f"{name}: {command.epilog}"
        words = example.replace("> mine.toml", "").split()[1:]
        command.make_context(name, words, resilient_parsing=False).close()


def test_a_long_command_cannot_show_progress_or_a_scene_cannot_be_overridden() -> None:
    for name, command in commands():
        options = {word for parameter in command.params for word in parameter.opts}
        if name in LONG:
            assert "--progress" in options, name
        arguments = {p.name for p in command.params if p.param_type_name == "argument"}
        if arguments & {"scene", "rig"}:
            assert "--set" in options, name


def test_a_command_has_no_answer_for_a_program_or_chance_that_no_seed_decides() -> None:
    for name, command in commands():
        options = {word for parameter in command.params for word in parameter.opts}
        assert "--json" in options, name
        if name in CHANCE:
            assert "--seed" in options, name


def test_the_shell_does_not_complete_scenes_files_and_rules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "solo.toml").write_text("")
    (tmp_path / "some").mkdir()
    (tmp_path / "some" / "other.toml").write_text("")
    assert list(scene_names("so")) == ["solder", "solder-grains", "solo.toml", "some/"]
    assert list(scene_names("some/")) == ["some/other.toml"]
    assert set(scene_names("")) >= set(scenes.shipped())
    assert "max-modulation" in fusion_rules("max")
    assert fusion_rules("no such") == []


def test_completion_through_the_shell_s_own_protocol_fails() -> None:
    asked = {
        "_FRINGEBENCH_COMPLETE": "complete_bash",
        "COMP_WORDS": "fringebench run ink",
        "COMP_CWORD": "2",
    }
    code = "from fringebench.cli import app; app(prog_name='fringebench')"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["ink", "ink-solder"]


def test_every_key_of_a_scene_s_first_table_is_explained() -> None:
    properties = scenes.schema()["properties"]
    assert all(value.get("description") for value in properties.values())
