"""Features that an inspection machine reports: the height of a cap's apex, the height of a step.

Each feature is a fit over many pixels, made in the same way on measured and on true heights, so that the fit's own model
error cancels. x and y are the truth's: a pixel's ray is known, only the height along it is measured. Fits are robust
(Tukey's bisquare): a minority of wrong fringe orders does not move them; a uniformly biased region, such as a saturated
highlight, does shift the fit, which is intended.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenes.files.truth_maps import Truth

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A highlight is a part of the cap under another label, because it has another material.
CAP_LABELS = ("cap", "highlight")
STEP_LABEL = "step"
BASE_LABEL = "base"

# Close enough to the apex for a sphere to be a paraboloid (its quartic term is 1/4 of a^2/R^2 here, and cancels), wide
# enough to hold a tenth of the cap's pixels.
APEX_RADIUS = 0.35
# Pixels closer than this to an edge may mix two heights, sharp or blurred.
EDGE_PX = 2
# Directions within 10 degrees of a step's top belong to it; its sides, seen from above, do not.
TOP_COSINE = 0.985

# Tukey's constant: 95 % efficient on Gaussian noise.
BISQUARE = 4.685
# The median absolute deviation of a Gaussian is its standard deviation over this.
MAD_TO_SIGMA = 1.4826
FIT_STEPS = 25
# Steps this small compared with the noise no longer matter.
CONVERGED = 1e-4
# Heights that agree to a picometre are exact.
EXACT_MM = 1e-9


@dataclass(frozen=True)
class Feature:
    """One feature as measured and as it is, mm; None where too few valid pixels support the fit."""

    measured_mm: float | None
    truth_mm: float | None


def features(measured_mm: NDArray[np.floating[Any]], truth: Truth) -> dict[str, Feature]:
    """Every feature that the labels of the scene allow.

    Parameters
    ----------
    measured_mm
        (row, col) measured heights, NaN where not valid.
    truth
        Truth of the same scene and resolution.

    Returns
    -------
    dict of str to Feature
        ``cap_apex`` where there is a label ``cap``, ``step_height`` where there are ``step`` and ``base``.

    Notes
    -----
    ``cap_apex``: maximum of ``z = a + b x + c y + d x^2 + e x y + f y^2`` fitted to the points of the largest cap within
    0.35 of its radius from its true highest point, a ``highlight`` on it included.

    ``step_height``: difference in z, above the middle of the largest step's top, between a plane fitted to the top and one
    fitted to the ``base`` around it (2 px off the edges, out to half the step's width). Shadowed pixels are left out.
    """
    found = {}
    lit = truth.lit & np.isfinite(truth.height_mm)
    x, y = truth.xyz_mm[..., 0].astype(np.float64), truth.xyz_mm[..., 1].astype(np.float64)
    maps = measured_mm.astype(np.float64), truth.height_mm.astype(np.float64)
    if "cap" in truth.labels:
        near = _near_apex(truth, lit)
        found["cap_apex"] = Feature(*(_apex(x, y, z, near) for z in maps))
    if STEP_LABEL in truth.labels and BASE_LABEL in truth.labels:
        top, around = _top_and_around(truth, lit)
        found["step_height"] = Feature(*(_step(x, y, z, top, around) for z in maps))
    return found


def robust_fit(design: Floats, values: Floats) -> Floats | None:
    """Robust linear regression ``values ~ design @ coefficients``.

    Parameters
    ----------
    design
        (point, n) design matrix, finite.
    values
        (point,) values, finite.

    Returns
    -------
    ndarray of float64, (n,), or None
        Coefficients; None when the points do not determine them.

    Notes
    -----
    Tukey's bisquare by iteratively reweighted least squares, started from least absolute deviations: P. J. Huber and
    E. M. Ronchetti, Robust Statistics, 2nd ed., chapter 7.

    Examples
    --------
    >>> t = np.arange(30.0)
    >>> values = 1.0 + 2.0 * t
    >>> values[3] = 900.0
    >>> robust_fit(np.stack([np.ones_like(t), t], axis=1), values).round(6).tolist()
    [1.0, 2.0]
    """
    count = design.shape[1]
    # With hardly more points than coefficients, the residuals do not show the noise.
    if len(design) < 3 * count or np.linalg.matrix_rank(design) < count:
        return None
    # In an orthonormal basis the normal equations lose nothing, and are small.
    basis, to_basis = np.linalg.qr(design)
    weights = np.ones(len(values))
    inner = np.zeros(count)
    for robust in (False, True):
        fitted = np.zeros(0)
        for _ in range(FIT_STEPS):
            weighted = basis * weights[:, None]
            inner, before = np.linalg.solve(weighted.T @ basis, weighted.T @ values), fitted
            fitted = basis @ inner
            residual = np.abs(values - fitted)
            scale = MAD_TO_SIGMA * float(np.median(residual))
            if scale < EXACT_MM:
                break
            if robust:
                weights = np.clip(1.0 - (residual / (BISQUARE * scale)) ** 2, 0.0, None) ** 2
            else:
                weights = 1.0 / np.maximum(residual, 1e-3 * scale)
            if before.size and np.abs(fitted - before).max() < CONVERGED * scale:
                break
    return np.asarray(np.linalg.solve(to_basis, inner))


def _near_apex(truth: Truth, lit: Mask) -> Mask:
    cap = np.zeros(lit.shape, dtype=np.bool_)
    for label in CAP_LABELS:
        if label in truth.labels:
            cap |= truth.region(label)
    cap = _largest(cap & lit)
    if not cap.any():
        return cap
    x, y, z = (truth.xyz_mm[cap][:, i].astype(np.float64) for i in range(3))
    # A uniform disk's root mean square distance from its centre is its radius over the square root of 2.
    radius = np.sqrt(2.0 * (x.var() + y.var()))
    top = int(np.argmax(z))
    near = np.zeros_like(cap)
    near[cap] = np.hypot(x - x[top], y - y[top]) <= APEX_RADIUS * radius
    return near


def _apex(x: Floats, y: Floats, z: Floats, near: Mask) -> float | None:
    use = near & np.isfinite(z)
    if not use.any():
        return None
    # The window, not what is left of it, sets the frame: measured and true fits share it.
    cx, cy, scale = x[near].mean(), y[near].mean(), float(np.hypot(x[near].std(), y[near].std()))
    u, v = (x[use] - cx) / (scale or 1.0), (y[use] - cy) / (scale or 1.0)
    fit = robust_fit(np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1), z[use])
    if fit is None:
        return None
    hessian = np.array([[2.0 * fit[3], fit[4]], [fit[4], 2.0 * fit[5]]])
    if np.linalg.eigvalsh(hessian).max() >= 0.0:
        return None
    u0, v0 = np.linalg.solve(hessian, -fit[1:3])
    # The edge of a uniform disk is the square root of 2 of these units from its centre; an apex beyond it was not seen.
    if np.hypot(u0, v0) > np.sqrt(2.0):
        return None
    return float(fit[0] + 0.5 * (fit[1] * u0 + fit[2] * v0))


def _top_and_around(truth: Truth, lit: Mask) -> tuple[Mask, Mask]:
    step = _largest(truth.region(STEP_LABEL) & lit)
    if not step.any():
        return step, step
    direction = np.median(truth.normal[step], axis=0)
    direction = direction / np.linalg.norm(direction)
    top = step & (truth.normal @ direction > TOP_COSINE)
    width_px = np.sqrt(float(step.sum()))
    distance = ndimage.distance_transform_edt(~step)
    base = _inner(truth.region(BASE_LABEL) & lit)
    return _inner(top), base & (distance > EDGE_PX) & (distance <= max(width_px / 2, 5 * EDGE_PX))


def _step(x: Floats, y: Floats, z: Floats, top: Mask, around: Mask) -> float | None:
    if not top.any():
        return None
    cx, cy = x[top].mean(), y[top].mean()
    planes = []
    for mask in (top, around):
        use = mask & np.isfinite(z)
        design = np.stack([np.ones(int(use.sum())), x[use] - cx, y[use] - cy], axis=1)
        planes.append(robust_fit(design, z[use]))
    upper, lower = planes
    return None if upper is None or lower is None else float(upper[0] - lower[0])


def _inner(mask: Mask) -> Mask:
    """The mask without its pixels within `EDGE_PX` of an edge; the image's frame is no edge."""
    eroded = ndimage.binary_erosion(
        mask, np.ones((3, 3), np.bool_), iterations=EDGE_PX, border_value=1
    )
    return np.asarray(eroded, dtype=np.bool_)


def _largest(mask: Mask) -> Mask:
    """The largest connected piece of a mask."""
    pieces, count = ndimage.label(mask)
    if count < 2:
        return mask
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    return np.asarray(pieces == sizes.argmax(), dtype=np.bool_)
