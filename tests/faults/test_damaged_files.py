"""Damaged files of every kind that is read: only a `FringebenchError` comes out, never a crash, a hang or a warning.

`fuzz_readers.py` searches for more, guided by coverage; what it and these tests found is kept below as cases.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import scenes
from scenes.files import capture, exr, images
from scenes.rig.opencv_calibration import Source
from scenes.support.errors import FileError, FringebenchError, MeshError, SceneError
from tests.faults.damage import damage_with_seed
from tests.faults.targets import GERBER, RIG, TARGETS, Target

EXAMPLES = settings(
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def survives(target: Target, folder: Path, content: bytes) -> bool:
    """Whether a file is read; an exception other than `FringebenchError` fails the test."""
    path = folder / f"damaged{target.suffix}"
    path.write_bytes(content)
    try:
        target.read(path)
    except FringebenchError as error:
        assert str(error)
        return False
    return True


@pytest.mark.parametrize("name", TARGETS)
def test_undamaged_files_are_read(name: str, tmp_path: Path) -> None:
    # Otherwise the tests below would pass if every file were refused.
    target = TARGETS[name]
    for whole in target.seeds():
        assert survives(target, tmp_path, whole)


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_file_gives_a_project_error(name: str, tmp_path: Path) -> None:
    _damage(name, tmp_path, 30)


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_heavily_damaged_file_gives_a_project_error(name: str, tmp_path: Path) -> None:
    _damage(name, tmp_path, 200)


def _damage(name: str, folder: Path, examples: int) -> None:
    target = TARGETS[name]
    seeds = target.seeds()

    @settings(EXAMPLES, max_examples=examples)
    @given(seed=st.integers(0, 2**32), which=st.integers(0, len(seeds) - 1))
    def one(seed: int, which: int) -> None:
        survives(target, folder, damage_with_seed(seeds[which], seed))

    one()


DEEP = "[" * 3000
DIGITS = "9" * 5000


@pytest.mark.parametrize("value", [DEEP, DIGITS], ids=["deep", "digits"])
def test_text_the_parser_refuses_gives_a_project_error(value: str, tmp_path: Path) -> None:
    for name in ("scene", "manifest", "plan"):
        assert not survives(TARGETS[name], tmp_path, f"a = {value}".encode()), name
    headers = ("stack-header", "truth-header", "transport-header", "reconstruction-header")
    for name in ("baseline", "calibration-json", *headers):
        assert not survives(TARGETS[name], tmp_path, f'{{"a": {value}}}'.encode()), name


def test_scene_whose_objects_are_no_list_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("objects = 5")
    with pytest.raises(SceneError, match="objects"):
        scenes.load(path)


def test_thousand_errors_are_summarised_in_a_few_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text(scenes.source("step") + "[[objects]]\nlabel = 1\n" * 1000)
    with pytest.raises(SceneError, match=r"and [0-9]+ more errors") as failure:
        scenes.load(path)
    assert len(str(failure.value).splitlines()) <= 11


# OpenCV 5.0 writes beyond the matrix if its size is not that of its data, and the process aborts.
@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_opencv_matrix_with_a_wrong_size_is_refused(suffix: str, tmp_path: Path) -> None:
    (undamaged,) = TARGETS["calibration-yaml" if suffix == ".yml" else "calibration-xml"].seeds()
    text = undamaged.decode()
    key = "cols: 3" if suffix == ".yml" else "<cols>3</cols>"
    assert key in text
    path = tmp_path / f"rig{suffix}"
    wrong_sizes = [key.replace("3", size) for size in ("18446744073709551616", "-3", "2", "3e9")]
    for wrong in (key.replace("cols", "colz"), *wrong_sizes):
        path.write_text(text.replace(key, wrong, 1))
        with pytest.raises(FileError, match=r"rig\."):
            Source(files=(path,)).calibration((12, 9), (64, 48))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"cam_K": [[1, 2], [3]]}, "first_matrix is no list of numbers"),
        ({"cam_kc": ""}, "first_distortion is no list of numbers"),
        ({"R": [[1e300] * 3] * 3}, "is no rotation"),
        ({"R": [["a"] * 3] * 3}, "rotation is no list of numbers"),
        ({"T": [1e50, 0, 0]}, "keep them within"),
        ({"T": [1e999, 0, 0]}, "NaN or infinite"),
        ({"T": None}, "translation is no list"),
        ({"cam_K": [[80, 0, 6], [0, 0, 4.5], [0, 0, 1]]}, "focal lengths"),
        ({"projector_size": [1e999, 4]}, "NaN or infinite"),
    ],
)
def test_impossible_numbers_of_a_calibration_are_named(
    change: dict[str, object], says: str, tmp_path: Path
) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(RIG | change))
    with pytest.raises(FileError, match=says):
        Source(files=(path,), distance_mm=100.0).calibration((12, 9), (64, 48))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        # GEOS crashes the process on an infinite width.
        ("ADD13O,0.4X1.1", "ADD13O,0.4X1e999", "length of (inf|nan)"),
        ("ADD10C,0.5", "ADD10C,1e300", "length of"),
        ("X1000000Y1000000D03", f"X{'9' * 60}Y0D03", "length of"),
        ("G36*\nX5000000Y3000000D02*\nX6000000Y3000000D01*\nX6000000Y4000000D01*\nX5000000Y4000000D01*",
         "G36*\nX5000000Y3000000D02*", "cannot be"),
    ],
    ids=["infinite", "huge-circle", "far", "point"],
)  # fmt: skip
def test_impossible_gerber_shapes_are_named(old: str, new: str, says: str, tmp_path: Path) -> None:
    assert old in GERBER
    path = tmp_path / "paste.gbr"
    path.write_text(GERBER.replace(old, new, 1))
    with pytest.raises(FileError, match=says):
        TARGETS["gerber"].read(path)


PLY = """\
ply
format ascii 1.0
element vertex {count}
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
{third}
{face}
"""


@pytest.mark.parametrize(
    ("count", "third", "face", "says"),
    [
        (3, "0 1 0", "3 0 1 7", "corners that do not exist"),
        (3, "0 1 0", "3 0 1 -5", "corners that do not exist"),
        (3, "0 nan 0", "3 0 1 2", "NaN or infinite"),
        (3, "0 1e30 0", "3 0 1 2", "reaches to 1e\\+30"),
        (3, "2 0 0", "3 0 1 2", "zero area"),
        (10**12, "0 1 0", "3 0 1 2", "no triangles|cannot be read"),
    ],
    ids=["beyond", "negative", "nan", "far", "flat", "claims-a-trillion"],
)
def test_impossible_meshes_are_named(
    count: int, third: str, face: str, says: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.ply"
    path.write_text(PLY.format(count=count, third=third, face=face))
    with pytest.raises(MeshError, match=says):
        TARGETS["mesh-ply"].read(path)


@pytest.mark.parametrize(
    ("kind", "channel"),
    [("truth", "label"), ("transport", "label"), ("reconstruction", "reason"), ("reconstruction", "exposure")],
)  # fmt: skip
def test_invalid_codes_are_refused(kind: str, channel: str, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    path.write_bytes(TARGETS[kind].seeds()[0])
    channels, meta = exr.read(path, kind)
    meta = {key: value for key, value in meta.items() if key not in ("format", "version")}
    for value in (np.nan, np.inf, -1.0, 0.5, 1e9):
        wrong = channels[channel].astype(np.float32)
        wrong[0, 0] = value
        exr.write(path, kind, channels | {channel: wrong}, meta)
        with pytest.raises(FileError, match="damaged"):
            TARGETS[kind].read(path)


LONG = "a" * 5000


READERS: dict[str, Callable[[Path], object]] = {
    kind: TARGETS[kind].read
    for kind in (
        *("stack", "truth", "transport", "reconstruction"),
        *("gerber", "calibration-yaml", "mesh-ply", "baseline"),
    )
} | {"scene": scenes.load, "capture": capture.Capture.load, "kind": exr.kind_of}


@pytest.mark.parametrize("reader", READERS)
def test_invalid_file_names_are_refused(reader: str) -> None:
    for name in (LONG, f"{LONG}/b", "a\0b", "a\udcffb", "\ud800"):
        with pytest.raises(FringebenchError):
            READERS[reader](Path(name))


def test_invalid_file_patterns_are_refused(tmp_path: Path) -> None:
    for pattern in ("/etc/*.png", "", "\0", "**x", LONG):
        with pytest.raises(FileError):
            images.find(tmp_path, [pattern])
