"""What is said of outliers, next to the tables."""

from dataclasses import fields
from typing import Any

import pytest

from evaluation import RegionScore, Score, UnlitScore
from fringebench.pages.score_tables import outliers_in_words


def score(**shares: tuple[float | None, float | None]) -> Score:
    """Regions with shares beyond the sensor's sigma, and beyond that of all causes."""
    blank: dict[str, Any] = dict.fromkeys(field.name for field in fields(RegionScore))
    regions = {
        label: RegionScore(
            **blank
            | {
                "pixels": 9,
                "predicted_sd_mm": 1e-3,
                "outlier_fraction": one,
                "total_outlier_fraction": two,
            }
        )
        for label, (one, two) in shares.items()
    }
    return Score("", regions, {}, UnlitScore(0, 0))


def test_outliers_of_the_sensors_noise_name_the_way_to_predict_them() -> None:
    said = outliers_in_words(score(mask=(0.002, None), solder=(0.082, None)))
    assert said is not None
    assert "8.20% (solder)" in said and "--uncertainty by-cause" in said


@pytest.mark.parametrize("share", [0.0, 0.005, None])
def test_few_outliers_are_not_spoken_of(share: float | None) -> None:
    assert outliers_in_words(score(base=(share, None))) is None


def test_outliers_of_all_causes_are_named_by_region() -> None:
    said = outliers_in_words(score(mask=(0.2, 0.0012), solder=(0.3, 0.0)))
    assert said == "beyond 5 sigma of all causes: mask 0.12%, solder 0.00%"
