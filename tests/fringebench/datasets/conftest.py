"""A board so small that a sample takes a fifth of a second, and data sets of it."""

import hashlib
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

import scenes
from fringebench.datasets import building
from fringebench.datasets.building import build
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.sample import Record, attempt
from fringebench.datasets.store import Store

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
def plan(scene_file: Path) -> DatasetPlan:
    """Six samples of it."""
    return DatasetPlan.of(scenes.load(scene_file), SAMPLES, seed=7)


@pytest.fixture(scope="session")
def undisturbed(plan: DatasetPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set, made by one worker in one go; not to be touched."""
    folder = tmp_path_factory.mktemp("undisturbed") / "set"
    build(plan, folder, workers=1)
    return folder


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples are made in this process, as `test_resume` shows that processes make them; a worker takes seconds to start."""

    def made(
        plan: DatasetPlan, indices: Iterable[int], store: Store, workers: int
    ) -> Iterator[tuple[Record, Path | None]]:
        scene = plan.load_scene()
        for index in indices:
            with store.staging() as folder:
                record = attempt(plan, scene, index, folder)
                yield record, folder if record.status == "made" else None

    monkeypatch.setattr(building, "in_processes", made)


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
