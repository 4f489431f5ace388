"""Small truths of known shape and reconstructions of known error."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from scenes.truth import Truth

PIXEL_MM = 0.1


Grid = Callable[[tuple[int, int]], tuple[NDArray[np.float64], NDArray[np.float64]]]


@pytest.fixture(scope="session")
def grid() -> Grid:
    """World x and y in mm of a telecentric camera's pixel centres, the origin in the image's middle."""
    return _grid


@pytest.fixture(scope="session")
def truth_of() -> Callable[..., Truth]:
    """Truth seen from straight above: heights, label -> mask (later ones win), lit by one projector."""
    return _truth


def _grid(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows, cols = shape
    x = (np.arange(cols) + 0.5 - cols / 2) * PIXEL_MM
    y = -(np.arange(rows) + 0.5 - rows / 2) * PIXEL_MM
    return np.broadcast_to(x, shape).copy(), np.broadcast_to(y[:, None], shape).copy()


def _truth(
    height_mm: ArrayLike,
    labels: Mapping[str, ArrayLike] | None = None,
    lit: ArrayLike = True,
    scene: str = 'name = "synthetic"',
) -> Truth:
    height = np.asarray(height_mm, np.float32)
    x, y = _grid((height.shape[0], height.shape[1]))
    masks = labels or {"base": True}
    label = np.zeros(height.shape, np.uint16)
    for i, mask in enumerate(masks.values()):
        label[np.broadcast_to(mask, height.shape)] = i + 1
    xyz = np.stack([x.astype(np.float32), y.astype(np.float32), height], axis=-1)
    normal = np.zeros_like(xyz)
    normal[..., 2] = 1.0
    one = np.ones((1, *height.shape), np.float32)
    shone = np.broadcast_to(lit, one.shape).astype(np.bool_)
    return Truth(xyz, normal, label, tuple(masks), shone, one, one, one, scene)
