"""Figures say what was measured, in the units they name."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import scenes
from decode import Reconstruction
from evaluation.output import plots
from evaluation.output.scene_pictures import scene_picture
from scenes.files.truth_maps import Truth
from scenes.support.errors import FileError, ScoreError
from tests.commands import program
from tests.evaluation.synthetic_truth import Floats, Grid, TruthMaker

SHAPE = (60, 80)
Measured = tuple[Reconstruction, Truth]


@pytest.fixture(scope="module")
def measured(truth_of: TruthMaker, grid: Grid) -> Measured:
    """A cap on a board with a dark corner, errors of 10 um everywhere and 20 um more on the cap; truth and heights."""
    x, y = grid(SHAPE)
    r = np.hypot(x, y)
    ink = (x < -2.0) & (y < -1.5)
    height = np.where(r < 2.0, 1.0 - 0.25 * r**2, 0.0)
    truth = truth_of(height, {"base": True, "cap": r < 2.0, "ink": ink})
    rng = np.random.default_rng(0)
    valid = np.ones(SHAPE, bool)
    valid[ink] = False
    rec = Reconstruction.of_heights(
        truth.height_mm + rng.normal(0.0, 0.01, SHAPE) + 0.02 * (r < 2.0), valid
    )
    sigma = np.full(SHAPE, 0.01, np.float32)
    return replace(rec, sigma_mm=sigma, modulation_dn=np.where(ink, 10, 80).astype("f4")), truth


def axes_of(figure: Figure, title: str) -> Any:
    return next(axes for axes in figure.axes if axes.get_title().startswith(title))


def test_standard_set_is_complete_and_is_saved(measured: Measured, tmp_path: Path) -> None:
    found = plots.figures(*measured)
    assert list(found) == ["height", "error", "modulation", "sigma", "histograms", "profile-cap"]
    for name, figure in found.items():
        plots.save(figure, tmp_path / f"{name}.png")
        image = Image.open(tmp_path / f"{name}.png")
        assert min(image.size) > 300
        # A figure with something in it has more than its background.
        assert len(np.unique(np.asarray(image.convert("L")))) > 10


def test_predicted_noise_and_render_noise_share_one_scale(measured: Measured) -> None:
    rec, truth = measured
    noisy = replace(truth, render_noise_mm=np.full(SHAPE, 0.03, np.float32))
    found = plots.figures(rec, noisy)
    # 10 um predicted, 30 um of render noise.
    for name in ("sigma", "render_noise"):
        np.testing.assert_allclose(
            found[name].axes[0].images[0].get_clim(), (10.0, 30.0), rtol=1e-5
        )


def test_heights_alone_are_drawn(measured: Measured) -> None:
    rec, truth = measured
    alone = Reconstruction.of_heights(rec.height_mm, rec.valid)
    found = plots.figures(alone, truth)
    assert list(found) == ["height", "error", "histograms", "profile-cap"]


def test_drawing_leaves_pyplot_s_global_state_alone() -> None:
    code = "import sys, evaluation.output.plots; print('matplotlib.pyplot' in sys.modules)"
    assert program(code).stdout.strip() == "False"


def test_error_map_is_in_micrometres_and_symmetric_about_zero(measured: Measured) -> None:
    rec, truth = measured
    image = plots.error_map(rec, truth).axes[0].images[0]
    low, high = image.get_clim()
    assert low == -high
    error = (rec.height_mm - truth.height_mm).astype(float) * 1000.0
    drawn: Floats = np.ma.filled(np.ma.masked_invalid(np.ma.asarray(image.get_array())), np.nan)
    # Truth and heights are float32 of about 1 mm.
    np.testing.assert_allclose(drawn[rec.valid], error[rec.valid], atol=1e3 * 2.0**-22)
    assert np.isnan(drawn[~rec.valid]).all()
    fixed = plots.error_map(rec, truth, limit_um=5.0).axes[0].images[0]
    assert fixed.get_clim() == (-5.0, 5.0)


def test_histogram_is_a_density_next_to_the_predicted_noise(measured: Measured) -> None:
    rec, truth = measured
    figure = plots.error_histograms(rec, truth)
    base = axes_of(figure, "base")
    stairs = base.patches[0].get_data()
    assert np.sum(stairs.values * np.diff(stairs.edges)) == pytest.approx(1.0, abs=0.011)
    line = base.lines[0].get_xydata()
    assert line[:, 1].max() == pytest.approx(1.0 / (10.0 * np.sqrt(2.0 * np.pi)), rel=1e-3)
    with pytest.raises(StopIteration):
        axes_of(figure, "ink")


def test_profile_draws_the_row_asked_for(measured: Measured) -> None:
    rec, truth = measured
    row = plots.row_through(truth, "cap")
    assert row in (29, 30)
    above = plots.profile_figure(rec, truth, row).axes[0]
    heights, true = (np.asarray(line.get_xydata()) for line in above.lines)
    np.testing.assert_array_equal(heights[:, 1], rec.height_mm[row].astype(float))
    np.testing.assert_array_equal(true[:, 1], truth.height_mm[row].astype(float))
    np.testing.assert_array_equal(true[:, 0], truth.xyz_mm[row, :, 0].astype(float))
    column = np.asarray(
        plots.profile_figure(rec, truth, 40, along="column").axes[0].lines[1].get_xydata()
    )
    np.testing.assert_array_equal(column[:, 1], truth.height_mm[:, 40].astype(float))


def test_no_row_crosses_a_label_that_is_not_seen(truth_of: TruthMaker) -> None:
    truth = truth_of(np.zeros(SHAPE), {"base": True, "cap": False})
    assert plots.row_through(truth, "cap") is None


def test_map_without_data_or_of_one_value_is_drawn() -> None:
    for value in (np.nan, 3.0):
        assert plots.png(plots.map_figure(np.full(SHAPE, value), "Map", "mm"))


def test_impossible_figures_are_refused(measured: Measured, tmp_path: Path) -> None:
    rec, truth = measured
    with pytest.raises(ScoreError, match="row 60 does not exist: use 0 to 59"):
        plots.profile_figure(rec, truth, 60)
    nothing = replace(rec, reason=np.full(SHAPE, 3, np.uint8))
    with pytest.raises(ScoreError, match="no region has a measured pixel"):
        plots.error_histograms(nothing, truth)
    with pytest.raises(FileError, match="cannot write"):
        plots.save(plots.map_figure(np.zeros(SHAPE), "Map", "mm"), tmp_path / "no" / "map.png")


def test_png_is_a_png_file() -> None:
    image = Image.open(io.BytesIO(plots.png(plots.map_figure(np.eye(9), "Map", "mm"))))
    assert image.format == "PNG"


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_grains_of_few_pixels_are_not_hidden_by_outlines(
    truth_of: TruthMaker, grid: Grid, share: float
) -> None:
    x, y = grid(SHAPE)
    grains = (np.random.default_rng(0).random(SHAPE) < share) & (x > 0.0)
    disc = np.hypot(x + 2.0, y) < 1.0
    truth = truth_of(np.zeros(SHAPE), {"base": True, "grains": grains, "disc": disc})
    frames = np.full((1, 3, *SHAPE), 100, np.uint8)
    patterns = tuple(scenes.Frame("column", 16.0, k, 3, 2 * np.pi * k / 3) for k in range(3))
    stack = scenes.Stack(frames, patterns, (1.0,), scenes.SimpleSensor(bits=8))
    shown = scene_picture(stack, truth)
    axes = axes_of(shown, "The scene")
    assert {text.get_text() for text in axes.texts} == {"base", "grains", "disc"}
    assert len(axes.collections) == 1, "only the disc is outlined"
