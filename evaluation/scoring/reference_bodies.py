"""Acceptance measures of optical 3-D systems: spheres and planes fitted to measured points.

After VDI/VDE 2634 part 2 (2012) and ISO 10360-13 (2021): probing error of form (range of the distances from the least-squares
sphere) and of size (its diameter against the calibrated one), sphere distance (centres), flatness (range of the distances
from the least-squares plane). VDI/VDE lets three in a thousand points be left out; ISO's D95 is the spread of the best 95 %.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.support.errors import ScoreError

Points = NDArray[np.float64]

# VDI/VDE 2634-2: points that may be discarded.
DISCARD = 0.003
D95 = 0.95
FEWEST_POINTS = 50
ITERATIONS = 50
CONVERGED = 1e-12


@dataclass(frozen=True)
class FittedSphere:
    """The least-squares sphere of some points."""

    centre_mm: Points
    """(3,) centre, world mm."""
    radius_mm: float
    form_mm: float
    """Range of the radial deviations of all but the three worst in a thousand points."""
    form95_mm: float
    """Length of the shortest interval that holds 95 % of the radial deviations."""
    sigma_mm: float
    """Standard deviation of the radial deviations."""
    points: int


@dataclass(frozen=True)
class FittedPlane:
    """The least-squares plane of some points."""

    centre_mm: Points
    """(3,) centroid of the points, world mm."""
    normal: Points
    """(3,) unit normal."""
    flatness_mm: float
    """Range of the distances of all but the three worst in a thousand points."""
    flatness95_mm: float
    """Length of the shortest interval that holds 95 % of the distances."""
    sigma_mm: float
    points: int


def fit_sphere(points_mm: NDArray[np.floating]) -> FittedSphere:
    """Fit a sphere to points by geometric least squares.

    Parameters
    ----------
    points_mm
        (point, 3) points in mm; those that are not finite are ignored.

    Returns
    -------
    FittedSphere
        Of all but the worst three in a thousand points.

    Raises
    ------
    ScoreError
        For fewer than 50 points, or coplanar points.

    Notes
    -----
    Gauss-Newton iterations from the algebraic sphere.

    Examples
    --------
    >>> x = np.random.default_rng(0).normal(size=(500, 3))
    >>> round(fit_sphere(7.0 * x / np.linalg.norm(x, axis=1, keepdims=True) + 1.0).radius_mm, 9)
    7.0
    """
    points = _enough(points_mm, "sphere")
    centre, radius = _sphere(points)
    kept = _best(points, np.linalg.norm(points - centre, axis=1) - radius)
    centre, radius = _sphere(kept)
    off = np.linalg.norm(kept - centre, axis=1) - radius
    return FittedSphere(
        centre, radius, float(np.ptp(off)), shortest_range(off, D95), float(off.std()), len(kept)
    )


def fit_plane(points_mm: NDArray[np.floating]) -> FittedPlane:
    """Fit a plane to points by orthogonal least squares.

    Parameters
    ----------
    points_mm
        (point, 3) points in mm; those that are not finite are ignored.

    Returns
    -------
    FittedPlane
        Of all but the worst three in a thousand points.

    Raises
    ------
    ScoreError
        For fewer than 50 points.
    """
    points = _enough(points_mm, "plane")
    kept = _best(points, _plane(points)[2])
    centre, normal, off = _plane(kept)
    return FittedPlane(
        centre, normal, float(np.ptp(off)), shortest_range(off, D95), float(off.std()), len(kept)
    )


def shortest_range(values: Points, share: float) -> float:
    """Length of the shortest interval that holds a share in (0, 1] of the values (n,).

    >>> shortest_range(np.array([0.0, 1.0, 1.5, 2.0, 9.0]), 0.6)
    1.0
    """
    ordered = np.sort(values)
    count = max(1, int(np.ceil(share * ordered.size)))
    return float((ordered[count - 1 :] - ordered[: ordered.size - count + 1]).min())


def expected_range(count: int) -> float:
    """Expected range, in sigmas, of `count` Gaussian values, after the worst three in a thousand are discarded.

    Extremes are near the quantile at one in `count` (Blom 1958); with 0.3 % discarded, near the quantile at 0.15 %.

    >>> round(expected_range(100_000), 2)
    5.94
    """
    from scipy.stats import norm

    tail = max((1.0 - 0.375) / (count + 0.25), DISCARD / 2.0)
    return float(2.0 * norm.isf(tail))


def _enough(points_mm: NDArray[np.floating], what: str) -> Points:
    points = np.asarray(points_mm, dtype=np.float64)
    points = points[np.isfinite(points).all(axis=-1)]
    if len(points) < FEWEST_POINTS:
        raise ScoreError(
            f"a {what} has {len(points)} measured points, {FEWEST_POINTS} are needed: raise the camera's resolution, or "
            "see why pixels are rejected"
        )
    return points


def _best(points: Points, off: Points) -> Points:
    kept = len(points) - int(DISCARD * len(points))
    return np.asarray(points[np.argsort(np.abs(off - np.median(off)))[:kept]])


def _sphere(points: Points) -> tuple[Points, float]:
    middle = points.mean(axis=0)
    local = points - middle
    scale = float(np.abs(local).max())
    local = local / scale
    design = np.column_stack([2.0 * local, np.ones(len(local))])
    if np.linalg.matrix_rank(design, tol=1e-9 * len(local)) < 4:
        raise ScoreError("the points of a sphere are on a plane: they do not determine a radius")
    solution = np.linalg.lstsq(design, (local**2).sum(axis=1), rcond=None)[0]
    centre = solution[:3]
    radius = float(np.sqrt(solution[3] + centre @ centre))
    for _ in range(ITERATIONS):
        away = local - centre
        distance = np.linalg.norm(away, axis=1)
        jacobian = np.column_stack([-away / distance[:, None], -np.ones(len(local))])
        step = np.linalg.lstsq(jacobian, radius - distance, rcond=None)[0]
        centre, radius = centre + step[:3], radius + float(step[3])
        if np.abs(step).max() < CONVERGED:
            break
    return middle + centre * scale, radius * scale


def _plane(points: Points) -> tuple[Points, Points, Points]:
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    return centre, normal, (points - centre) @ normal
