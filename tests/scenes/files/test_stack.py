"""A stack file gives back every count, and everything a decoder may know, or a `FileError`."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

import scenes
from scenes.acquisition.sensor import Emva, SimpleSensor
from scenes.files import exr
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError, FileError

SCENE = scenes.load("step", {"camera.resolution": [20, 15]})
FRINGE = scenes.PhaseShift(periods_px=(16.0,)).frames()[0]


def stack(frames: np.ndarray, sensor: Any = None, **changes: Any) -> Stack:
    """A stack of those frames, as if of the step scene with as many steps."""
    shown = scenes.PhaseShift(steps=frames.shape[1], periods_px=(16.0,)).frames()
    times = tuple(0.1 + 0.7 * e for e in range(frames.shape[0]))
    made = Stack(
        frames,
        shown,
        times,
        sensor or SimpleSensor(),
        SCENE.calibration(),
        scenes.dumps(SCENE),
        seed=2**53 + 1,
    )
    return replace(made, **changes)


def counts(bits: int, dtype: Any) -> np.ndarray:
    """Every count of so many bits, in 2 exposures of 4 frames."""
    values = np.arange(max(2**bits, 1024)).astype(np.uint64).reshape(2, 4, -1, 16)
    return np.asarray(values % 2**bits)


@pytest.mark.parametrize(
    ("bits", "dtype"), [(8, np.uint8), (11, np.uint16), (12, np.uint16), (16, np.uint16)]
)
def test_every_count_survives_exactly(tmp_path: Path, bits: int, dtype: Any) -> None:
    frames = counts(bits, dtype).astype(dtype)
    stack(frames).write(tmp_path / "s.exr")
    back = Stack.read(tmp_path / "s.exr")
    assert back.frames.dtype == dtype
    assert np.array_equal(back.frames, frames)


def test_counts_around_the_limit_of_half_survive(tmp_path: Path) -> None:
    for top in (2048, 2049):
        frames = np.full((1, 3, 4, 5), top, np.uint16)
        stack(frames).write(tmp_path / "s.exr")
        assert np.array_equal(Stack.read(tmp_path / "s.exr").frames, frames)


def test_floats_survive_bit_by_bit(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).normal(100, 50, (2, 4, 6, 7)).astype(np.float32)
    frames[0, 0, 0, :3] = np.nan, np.inf, -1e-42
    stack(frames, SimpleSensor(bits=0)).write(tmp_path / "s.exr")
    assert Stack.read(tmp_path / "s.exr").frames.tobytes() == frames.tobytes()


EMPTY = np.zeros((1, 3, 5, 6), np.uint8)
SHOWN = scenes.PhaseShift(steps=3, periods_px=(16.0,)).frames()
MIXED = scenes.parse(
    scenes.dumps(SCENE), {"patterns.gray": {"bits": 3, "flat": True}}
).patterns.frames(2)
KNOWN = {
    "simple sensor": stack(EMPTY, SimpleSensor(sigma_dn=1.5)),
    "three exposures": stack(np.zeros((3, 4, 5, 6), np.uint16), Emva(prnu=0.01, bits=10)),
    "bare": stack(EMPTY, calibration=None, scene="", seed=None),
    "mixed patterns": stack(np.zeros((1, len(MIXED), 5, 6), np.uint8), patterns=MIXED),
    "size": Stack(EMPTY, SHOWN, (1.0,), SimpleSensor(), projector_resolution=(1920, 1080)),
}


@pytest.mark.parametrize("made", KNOWN.values(), ids=KNOWN)
def test_every_field_survives_the_file(tmp_path: Path, made: Stack) -> None:
    made.write(tmp_path / "s.exr")
    back = Stack.read(tmp_path / "s.exr")
    for field in ("patterns", "exposure_ms", "sensor", "calibration", "scene", "seed"):
        assert getattr(back, field) == getattr(made, field), field
    assert back.resolution == (6, 5)
    assert back.projector_size() == made.projector_size()
    if made.scene:
        assert scenes.parse(back.scene) == SCENE


def test_over_100_exposures_and_1000_frames_keep_their_order(tmp_path: Path) -> None:
    for shape in ((101, 3, 1, 2), (1, 1001, 1, 2)):
        frames = np.arange(np.prod(shape)).reshape(shape).astype(np.uint16)
        shown = SCENE.patterns.frames()[:1] * shape[1]
        times = tuple(1.0 + e for e in range(shape[0]))
        Stack(frames, shown, times, SimpleSensor()).write(tmp_path / "s.exr")
        assert np.array_equal(Stack.read(tmp_path / "s.exr").frames, frames)


def test_other_programs_find_one_channel_a_frame(tmp_path: Path) -> None:
    frames = counts(8, np.uint8).astype(np.uint8)
    stack(frames).write(tmp_path / "s.exr")
    file = OpenEXR.File(str(tmp_path / "s.exr"), separate_channels=True)
    channels = file.channels()
    assert sorted(channels) == [f"E{e:02d}.F{f:03d}" for e in range(2) for f in range(4)]
    assert np.array_equal(channels["E01.F002"].pixels, frames[1, 2])
    assert file.header()["expTime"] == pytest.approx(1e-4)


@pytest.mark.parametrize(
    ("frames", "says"),
    [
        (np.zeros((1, 3, 4, 5), np.int32), "int32"),
        (np.zeros((1, 3, 4, 5), np.float64), "float64"),
        (np.zeros((3, 4, 5), np.uint8), "shape"),
        (np.zeros((1, 3, 0, 5), np.uint8), "none of them 0"),
        (np.zeros((2, 3, 4, 5), np.uint8), "1 exposure times"),
        (np.zeros((1, 4, 4, 5), np.uint8), "3 patterns"),
    ],
)
def test_invalid_frames_are_refused(frames: np.ndarray, says: str) -> None:
    with pytest.raises(DecodeError, match=says.replace("1 exposure", "1\\s+exposure")):
        Stack(frames, SHOWN, (1.0,), SimpleSensor())


@pytest.mark.parametrize("time_ms", [0.0, -1.0, float("nan"), float("inf")])
def test_invalid_exposure_times_are_refused(time_ms: float) -> None:
    with pytest.raises(DecodeError, match="must be finite and more than 0"):
        Stack(np.zeros((1, 3, 4, 5), np.uint8), SHOWN, (time_ms,), SimpleSensor())


def rewritten(path: Path, **changes: Any) -> None:
    """The stack at `path` with some header entries changed; None removes one."""
    channels, meta = exr.read(path, "stack")
    meta = {k: v for k, v in (meta | changes).items() if v is not None or k not in changes}
    del meta["format"], meta["version"]
    exr.write(path, "stack", channels, meta)


@pytest.mark.parametrize(
    "changes",
    [
        {"patterns": None},
        {"patterns": []},
        {"patterns": [{"axis": "diagonal"}]},
        {"patterns": [{**asdict(FRINGE), "phase_shift_rad": float("nan")}] * 4},
        {"exposure_ms": [1.0]},
        {"exposure_ms": [1.0, "long"]},
        {"exposure_ms": [1.0, 2.0, 3.0]},
        {"sensor": {"kind": "retina"}},
        {"calibration": {"camera": 3}},
        {"dtype": "uint3"},
        {"dtype": "float64"},
        {"dtype": "object"},
        {"dtype": 5},
    ],
    ids=json.dumps,
)
def test_damaged_header_is_a_file_error(tmp_path: Path, changes: dict[str, Any]) -> None:
    path = tmp_path / "s.exr"
    stack(np.zeros((2, 4, 5, 6), np.uint16)).write(path)
    rewritten(path, **changes)
    with pytest.raises(FileError, match="stack header or channels are damaged") as refused:
        Stack.read(path)
    # in the project's words: pydantic's name the Python type and a page on the web
    assert "errors.pydantic.dev" not in str(refused.value)


@pytest.mark.parametrize("value", [300.0, 7.5, -1.0, np.nan])
def test_values_that_are_not_counts_are_a_file_error(tmp_path: Path, value: float) -> None:
    path = tmp_path / "s.exr"
    stack(np.full((1, 3, 5, 6), value, np.float32)).write(path)
    rewritten(path, dtype="uint8")
    with pytest.raises(FileError, match="damaged"):
        Stack.read(path)


@pytest.mark.parametrize(("dtype", "value"), [("float32", 7.5), ("uint16", 2050.0)])
def test_frames_that_another_program_rounded_to_half_are_a_file_error(
    tmp_path: Path, dtype: str, value: float
) -> None:
    """2049 becomes 2048 and 2051 becomes 2052: whole numbers above 2048 say that bits were lost."""
    path = tmp_path / "s.exr"
    stack(np.full((1, 3, 5, 6), value).astype(dtype), SimpleSensor(bits=0)).write(path)
    channels, meta = exr.read(path, "stack")
    del meta["format"], meta["version"]
    exr.write(path, "stack", {name: c.astype(np.float16) for name, c in channels.items()}, meta)
    with pytest.raises(FileError, match=f"half floats, which do not hold {dtype} exactly"):
        Stack.read(path)


def test_missing_frame_is_a_file_error(tmp_path: Path) -> None:
    path = tmp_path / "s.exr"
    stack(np.zeros((2, 4, 5, 6), np.uint16)).write(path)
    channels, meta = exr.read(path, "stack")
    del channels["E01.F003"], meta["format"], meta["version"]
    exr.write(path, "stack", channels, meta)
    with pytest.raises(FileError, match=r"E01\.F003"):
        Stack.read(path)
