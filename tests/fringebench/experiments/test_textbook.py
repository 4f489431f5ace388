"""The experiments of the chapter agree with the chapter and with theory."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import scenes
from fringebench.experiments import textbook
from fringebench.experiments.chapter_experiment import APEX_PX, CAPTURES
from fringebench.pages.chapter_page import chapter_report
from scenes.support.errors import FileError, RenderError

pytestmark = pytest.mark.slow

Rows = dict[str, textbook.ChapterRow]
NAMES = [
    "apex_clean_mm",
    "step_clean_mm",
    "base_rms_mm",
    "base_rms_dim_mm",
    "dim_ratio",
    "dark_flagged_fraction",
    "base_false_alarm_fraction",
    "saturated_flagged_fraction",
    "apex_saturated_mm",
    "saturated_rms_mm",
    "dark_rms_mm",
]
FIGURES = [
    "figure-32-1-fringes.png",
    "figure-32-2-wrapped-phase.png",
    "figure-32-3-low-frequency-guide.png",
    "figure-32-4-absolute-phase.png",
    "figure-32-5-height-map.png",
    "figure-32-6-modulation-and-mask.png",
    "figure-32-7-error-map.png",
]
# Five standard deviations: a false alarm in two million.
SIGMAS = 5.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("chapter") / "figures"


@pytest.fixture(scope="module")
def rows(folder: Path) -> Rows:
    return {row.name: row for row in textbook.run(folder, page=chapter_report).rows}


def rms_scatter(pixels: int) -> float:
    """Standard deviation of a root mean square over that many pixels of every capture, relative."""
    return float(1.0 / np.sqrt(2.0 * pixels * CAPTURES))


def test_table_has_every_figure_and_is_json(rows: Rows) -> None:
    assert list(rows) == NAMES
    result = textbook.ChapterResult(tuple(rows.values())).to_dict()
    read = json.loads(json.dumps(result, allow_nan=False))
    assert [row["name"] for row in read["rows"]] == NAMES
    assert all(
        {"name", "chapter", "theory", "measured", "note"} == set(row) for row in read["rows"]
    )


@pytest.mark.parametrize(
    ("name", "chapter_within", "pixels"),
    [
        ("base_rms_mm", 0.03, 70_000),
        ("base_rms_dim_mm", 0.04, 70_000),
        ("saturated_rms_mm", 0.10, 600),
        ("dark_rms_mm", 0.05, 6_000),
    ],
)
def test_noise_agrees_with_chapter_and_theory(
    rows: Rows, name: str, chapter_within: float, pixels: int
) -> None:
    row = rows[name]
    assert row.measured == pytest.approx(row.chapter, rel=chapter_within)
    assert row.measured == pytest.approx(row.theory, rel=SIGMAS * rms_scatter(pixels))


def test_dimming_raises_the_noise_as_modulation_falls(rows: Rows) -> None:
    row = rows["dim_ratio"]
    assert row.chapter == 5.4
    assert row.measured == pytest.approx(80.0 / 15.0, rel=0.02)
    assert row.measured == pytest.approx(row.theory, rel=SIGMAS * np.sqrt(2) * rms_scatter(70_000))


def test_step_and_apex_are_measured_correctly(rows: Rows) -> None:
    assert rows["step_clean_mm"].measured == pytest.approx(3.0, abs=0.005)
    apex = rows["apex_clean_mm"]
    # The mean of a paraboloid over 5 x 5 pixels of 0.1 mm is 6 mm x (0.04 mm^2 / 100 mm^2) below its apex.
    assert apex.theory == pytest.approx(6.0 - 0.0024, abs=2e-4)
    assert apex.measured == pytest.approx(apex.theory, abs=0.01)


def test_saturation_lowers_the_apex_as_clipping_predicts(rows: Rows) -> None:
    clean, saturated = rows["apex_clean_mm"], rows["apex_saturated_mm"]
    sd = rows["base_rms_mm"].theory / APEX_PX / np.sqrt(CAPTURES)
    assert saturated.measured == pytest.approx(saturated.theory, abs=SIGMAS * sd)
    assert saturated.measured < clean.measured - SIGMAS * sd


def test_mask_rejects_the_dark_region_and_not_saturation(rows: Rows) -> None:
    dark = rows["dark_flagged_fraction"]
    assert dark.measured >= 0.99
    scatter = np.sqrt(dark.theory * (1.0 - dark.theory) / (6_000 * CAPTURES))
    assert dark.measured == pytest.approx(dark.theory, abs=SIGMAS * scatter)
    assert rows["base_false_alarm_fraction"].measured == 0.0
    assert rows["saturated_flagged_fraction"].measured == 0.0
    # Less than one pixel in all captures is expected.
    assert rows["base_false_alarm_fraction"].theory < 1e-6
    assert rows["saturated_flagged_fraction"].theory < 1e-6


def test_every_figure_is_drawn(rows: Rows, folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == [*FIGURES, "report.html"]
    for name in FIGURES:
        image = Image.open(folder / name)
        assert min(image.size) > 400
        assert len(np.unique(np.asarray(image.convert("L")))) > 50


def test_model_of_the_chapter_is_exact_in_its_scenes() -> None:
    for name in ("chapter", "chapter-dim", "chapter-trap"):
        scene = scenes.load(name)
        projector, camera = scene.projectors[0].projection(), scene.camera.projection()
        points = np.array([[-18.0, 4.0, 0.0], [0.0, 0.0, 0.0], [-7.0, -9.0, 6.0], [11.0, 2.0, 3.0]])
        u, x = projector.project(points)[0][:, 0], camera.project(points)[0][:, 0]
        # u = x + c h, c = 4 px/mm, up to the projector's margin of 40 columns.
        np.testing.assert_allclose(u - x - 4.0 * points[:, 2], 40.0, atol=1e-9)


def test_invalid_folder_and_seed_are_refused(tmp_path: Path) -> None:
    taken = tmp_path / "file"
    taken.write_text("not a folder")
    with pytest.raises(FileError, match="cannot create the folder"):
        textbook.run(taken)
    with pytest.raises(RenderError, match="seed"):
        textbook.run(None, seed=-1)
