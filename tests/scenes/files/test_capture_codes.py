"""Codes that a manifest can say: images of a known projector coordinate come back as that coordinate."""

import re
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io

import decode
from decode.checks.stack_check import check
from scenes.acquisition.frames import Frame
from scenes.files.capture import Capture
from scenes.files.capture_frames import OrderMap, PhaseMap, SingleShot
from scenes.support.errors import FileError

SIZE = (600, 400)
SIGMA_DN = 0.5
ROW, COLUMN = np.mgrid[:90, :150] + 0.5
BUMP = np.exp(-((COLUMN - 75) ** 2 + (ROW - 45) ** 2) / 700)
AT_PX = {"column": 3.0 * COLUMN + 40 + 12 * BUMP, "row": 2.0 * ROW + 60 + 6 * BUMP}
MANUAL = Path(__file__).parents[3] / "docs" / "import.md"
OFFSETS_PX = np.linspace(-5.0, 5.0, 41)


def fringes(period_px: float, steps: int, **keys: Any) -> dict[str, Any]:
    return {"kind": "fringes", "axis": "column", "period_px": period_px, "steps": steps, **keys}


def gray(cell_px: float, bits: int, **keys: Any) -> dict[str, Any]:
    return {"kind": "gray", "axis": "column", "bits": bits, "cell_px": cell_px, **keys}


def shown(frame: Frame) -> np.ndarray:
    """What the pixels see; lines are blurred by a lens, as a camera that resolves them would be useless."""
    weight = np.exp(-0.5 * (OFFSETS_PX / 1.5) ** 2) if frame.kind == "line" else OFFSETS_PX == 0.0
    at = AT_PX[frame.axis]
    seen = sum(w * frame.commanded(at + o) for o, w in zip(OFFSETS_PX, weight, strict=True) if w)
    return np.asarray(seen / weight.sum())


def captured(
    folder: Path, frames: list[dict[str, Any]], texture: float = 0.3, **changes: Any
) -> Capture:
    """The manifest of noisy 8-bit images."""
    keys = {
        "files": ["img*.png"],
        "folder": folder,
        "noise_dn": SIGMA_DN,
        "projector_resolution": SIZE,
        **changes,
    }
    capture = Capture.model_validate({**keys, "frames": frames})
    rng = np.random.default_rng(0)
    white = 170.0 * rng.uniform(1.0 - texture, 1.0, COLUMN.shape)
    images = [
        f
        for s in capture.frames
        if not isinstance(s, PhaseMap | OrderMap)
        for f in s.frames()[: 1 if isinstance(s, SingleShot) else None]
    ]
    for k, frame in enumerate(images):
        light = (
            15.0 + white * (0.03 + 0.97 * shown(frame)) + rng.normal(0.0, SIGMA_DN, COLUMN.shape)
        )
        cv2.imwrite(str(folder / f"img{k:02d}.png"), np.round(light).astype(np.uint8))
    return capture


CODE20 = gray(10.0, 6)
TWICE = [fringes(20.0, 4), gray(20.0, 5), {"kind": "white"}, {"kind": "black"}]
# The largest error: six of 13,500 pixels' standard deviations, 5 of 0.58 DN (rounding included) on a modulation of 57 DN:
# 0.0102 rad over sqrt(N / 2), N the steps of the finest period; (2 + 1) has N = 1. Lines have 3 DN of harmonics left in 30.
CODES: dict[str, tuple[list[dict[str, Any]], float]] = {
    "micro": ([fringes(14.57, 3), *(fringes(p, 1) for p in (16.09, 16.24, 16.47, 16.6))], 0.12),
    "embedded": ([fringes(16.0, 3), fringes(1 / (1 / 16 - 1 / 600), 2), fringes(1 / (1 / 16 - 0.01), 2)], 0.13),
    "2 + 1": ([{"kind": "grey"}, fringes(20.0, 2, first_phase_deg=-90.0), CODE20], 0.28),
    "modulated": ([{"kind": "modulated", "axis": "column", "period_px": p, "steps": 3, "carrier_px": 16.0, "carrier_steps": 4, "origin_px": 0.5} for p in (100.0, 600.0)], 0.12),
    "line shift": ([{"kind": "line-shift", "axis": "column", "period_px": 16.0, "steps": 8, "origin_px": 3.0}, gray(8.0, 7)], 0.3),
    "line shift back": ([{"kind": "line-shift", "axis": "row", "period_px": 16.0, "steps": 8, "direction": -1}, gray(8.0, 6, axis="row")], 0.3),
    "shifted Gray": ([*TWICE, gray(20.0, 5, origin_px=-10.0)], 0.14),
    "shifted Gray to the right": ([*TWICE, gray(20.0, 5, origin_px=10.0)], 0.14),
    "shifted Gray without inverses": ([*TWICE[:1], *TWICE[2:], gray(20.0, 5, inverse="none"), gray(20.0, 5, origin_px=-10.0, inverse="none")], 0.14),
}  # fmt: skip


@pytest.mark.parametrize("name", CODES)
def test_code_gives_the_coordinate_without_a_warning(tmp_path: Path, name: str) -> None:
    frames, largest_px = CODES[name]
    stack = captured(tmp_path, frames).stack()
    axis = "row" if "back" in name else "column"
    rec = decode.reconstruct(stack, height="phase", axis=axis)  # type: ignore[arg-type]
    assert rec.valid.mean() > 0.99 and rec.order_known
    off = np.abs(rec.phases[axis].coordinate_px - AT_PX[axis])[rec.valid]  # type: ignore[index]
    assert off.max() < largest_px
    assert {f.verdict for f in check(stack).findings} <= {"ok", "unknown"}


@pytest.mark.parametrize("name", ["micro", "embedded", "2 + 1"])
def test_noise_of_few_steps_is_estimated_where_it_is_not_stated(tmp_path: Path, name: str) -> None:
    """No set has four steps, whose misfit would show the noise: it is what roughness the frames do not share with their light."""
    frames, largest_px = CODES[name]
    stack = captured(tmp_path, frames, noise_dn=None).stack()
    # Rounding adds a twelfth of a DN squared; fringes of five camera pixels are a little rough themselves.
    wanted = np.hypot(SIGMA_DN, 12.0**-0.5)
    assert 0.9 < float(np.sqrt(stack.sensor.variance_dn2(100.0, 1.0))) / wanted < 2.0
    rec = decode.reconstruct(stack, height="phase")
    assert rec.valid.mean() > 0.99 and rec.order_known
    assert (
        np.abs(rec.phases["column"].coordinate_px - AT_PX["column"])[rec.valid].max() < largest_px
    )
    assert {f.verdict for f in check(stack).findings} <= {"ok", "unknown"}


def test_single_shot_measures_a_smooth_surface_inside_its_border(tmp_path: Path) -> None:
    shot = {"kind": "single-shot", "axis": "column", "period_px": 24.0, "first_phase_deg": 30.0}
    capture = captured(tmp_path, [shot, gray(12.0, 6)], texture=0.0)
    imported = capture.imported()
    rec = decode.reconstruct(imported.stack, height="phase")
    assert 0.6 < rec.valid.mean() < 0.9
    off = np.abs(rec.phases["column"].coordinate_px - AT_PX["column"])[rec.valid]
    # The bump's slope moves the carrier by a tenth; a twentieth of a fringe is what the filter's sides lose of it.
    assert np.percentile(off, 99) < 24.0 / 20.0
    assert "single shot" in imported.findings[-1].name
    turned = (SingleShot(axis="row", period_px=24.0), *capture.frames[1:])
    with pytest.raises(FileError, match="no carrier"):
        capture.model_copy(update={"frames": turned}).stack()


@pytest.mark.parametrize("suffix", [".npy", ".mat"])
@pytest.mark.parametrize("unwrapped", [False, True])
def test_phase_maps_give_their_coordinates(tmp_path: Path, suffix: str, unwrapped: bool) -> None:
    phase = 2.0 * np.pi * (AT_PX["column"] - 3.0) / 20.0
    phase[:4] = np.nan
    wrapped = np.angle(np.exp(1j * phase))
    maps = (
        {"a": phase}
        if unwrapped
        else {"a": wrapped, "b": np.round((phase - wrapped) / (2 * np.pi))}
    )
    for name, values in maps.items():
        if suffix == ".npy":
            np.save(tmp_path / f"{name}.npy", values)
        else:
            scipy.io.savemat(tmp_path / f"{name}.mat", {name: values})
    one = {
        "kind": "phase-map",
        "axis": "column",
        "period_px": 20.0,
        "origin_px": 3.0,
        "unwrapped": unwrapped,
    }
    keys = {"files": [f"*{suffix}"], "folder": tmp_path, "projector_resolution": SIZE}
    capture = Capture.model_validate(
        {**keys, "frames": [one] if unwrapped else [one, {"kind": "order-map"}]}
    )
    rec = decode.reconstruct(capture.stack(), height="phase")
    assert rec.order_known
    np.testing.assert_array_equal(rec.valid, np.isfinite(phase))
    # Frames in float32: 1e-6 rad.
    np.testing.assert_allclose(
        rec.phases["column"].coordinate_px[4:], AT_PX["column"][4:], atol=1e-4
    )


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ([fringes(20.0, 2)], "grey"),
        ([fringes(20.0, 1), fringes(24.0, 1)], "single-shot"),
        ([fringes(20.0, 3), fringes(24.0, 1)], "two such periods"),
        ([{"kind": "phase-map", "axis": "column", "period_px": 20.0}, {"kind": "white"}], "mixes"),
    ],
)
def test_frames_that_give_no_phase_are_refused_with_what_is_missing(
    frames: list[dict[str, Any]], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        Capture.model_validate({"files": ["a.png"], "frames": frames})


def test_codes_of_the_manual_are_manifests() -> None:
    rows = [re.findall(r"`(\{kind = .*?\})`", line) for line in MANUAL.read_text().splitlines()]
    rows = [row for row in rows if row]
    assert len(rows) > 10
    for row in rows:
        frames = tomllib.loads(f"frames = [{', '.join(row)}]")["frames"]
        Capture.model_validate({"files": ["*"], "frames": frames})
