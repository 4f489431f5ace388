"""No planted fault that makes heights wrong leaves `import --check` with status 0.

Wrong: more than 1 % of the valid pixels are beyond ten predicted standard deviations of their height. Frames are made from
known heights, the noise is stated, and every set of patterns is of another kind.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tomli_w

import decode
from scenes.acquisition.patterns import Frame, GrayBits, GrayCode, Patterns, PhaseShift
from scenes.files.capture import Capture
from scenes.support.safe_parse import parse_toml
from tests.conftest import Call
from tests.fringebench.planted_faults import HEIGHT_MM, RIG, Manifest, Shot, sets

Change = Callable[[Manifest], Any]
PATTERNS: dict[str, Patterns] = {
    "periods": PhaseShift(steps=4, periods_px=(16.0, 64.0, 400.0)),
    "both axes": PhaseShift(steps=4, periods_px=(16.0, 64.0, 400.0), axes=("column", "row")),
    "code": PhaseShift(steps=3, periods_px=(20.0,), gray=GrayBits(bits=6)),
    "cell is period": PhaseShift(periods_px=(20.0,), gray=GrayBits(bits=5, cell_px=20.0)),
    "heterodyne": PhaseShift(steps=8, periods_px=(400.0 / 21.0, 20.0)),
    "code alone": GrayCode(bits=(9, 9), axes=("column", "row"), flat=False),
}
FRINGES = [name for name, patterns in PATTERNS.items() if isinstance(patterns, PhaseShift)]
CODED = ["code", "cell is period"]


def capture(
    folder: Path,
    name: str,
    gain: Callable[[Frame], float] = lambda frame: 1.0,
    code_px: float = 0.0,
    top_dn: float = 255.0,
    white_dn: float = 200.0,
) -> Path:
    """Images of a smooth, unevenly bright surface, and their manifest."""
    patterns = PATTERNS[name]
    gains = tuple(gain(frame) for frame in patterns.frames())
    shot = Shot(patterns, white_dn=white_dn, top_dn=top_dn, code_px=code_px, gains=gains)
    return shot.write(folder)


def changed(manifest: Path, change: Change) -> Path:
    tree = parse_toml(manifest.read_text())
    change(tree)
    manifest.write_text(tomli_w.dumps(tree))
    return manifest


def share_beyond(manifest: Path) -> float:
    """Share of the valid pixels beyond ten predicted standard deviations."""
    rec = decode.reconstruct(Capture.load(manifest).stack())
    off = np.abs(rec.height_mm - HEIGHT_MM)[rec.valid]
    return float((off > 10.0 * rec.sigma_mm[rec.valid]).mean()) if off.size else 0.0


def sees(call: Call, manifest: Path) -> bool:
    """Whether the check refuses the capture; if it does not, the heights must be right."""
    status = call("import", manifest, "--check", "--json")[0]
    assert status or share_beyond(manifest) <= 0.01
    return status != 0


@pytest.mark.slow
@pytest.mark.parametrize("name", PATTERNS)
def test_right_capture_passes(tmp_path: Path, call: Call, name: str) -> None:
    manifest = capture(tmp_path, name)
    assert not sees(call, manifest)


@pytest.mark.slow
@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (2, 3)])
@pytest.mark.parametrize("name", PATTERNS)
def test_swapped_frames_are_detected_or_harmless(
    tmp_path: Path, call: Call, name: str, pair: tuple[int, int]
) -> None:
    def swap(manifest: Manifest) -> None:
        files = manifest["files"]
        files[pair[0]], files[pair[1]] = files[pair[1]], files[pair[0]]

    seen = sees(call, changed(capture(tmp_path, name), swap))
    # Two of a code's frames may be dark and bright in the same pixels of what is in view.
    assert seen or name == "code alone"


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.95, 1.01, 1.25])
@pytest.mark.parametrize("name", FRINGES)
def test_wrong_period_is_detected_or_harmless(
    tmp_path: Path, call: Call, name: str, factor: float
) -> None:
    manifest = capture(tmp_path, name)
    sees(call, changed(manifest, lambda m: sets(m, "fringes")[0].update(
        period_px=factor * sets(m, "fringes")[0]["period_px"])))  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 0.9, 2.0])
@pytest.mark.parametrize("name", [*CODED, "code alone"])
def test_wrong_cell_is_detected(tmp_path: Path, call: Call, name: str, factor: float) -> None:
    def widen(manifest: Manifest) -> None:
        for shown in sets(manifest, "gray"):
            shown["cell_px"] *= factor

    assert sees(call, changed(capture(tmp_path, name), widen))


@pytest.mark.slow
@pytest.mark.parametrize("cells", [-0.4, 0.05, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("name", CODED)
def test_shifted_code_is_detected_or_harmless(
    tmp_path: Path, call: Call, name: str, cells: float
) -> None:
    code = next(f for f in PATTERNS[name].frames() if f.kind == "gray")
    sees(call, capture(tmp_path, name, code_px=cells * code.period_px))


@pytest.mark.slow
@pytest.mark.parametrize("name", FRINGES)
def test_flicker_of_five_per_cent_is_detected_or_harmless(
    tmp_path: Path, call: Call, name: str
) -> None:
    gains = 1.0 + 0.05 * np.random.default_rng(1).choice([-1.0, 1.0], 64)
    order = iter(range(64))
    sees(call, capture(tmp_path, name, gain=lambda frame: gains[next(order)]))


@pytest.mark.slow
@pytest.mark.parametrize("white_dn", [230.0, 300.0, 500.0])
@pytest.mark.parametrize("name", FRINGES)
def test_clipping_at_235_is_detected_or_harmless(
    tmp_path: Path, call: Call, name: str, white_dn: float
) -> None:
    sees(call, capture(tmp_path, name, top_dn=235.0, white_dn=white_dn))


@pytest.mark.slow
@pytest.mark.parametrize("size", [(200, 200), (640, 480), (1600, 1200)])
@pytest.mark.parametrize("name", PATTERNS)
def test_wrong_projector_size_is_detected_or_harmless(
    tmp_path: Path, call: Call, name: str, size: tuple[int, int]
) -> None:
    def resize(manifest: Manifest) -> None:
        manifest["projector_resolution"] = list(size)
        manifest["rig"]["projectors"][0]["resolution"] = list(size)

    sees(call, changed(capture(tmp_path, name), resize))


@pytest.mark.slow
@pytest.mark.parametrize("repeat", [False, True])
@pytest.mark.parametrize("name", ["periods", "both axes", "heterodyne"])
def test_merged_sets_are_detected(tmp_path: Path, call: Call, name: str, repeat: bool) -> None:
    def merge(manifest: Manifest) -> None:
        one, two = sets(manifest, "fringes")[:2]
        two.update(period_px=one["period_px"], repeat=repeat)

    assert sees(call, changed(capture(tmp_path, name), merge))


@pytest.mark.slow
def test_dropped_distortion_is_detected(tmp_path: Path, call: Call) -> None:
    manifest = capture(tmp_path, "periods")
    storage = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_WRITE)
    for name, model in (("1", RIG.camera), ("2", RIG.projectors[0])):
        at = model.projection()
        storage.write(f"M{name}", np.array([[at.fx, 0, at.cx], [0, at.fy, at.cy], [0, 0, 1]]))
        # The second device's is under a name that nothing knows.
        storage.write("D1" if name == "1" else "pk", np.array(at.distortion))
    camera, projector = RIG.camera.projection(), RIG.projectors[0].projection()
    storage.write("R", projector.R @ camera.R.T)
    storage.write("T", projector.t - projector.R @ camera.R.T @ camera.t)
    storage.release()

    def other(manifest: Manifest) -> None:
        del manifest["rig"]
        manifest["calibration"] = {"files": ["rig.yml"]}

    status, _, err = call("import", changed(manifest, other), "--check")
    assert status == 2
    assert "pk" in err
