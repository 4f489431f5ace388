"""Captures that others took, where this machine has them: data that the project does not carry."""

import os
from pathlib import Path
from typing import Any

import pytest
import tomli_w

ROOT = Path(__file__).resolve().parents[2]
SHELL = "jhdewitt-sltk/sampledata"
DISPLAY = "kamino410-phase-shifting/sample_data/object1"


def captures(name: str) -> Path:
    """The folder of one capture; skips the test where it is not."""
    base = Path(os.environ.get("FRINGEBENCH_CAPTURES", ROOT.parent / "shared" / "captures"))
    if not (base / name).is_dir():
        pytest.skip(f"no real captures at {base / name}: set FRINGEBENCH_CAPTURES")
    return base / name


def shell_manifest(folder: Path, **changes: Any) -> Path:
    """Gray code both ways with inverses, and an OpenCV calibration (J. De Witt's sltk)."""
    data = captures(SHELL)
    manifest: dict[str, Any] = {
        "folder": str(data / "scan_0020"),
        "files": ["*.jpg"],
        "channel": "luma",
        "projector_resolution": [1280, 800],
        "frames": [
            {"kind": "gray", "axis": "column", "bits": 11},
            {"kind": "gray", "axis": "row", "bits": 11},
        ],
        "calibration": {
            "files": [str(data / "procam_2016_12_09.yaml")],
            "depth_range_mm": [400.0, 1200.0],
        },
    }
    return _write(folder, manifest | changes)


def display_manifest(folder: Path, **changes: Any) -> Path:
    """Three-step fringes of 200/3 and 200/2 px and Gray code of 100 px, both ways (kamino410's phase-shifting).

    Its patterns are ``cos(2 pi x / P + 2 pi (k - 1) / 3)`` of the pixel's index x, k = 0 1 2.
    """
    three = {"kind": "fringes", "steps": 3, "first_phase_deg": -120.0, "origin_px": 0.5}
    manifest: dict[str, Any] = {
        "folder": str(captures(DISPLAY)),
        "files": ["pat*.png"],
        "projector_resolution": [1920, 1080],
        "frames": [
            *(
                {**three, "axis": axis, "period_px": period}
                for axis in ("column", "row")
                for period in (200.0 / 3.0, 100.0)
            ),
            {"kind": "gray", "axis": "column", "bits": 5, "cell_px": 100.0},
            {"kind": "gray", "axis": "row", "bits": 4, "cell_px": 100.0},
            {"kind": "white"},
            {"kind": "black"},
        ],
    }
    return _write(folder, manifest | changes)


def _write(folder: Path, manifest: dict[str, Any]) -> Path:
    path = folder / "capture.toml"
    path.write_text(tomli_w.dumps(manifest))
    return path
