"""Small truths of known shape, seen from straight above."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.files.truth_maps import Truth

PIXEL_MM = 0.1

Floats = NDArray[np.float64]
Grid = Callable[[tuple[int, int]], tuple[Floats, Floats]]
TruthMaker = Callable[..., Truth]


def synthetic_grid(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows, cols = shape
    x = (np.arange(cols) + 0.5 - cols / 2) * PIXEL_MM
    y = -(np.arange(rows) + 0.5 - rows / 2) * PIXEL_MM
    return np.broadcast_to(x, shape).copy(), np.broadcast_to(y[:, None], shape).copy()


def synthetic_truth(
    height_mm: ArrayLike,
    labels: Mapping[str, ArrayLike] | None = None,
    lit: ArrayLike = True,
    scene: str = 'name = "synthetic"',
) -> Truth:
    height = np.asarray(height_mm, np.float32)
    x, y = synthetic_grid((height.shape[0], height.shape[1]))
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
