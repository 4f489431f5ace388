"""A run into a folder that holds an earlier one, and mistakes that cost a trace before they are told."""

from collections.abc import Callable
from pathlib import Path

import pytest

import decode
import render
import scenes
from fringebench.budget import budget
from fringebench.run import FILES, run
from scenes.errors import DecodeError, FileError, RenderError

SMALL = {"camera.resolution": [24, 18], "sampling.samples": 2}
# From below the plate the camera sees nothing lit: light is traced, and then no exposure suits it.
DARK = SMALL | {"camera.pose.origin_mm": [0.0, 0.0, -300.0]}
Call = Callable[..., tuple[int, str, str]]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    run(scenes.load("step", SMALL), tmp_path)
    return tmp_path


def test_a_run_that_fails_leaves_its_files_among_an_earlier_runs(earlier: Path) -> None:
    before = contents(earlier)
    assert set(before) == set(FILES)
    with pytest.raises(RenderError, match="is dark"):
        run(scenes.load("bench", DARK | {"exposures.auto.label": "base"}), earlier)
    assert contents(earlier) == before


def test_a_run_that_succeeds_leaves_files_of_the_earlier_one(earlier: Path) -> None:
    before = contents(earlier)
    result = run(scenes.load("cap", SMALL), earlier, seed=1)
    after = contents(earlier)
    assert set(after) == set(before)
    assert not [name for name in FILES if after[name] == before[name]]
    assert result.seconds["write"] > 0.0


def test_a_run_that_fails_in_an_empty_folder_throws_its_light_away(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="is dark"):
        run(scenes.load("step", DARK), tmp_path)
    assert render.Transport.read(tmp_path / "transport.exr").scene.name == "step"
    assert not (tmp_path / "stack.exr").exists()


def test_a_folder_with_files_of_two_runs_is_not_told(
    earlier: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: decode.Reconstruction, path: Path) -> None:
        raise FileError(f"cannot write '{path}': No space left on device")

    monkeypatch.setattr(decode.Reconstruction, "write", full)
    with pytest.raises(FileError, match=r"No space left.*scene\.toml.*stack\.exr.* are this run's"):
        run(scenes.load("cap", SMALL), earlier)


def test_a_misspelt_fusion_rule_is_told_after_the_light_was_traced(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_light(*_: object, **__: object) -> None:
        pytest.fail("light was traced")

    monkeypatch.setattr(render, "trace", no_light)
    status, _, err = call("run", "step", "-o", tmp_path / "out", "--fusion", "max-modulatoin")
    assert (status, "did you mean 'max-modulation'?" in err) == (2, True)
    assert not list(tmp_path.iterdir())
    with pytest.raises(DecodeError, match="did you mean 'max-modulation'"):
        budget(scenes.load("step", SMALL), fusion="max-modulatoin")
