"""Fixtures that make truths of known shape."""

import pytest

from tests.evaluation.synthetic_truth import Grid, TruthMaker, synthetic_grid, synthetic_truth


@pytest.fixture(scope="session")
def grid() -> Grid:
    """World x and y in mm of a telecentric camera's pixel centres, the origin in the middle of the image."""
    return synthetic_grid


@pytest.fixture(scope="session")
def truth_of() -> TruthMaker:
    """Truth from heights and label -> mask (later ones win), lit by one projector."""
    return synthetic_truth
