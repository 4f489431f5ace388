"""A board so small that a sample takes a fifth of a second, and data sets of it."""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import scenes
from fringebench.datasets.build import build
from fringebench.datasets.plan import Plan

SAMPLES = 6

SCENE = """
name = "small-board"
height_range_mm = [-0.05, 0.45]

[camera]
model = "telecentric"
resolution = [64, 48]
field_width_mm = 3.2
pose = { origin_mm = [0.0, 0.0, 100.0] }

[[projectors]]
model = "telecentric"
resolution = [256, 192]
field_width_mm = 4.0
irradiance_w_m2 = 100.0
pose = { origin_mm = [-50.0, 0.0, 100.0] }

[patterns]
kind = "phase-shift"
steps = 3
periods_px = [16.0, 256.0]
axes = ["column"]

[sensor]
kind = "emva1288"
bits = 12

[exposures]
auto = { label = "mask", level_dn = 1200.0 }

[sampling]
samples = 2
depth = 2

[board]
kind = "parametric"
size_mm = [3.2, 2.4]
parts = [
  { package = "chip", size = "0402", position_mm = [-0.5, 0.4] },
  { package = "chip", size = "0201", position_mm = [0.6, -0.5] },
]

[board.paste]
step_mm = 0.05
volume = { kind = "truncated-normal", mean = 1.0, sd = 0.1, low = 0.7, high = 1.3 }

[board.defects]
missing = { probability = 0.2 }

[randomise]
"projectors.0.irradiance_w_m2" = { kind = "uniform", low = 80.0, high = 120.0 }
"""


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene as a TOML file."""
    path = tmp_path_factory.mktemp("scene") / "small-board.toml"
    path.write_text(SCENE, "utf-8")
    return path


@pytest.fixture(scope="session")
def plan(scene_file: Path) -> Plan:
    """Six samples of it."""
    return Plan.of(scenes.load(scene_file), SAMPLES, seed=7)


@pytest.fixture(scope="session")
def undisturbed(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set, made by one worker in one go; not to be touched."""
    folder = tmp_path_factory.mktemp("undisturbed") / "set"
    build(plan, folder, workers=1)
    return folder


@pytest.fixture
def copy(undisturbed: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(undisturbed, tmp_path / "copy"))


@pytest.fixture(scope="session")
def checksums() -> Callable[[Path], dict[str, str]]:
    """Every file below a folder with its SHA-256."""
    return _checksums


def _checksums(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
