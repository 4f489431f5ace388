"""What every command has in common: an example in its help, scene names completed, progress where work is long."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

import scenes
from fringebench.cli.app import app
from fringebench.cli.shared_options import fusion_rules, scene_names

LONG = {
    "run", "render", "expose", "decode", "chapter", "compare", "strategies", "methods", "regress", "budget", "dataset", "import", "calibrate",
    "accept", "stereo", "pads",
}  # fmt: skip
CHANCE = {
    "run", "render", "expose", "chapter", "compare", "strategies", "methods", "regress", "budget", "dataset", "calibrate", "accept", "pads",
}  # fmt: skip


def commands() -> Iterator[tuple[str, Any]]:
    group: Any = typer.main.get_command(app)
    yield from group.commands.items()


def test_every_command_has_an_example_that_parses() -> None:
    for name, command in commands():
        example = re.sub(r"^Example: fringebench ", "", command.epilog or "")
        assert example.split()[0] == name, f"{name}: {command.epilog}"
        words = example.replace("> mine.toml", "").split()[1:]
        command.make_context(name, words, resilient_parsing=False).close()


def test_help_at_80_columns_cuts_no_word() -> None:
    size = {"COLUMNS": "80", "TERMINAL_WIDTH": "80"}
    for name, _ in commands():
        shown = CliRunner().invoke(app, [name, "--help"], env=size).output
        assert "…" not in shown, name
        assert max(map(len, shown.splitlines())) <= 80


def test_commands_have_the_options_that_all_of_their_kind_have() -> None:
    for name, command in commands():
        options = {word for parameter in command.params for word in parameter.opts}
        arguments = {p.name for p in command.params if p.param_type_name == "argument"}
        assert "--json" in options, name
        assert "--progress" in options or name not in LONG, name
        assert "--seed" in options or name not in CHANCE, name
        assert "--set" in options or not arguments & {"scene", "rig"}, name


def test_shell_completes_scenes_files_and_rules(
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


def test_completion_works_through_the_protocol_of_the_shell(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_FRINGEBENCH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "fringebench run ink")
    monkeypatch.setenv("COMP_CWORD", "2")
    with pytest.raises(SystemExit):
        app(prog_name="fringebench")
    assert capsys.readouterr().out.split() == ["ink", "ink-solder"]


def test_every_top_level_key_of_a_scene_has_a_description() -> None:
    properties = scenes.schema()["properties"]
    assert all(value.get("description") for value in properties.values())
