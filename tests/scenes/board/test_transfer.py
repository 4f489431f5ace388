"""Statistics of prints: against area ratio, by package, over a run of prints."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenes
from scenes.board.board import ParametricBoard
from scenes.board.gerber.gerber_board import GerberBoard
from scenes.board.printing import printed
from scenes.support.errors import ImpossibleError, SceneError

STENCIL_MM = 0.12
# The figures in print that the curves are drawn through (docs/boards.md), so no test of these curves against other prints: area
# ratio, mean, coefficient of variation, source.
PUBLISHED = [
    (
        0.30,
        0.05,
        None,
        "T. Lentz, SMT007 Magazine, July 2019: lower end of what powders of types 3 to 6 gave",
    ),
    (0.50, 0.60, None, "the same, upper end"),
    (
        0.66,
        0.80,
        0.10,
        "the industry's limit of 80 % at IPC-7525's 0.66; SMT007 Magazine, March 2018, p. 50: 10 % is under control",
    ),
]
PARTS: list[dict[str, Any]] = [
    {"package": "chip", "size": "0402", "name": "R1", "position_mm": [-6.0, 3.0]},
    {"package": "chip", "size": "0402", "name": "C12", "position_mm": [-6.0, -3.0]},
    {"package": "bga", "name": "U1", "position_mm": [5.0, 0.0], "columns": 6, "rows": 6},
]


def shares(board: ParametricBoard) -> dict[str, float]:
    """Deposited over the opening's volume, by name of pad."""
    return {
        d.pad.name: 0.0
        if d.field is None
        else d.field.volume_mm3 / (d.pad.aperture.area * STENCIL_MM)
        for d in printed(board).deposits
    }


def few(seed: int = 0, **paste: Any) -> dict[str, float]:
    tree = {
        "parts": PARTS,
        "size_mm": (24.0, 16.0),
        "paste": {"step_mm": 0.1} | paste,
        "seed": seed,
    }
    return shares(ParametricBoard.model_validate(tree))


def balls(ratio: float, seed: int) -> NDArray[np.float64]:
    """2116 round openings of one area ratio, d / 4 t."""
    part = {"package": "bga", "position_mm": [0, 0], "columns": 46, "rows": 46, "pitch_mm": 1.0}
    tree = {
        "parts": [part | {"pad_mm": 4 * STENCIL_MM * ratio}],
        "size_mm": (50.0, 50.0),
        "seed": seed,
        "paste": {"step_mm": 0.1, "transfer": {"neighbours": 0.0}},
    }
    return np.array([*shares(ParametricBoard.model_validate(tree)).values()])


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.35, 0.42, 0.50, 0.58, 0.66, 1.0])
def test_mean_and_cv_of_4232_prints_are_within_two_points_of_the_documented_curves(
    ratio: float,
) -> None:
    share = np.concatenate([balls(ratio, seed) for seed in (0, 1)])
    mean = 1.0 - np.exp(-(ratio - 0.288) / 0.231)
    cv = np.sqrt(0.05**2 + (1.0 - mean) / (33.0 * mean))
    assert abs(share.mean() - mean) < 0.02
    assert abs(share.std() / share.mean() - cv) < 0.02
    # The same as a test of significance, five standard errors. That of a sample's CV, by the delta method with the moments of a
    # log-normal (skewness g, excess kurtosis k): cv sqrt((k + 2) / 4 + cv^2 - g cv) / sqrt(n).
    w = 1.0 + cv**2
    g, k = (w + 2.0) * np.sqrt(w - 1.0), w**4 + 2.0 * w**3 + 3.0 * w**2 - 6.0
    error = cv * np.sqrt((k + 2.0) / 4.0 + cv**2 - g * cv) / np.sqrt(len(share))
    # A 64-corner polygon's area ratio is 4e-4 above a circle's; the mean's slope there is at most 4.
    assert abs(share.mean() - mean) < 5 * cv * mean / np.sqrt(len(share)) + 4 * 4e-4
    assert abs(share.std() / share.mean() - cv) < 5 * error + 0.01 * cv


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "mean", "cv", "source"), PUBLISHED, ids=[str(row[0]) for row in PUBLISHED]
)
def test_prints_are_within_two_points_of_the_figures_that_the_curves_pass_through(
    ratio: float, mean: float, cv: float | None, source: str
) -> None:
    share = np.concatenate([balls(ratio, seed) for seed in (2, 3)])
    assert abs(share.mean() - mean) < 0.02, source
    if cv is not None:
        assert abs(share.std() / share.mean() - cv) < 0.02, source


def test_samples_are_the_prints_of_a_run_that_clogs_and_is_wiped() -> None:
    run = {"spread": 0.0, "clogging": 0.04, "wipe_every": 4, "after_wipe": 0.8}
    run |= {"recovery_prints": 1.5, "prints_since_wipe": 1}
    scene = scenes.load(
        "spi", {"board.paste.transfer": run, "board.paste.step_mm": 0.1, "board.defects": {}}
    )
    means, expected = [], []
    for number in range(9):
        board = scenes.realise(scene, number, seed=5).board
        assert isinstance(board, ParametricBoard)
        assert board.paste.transfer.print_number == number
        made = printed(board).deposits
        ratio = np.array([d.area_ratio for d in made])
        since = (1 + number) % 4
        fresh = 1.0 - np.exp(-(ratio - 0.288) / 0.231)
        series = fresh ** (1 + 0.04 * since) * (1 - 0.2 * np.exp(-since / 1.5))
        means.append(
            np.mean(
                [d.field.volume_mm3 / (d.pad.aperture.area * STENCIL_MM) for d in made if d.field]
            )
        )
        expected.append(series.mean())
    assert means == pytest.approx(expected, rel=1e-9)
    # Wiped before the fourth print of the run and every fourth after it.
    assert np.argsort(means)[:2].tolist() in ([3, 7], [7, 3])


def test_samples_are_no_run_without_wipes() -> None:
    scene = scenes.load("spi", {"board.paste.transfer.clogging": 0.1})
    numbers = {scenes.realise(scene, i).board.paste.transfer.print_number for i in range(3)}  # type: ignore[union-attr]
    assert numbers == {0}


def test_variants_of_one_light_are_one_print() -> None:
    scene = scenes.load("spi", {"board.paste.transfer.wipe_every": 10})
    board = scenes.realise(scene, 7, light_index=2).board
    assert board is not None and board.paste.transfer.print_number == 2


def test_most_special_name_of_a_part_decides_its_transfer() -> None:
    quiet = {"spread": 0.0}
    plain = few(transfer=quiet)
    packages = {
        name: {"mean": mean}
        for name, mean in (("bga", 0.7), ("0402", 0.8), ("R", 0.9), ("R1", 0.95))
    }
    own = few(transfer=quiet, packages=packages)
    factor = {name: own[name] / plain[name] for name in plain}
    assert factor["R1-1"] == pytest.approx(0.95)
    assert factor["C12-2"] == pytest.approx(0.8)
    assert factor["U1-3.4"] == pytest.approx(0.7)
    del packages["R1"]
    assert few(transfer=quiet, packages=packages)["R1-1"] == pytest.approx(0.9 * plain["R1-1"])


def test_spread_and_table_of_a_package_are_its_own() -> None:
    packages = {
        "chip": {"spread": 0.0},
        "U1": {"table": [{"area_ratio": 0.6, "efficiency": 1.1, "cv": 0.3}]},
    }
    many = [few(seed, packages=packages) for seed in range(12)]
    chip = np.array([m["C12-1"] for m in many])
    assert np.ptp(chip) < 1e-12
    ball = np.array([[v for name, v in m.items() if name.startswith("U1-")] for m in many])
    # 432 balls, of which neighbours share three tenths of the variance: at worst 12 independent prints of that part.
    error = 0.3 * np.sqrt(0.7 / 432 + 0.3 / 12)
    assert ball.mean() == pytest.approx(1.1, abs=5 * 1.1 * error)
    assert ball.std() / ball.mean() == pytest.approx(0.3, abs=5 * error)


@pytest.mark.parametrize(
    ("name", "hint"),
    [("bgaa", "did you mean 'bga'"), ("0804", "did you mean '0805'"), ("qfpx", "'qfp'")],
)
def test_unknown_package_is_refused_and_names_the_nearest(name: str, hint: str) -> None:
    with pytest.raises(SceneError) as caught:
        scenes.load("spi", {"board.paste.packages": {name: {}}, "board.parts.5.name": "R10"})
    assert hint in str(caught.value) and f"'{name}'" in str(caught.value)


def test_boards_from_files_name_pads_only() -> None:
    tree = {"folder": ".", "paste": {"packages": {"P12": {"mean": 0.9}, "P": {"spread": 1.2}}}}
    assert GerberBoard.model_validate(tree).paste.packages.keys() == {"P12", "P"}
    with pytest.raises((ImpossibleError, ValueError), match="names no parts: use P12"):
        GerberBoard.model_validate(tree | {"paste": {"packages": {"bga": {}}}})


def test_bad_value_of_a_package_is_refused_where_it_is() -> None:
    with pytest.raises(SceneError, match=r"board.paste.packages.bga.spread"):
        scenes.load("spi", {"board.paste.packages": {"bga": {"spread": -1.0}}})
