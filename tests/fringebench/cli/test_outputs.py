"""Output files never replace an input or each other, and messages name the options of the command."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.table import Table

import decode
from fringebench.cli.terminal import print_figures
from tests.commands import SMALL
from tests.conftest import Call


@pytest.fixture
def folder(small_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(small_run, tmp_path / "run")
    monkeypatch.chdir(tmp_path / "run")
    return tmp_path / "run"


@pytest.mark.parametrize("words", [["-o", ""], ["--output", ""], ["--output="]], ids=" ".join)
def test_empty_output_is_refused_and_not_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call, words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for command in (["run", "cap", *SMALL], ["dataset", "spi"], ["chapter"]):
        status, _, err = call(*command, *words)
        assert (status, "output (-o) is empty" in err) == (2, True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        ["expose", "transport.exr", "-o", "transport.exr"],
        ["decode", "stack.exr", "-o", "stack.exr"],
        ["decode", "stack.exr", "-o", "./../run/stack.exr"],
        ["decode", "stack.exr", "-o", "link.exr"],
        ["evaluate", "reconstruction.exr", "truth.exr", "-o", "truth.exr"],
        ["view", "truth.exr", "-o", "truth.exr"],
        ["convert", "reconstruction.exr", "-o", "reconstruction.exr"],
        ["render", "scene.toml", "-o", "scene.toml", *SMALL],
        ["twin", "scene.toml", "-o", "scene.toml", "--distance-mm", "300"],
    ],
    ids=" ".join,
)
def test_output_that_is_an_input_is_refused(folder: Path, call: Call, words: list[str]) -> None:
    (folder / "link.exr").symlink_to("stack.exr")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    status, _, err = call(*words)
    assert status == 2
    assert "is also an input" in err
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_two_outputs_of_one_name_are_refused(folder: Path, call: Call) -> None:
    status, _, err = call("render", "step", "-o", "t.exr", "--truth", "./t.exr", *SMALL)
    assert (status, "-o and --truth are both" in err) == (2, True)
    assert not (folder / "t.exr").exists()


def test_output_with_the_name_of_a_shipped_scene_is_written(folder: Path, call: Call) -> None:
    assert call("render", "step", "-o", "step", *SMALL)[0] == 0
    assert (folder / "step").is_file()


def test_version_is_printed(call: Call) -> None:
    import fringebench

    assert call("--version")[:2] == (0, f"fringebench {fringebench.__version__}\n")


def test_figures_are_never_cut_short(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table("strategy", *(f"figure {i}" for i in range(8)))
    for i in range(1, 9):
        table.columns[i].no_wrap = True
    table.add_row("a", *["-1234.567 ±0.001"] * 8)
    print_figures([table])
    out = capsys.readouterr().out
    assert out.count("-1234.567 ±0.001") == 8
    assert "…" not in out


def test_scores_of_large_errors_are_never_cut_short(folder: Path, call: Call) -> None:
    right = decode.Reconstruction.read("reconstruction.exr")
    replace(right, height_mm=right.height_mm + np.float32(12345.0)).write("far.exr")
    status, out, _ = call("evaluate", "far.exr", "truth.exr")
    assert status == 0
    assert "12345" in out
    assert "…" not in out
