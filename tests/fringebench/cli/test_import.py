"""`import` on captures with planted faults, made from synthetic frames of known truth."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tomli_w

import decode
from scenes import PhaseShift, Stack
from tests.conftest import Call

ROWS, COLUMNS = 120, 200
SIZE = [1024, 768]
STEPS = 4
PERIODS = (16.0, 128.0, 1024.0)


def column_px() -> np.ndarray:
    y, x = np.mgrid[:ROWS, :COLUMNS] + 0.5
    return np.asarray(3.0 * x + 20.0 + 25.0 * np.exp(-((x - 90.0) ** 2 + (y - 60.0) ** 2) / 900.0))


def capture(folder: Path, gains: tuple[float, ...] = (1.0,) * STEPS, **changes: Any) -> Path:
    """Images of three fringe sets, and their manifest; frames of the finest set are `gains` times as bright."""
    shown = PhaseShift(steps=STEPS, periods_px=PERIODS).frames()
    rng = np.random.default_rng(1)
    reflectance = rng.uniform(0.6, 1.0, (ROWS, COLUMNS))
    for k, frame in enumerate(shown):
        factor = gains[frame.step] if frame.period_px == PERIODS[0] else 1.0
        light = 180.0 * factor * reflectance * (0.1 + 0.9 * frame.commanded(column_px()))
        noisy = light + rng.normal(0.0, 0.5, light.shape)
        image = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"img{k:02d}.png"), image)
    sets = [{"kind": "fringes", "axis": "column", "period_px": p, "steps": STEPS} for p in PERIODS]
    manifest = {
        "files": ["img*.png"],
        "projector_resolution": SIZE,
        "noise_dn": 0.5,
        "frames": sets,
        **changes,
    }
    (folder / "capture.toml").write_text(tomli_w.dumps(manifest))
    return folder / "capture.toml"


def error_px(path: Path) -> float:
    rec = decode.reconstruct(Stack.read(path), height="phase")
    off = rec.phases["column"].coordinate_px - column_px()
    return float(np.sqrt(np.mean(off[rec.valid] ** 2)))


def test_json_says_what_was_read_and_found(tmp_path: Path, call: Call) -> None:
    output = tmp_path / "stack.exr"
    status, out, err = call("import", capture(tmp_path), "-o", output, "--json")
    assert status == 0, err
    answer = json.loads(out)
    assert answer["stack"] == str(output)
    assert answer["camera_resolution"] == [COLUMNS, ROWS]
    assert answer["projector_resolution"] == SIZE
    assert answer["saturation_dn"] == 255.0
    assert {f["verdict"] for f in answer["findings"]} <= {"ok", "unknown"}
    assert Stack.read(output).projector_size() == tuple(SIZE)
    # Noise of 0.5 DN on a modulation of 49 DN or more.
    assert error_px(output) < 0.03


def test_flicker_is_refused_and_divided_out_on_request(tmp_path: Path, call: Call) -> None:
    manifest, output = capture(tmp_path, (1.05, 0.95, 1.0, 1.0)), tmp_path / "stack.exr"
    status, out, _ = call("import", manifest, "--check", "--json")
    assert status == 1
    wrong = [f for f in json.loads(out)["findings"] if f["verdict"] == "wrong"]
    assert [f["name"] for f in wrong] == ["column fringes of 16 px, brightness"]
    assert "--equalise" in wrong[0]["message"]
    assert call("import", manifest, "-o", output, "--equalise")[0] == 0
    assert error_px(output) < 0.03


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"files": [f"img{k:02d}.png" for k in (0, 2, 1, *range(3, 12))]}, "exchanging steps"),
        ({"frames": [{"kind": "fringes", "axis": "column", "period_px": p, "steps": 4} for p in (16.0, 16.0, 1024.0)]}, "repeat = true"),
        ({"frames": [{"kind": "fringes", "axis": "column", "period_px": p, "steps": 4} for p in (17.0, 128.0, 1024.0)]}, "agreement"),
    ],
    ids=["swapped frames", "merged sets", "wrong period"],
)  # fmt: skip
def test_planted_fault_is_refused_with_its_cause(
    tmp_path: Path, call: Call, changes: dict[str, Any], said: str
) -> None:
    output = tmp_path / "stack.exr"
    status, _, err = call("import", capture(tmp_path, **changes), "-o", output)
    assert status == 2
    assert said in " ".join(err.split())
    assert not output.exists()
