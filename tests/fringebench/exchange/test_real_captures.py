"""Real captures through `fringebench import` and the decoders, against other people's results."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import ndimage
from scipy.spatial import cKDTree

import decode
from decode import Reason
from decode.phase.gamma import estimate
from scenes.acquisition.patterns import Axis
from scenes.files.capture import Capture
from scenes.rig.opencv_calibration import Source
from tests.conftest import Call
from tests.fringebench.real_captures import SHELL, captures, display_manifest, shell_manifest


@pytest.mark.slow
def test_shell_agrees_with_its_authors_cloud(tmp_path: Path) -> None:
    stack = Capture.load(shell_manifest(tmp_path)).stack()
    rec = decode.reconstruct(stack)
    theirs = np.asarray(trimesh.load(captures(SHELL) / "scan_0020_cloud.ply").vertices)
    # His program leaves out dim pixels, so the two are compared where he has points, in his camera's pixels.
    assert stack.calibration is not None
    camera = stack.calibration.camera.projection()
    columns, rows = np.floor(camera.project(theirs)[0]).astype(int).T
    seen = np.zeros(rec.valid.shape, dtype=bool)
    seen[rows, columns] = True
    # The points of his that we leave out have two or more undecidable bits.
    assert np.mean(rec.valid[seen]) > 0.998
    # Nine times his coverage. Noise is measured in lit pixels, 0.85 DN; the unlit ones, which JPEG makes quiet, gave 0.77
    # and let a tenth more dim pixels pass.
    assert rec.valid.sum() > 8 * len(theirs)
    object_only = ndimage.label(ndimage.binary_dilation(seen, iterations=2))[0]
    shell = object_only == 1 + np.argmax(np.bincount(object_only[object_only > 0])[1:])
    ours = rec.xyz_mm[rec.valid & shell].astype(float)
    extent = float(np.ptp(ours, axis=0).max())
    assert 100.0 < extent < 400.0
    # One projector pixel is 1.4 mm of depth here; his cells are one wide, ours two where the finest bit is blurred away
    # (a tenth of the contrast on most of the shell), so that the two differ by half of one
    distance = cKDTree(theirs).query(ours[::5])[0]
    assert np.median(distance) < 0.005 * extent
    assert np.median(distance) < 0.5 * 1.4
    # Coverage: wherever he has a point, we have one within a projector pixel.
    back = cKDTree(rec.xyz_mm[rec.valid].astype(float)).query(theirs)[0]
    assert np.mean(back < 1.4) > 0.999
    # His projector pixel, its centre at +0.5 here, is in our cell: the half pixels of the conventions are right.
    column = stack.calibration.projectors[0].projection().project(theirs)[0][:, 0]
    valid = rec.valid[rows, columns]
    assert rec.column_px is not None
    off = (rec.column_px[rows, columns] - column)[valid]
    assert np.median(np.abs(off)) < 0.6
    assert (np.abs(off) < 1.1).mean() > 0.9


@pytest.mark.slow
def test_display_gives_a_dense_map_without_order_errors(tmp_path: Path) -> None:
    stack = Capture.load(display_manifest(tmp_path)).stack()
    sizes: dict[Axis, int] = {"column": 1920, "row": 1080}
    for axis, size in sizes.items():
        rec = decode.reconstruct(stack, height="phase", axis=axis, gamma="estimate")
        # Two thirds of the median modulation: the object and the wall without the dim cloth.
        good = rec.modulation_dn > 20.0
        assert good.mean() > 0.35
        # Fringe periods and Gray code disagree.
        assert (rec.reason[good] == Reason.ORDER_MISMATCH).mean() < 1e-3
        assert rec.valid[good].mean() > 0.999
        # Of those that agree, none is a fringe away from its neighbours.
        at = rec.phases[axis].coordinate_px
        inside = ndimage.binary_erosion(rec.valid & good, np.ones((5, 5), np.bool_))
        middle = ndimage.median_filter(np.where(rec.valid, at, 0.0), 5)
        assert (np.abs(at - middle)[inside] > 33.0).mean() < 1e-5
        assert np.percentile(at[good & rec.valid], 0.1) > -1.0
        assert np.percentile(at[good & rec.valid], 99.9) < size + 1.0


def test_gamma_of_the_display_is_estimated(tmp_path: Path) -> None:
    stack = Capture.load(display_manifest(tmp_path)).stack()
    # Four independent fringe sets agree on it.
    assert estimate(stack) == pytest.approx(2.45, abs=0.1)


PATTERNS = [f"pat{i:02d}.png" for i in range(32)]


def exchanged(i: int, j: int) -> Callable[[Path], Path]:
    """The display's manifest with two of its images exchanged."""
    files = PATTERNS.copy()
    files[i], files[j] = files[j], files[i]
    return lambda folder: display_manifest(folder, files=files)


def shell_exchanged(i: int, j: int) -> Callable[[Path], Path]:
    def made(folder: Path) -> Path:
        files = sorted(path.name for path in (captures(SHELL) / "scan_0020").glob("*.jpg"))
        files[i], files[j] = files[j], files[i]
        return shell_manifest(folder, files=files)

    return made


def fringes(key: str, value: float | str, **other: float) -> Callable[[Path], Path]:
    """The display's manifest with `other` in those sets of fringes whose `key` has a value."""

    def made(folder: Path) -> Path:
        frames = tomllib.loads(display_manifest(folder).read_text())["frames"]
        changed = [shown | other if shown.get(key) == value else shown for shown in frames]
        assert changed != frames
        return display_manifest(folder, frames=changed)

    return made


WRONG: dict[str, tuple[Callable[[Path], Path], str]] = {
    "two fringe frames exchanged": (exchanged(0, 1), "columns, agreement"),
    "frames of two periods exchanged": (exchanged(2, 3), "columns, agreement"),
    "two bits exchanged": (exchanged(14, 16), "fits the inverse of bit"),
    "white and black exchanged": (exchanged(30, 31), "white and black"),
    "wrong period": (fringes("period_px", 100.0, period_px=90.0), "agreement"),
    "wrong direction": (
        fringes("kind", "fringes", direction=-1, first_phase_deg=120.0),
        "agreement",
    ),
    "wrong bit depth": (lambda f: display_manifest(f, bits=12), "8-bit numbers: set bits = 8"),
    "missing image": (
        lambda f: display_manifest(f, files=[*PATTERNS[:-1], "pat99.png"]),
        "pat99.png' is missing",
    ),
    "an image too few": (lambda f: display_manifest(f, files=PATTERNS[:-1]), "31 images"),
    "two bits of the shell exchanged": (shell_exchanged(16, 18), "fits the inverse of bit"),
    "an inverse of the shell exchanged": (shell_exchanged(6, 7), "calibration"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_wrong_manifest_is_refused_with_the_reason(call: Call, tmp_path: Path, name: str) -> None:
    make, said = WRONG[name]
    output = tmp_path / "stack.exr"
    status, _, err = call("import", make(tmp_path), "-o", output)
    assert (status, said in err) == (2, True), err
    assert not output.exists()


def test_calibration_of_another_camera_size_is_refused(call: Call, tmp_path: Path) -> None:
    source = shell_manifest(tmp_path)
    rig = Capture.load(source).calibration
    assert isinstance(rig, Source)
    small = tmp_path / "small.yaml"
    text = rig.files[0].read_text().replace("[ 2592, 1944 ]", "[ 1296, 972 ]")
    assert text != rig.files[0].read_text()
    small.write_text(text)
    manifest = shell_manifest(tmp_path, calibration={"files": [str(small)]})
    status, _, err = call("import", manifest, "-o", tmp_path / "s.exr")
    assert status == 2
    assert "another size" in err or "1296 x 972" in err


@pytest.mark.slow
def test_right_manifests_pass_the_checks_and_are_imported(call: Call, tmp_path: Path) -> None:
    output = tmp_path / "stack.exr"
    for manifest in (display_manifest(tmp_path), shell_manifest(tmp_path)):
        assert call("import", manifest, "--check", "--json")[0] == 0
        assert call("import", manifest, "-o", output)[0] == 0
        assert output.stat().st_size > 1e6
        output.unlink()
