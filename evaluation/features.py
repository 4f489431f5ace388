"""What an inspection machine reports of a part: the height of a cap's apex, the height of a step.

Each figure is a fit over many pixels, made in the same way on measured and on true heights, so that what the fit
itself leaves out cancels. Heights stand at the truth's x and y: a pixel's ray is known, only the height along it is
measured. Fits are robust (Tukey's bisquare): a minority of wrong fringe orders does not move them, a region that is
wrong as a whole, as a saturated highlight is, does, and shall.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenes.truth import Truth

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A cap may carry a highlight: the part of it under another label, for another material.
CAP_LABELS = ("cap", "highlight")
STEP_LABEL = "step"
BASE_LABEL = "base"

# Near enough to the apex for a sphere to be a paraboloid (its quartic term is 1/4 of a^2/R^2 here, and cancels), far
# enough to hold a tenth of the cap's pixels.
APEX_RADIUS = 0.35
# Pixels nearer than this to an edge may mix heights or lie in another's blur.
EDGE_PX = 2
# Directions within 10 degrees of a step's top belong to it; its sides, seen from above, do not.
TOP_COSINE = 0.985

# Tukey's constant: 95 % efficient on Gaussian noise.
BISQUARE = 4.685
# The median absolute deviation of a Gaussian is its standard deviation over this.
MAD_TO_SIGMA = 1.4826
FIT_STEPS = 25
# Steps this small against the noise no longer matter.
CONVERGED = 1e-4
# Heights that agree to a picometre are exact.
EXACT_MM = 1e-9


@dataclass(frozen=True)
class Feature:
    """One figure as measured and as it is; None where too few valid pixels support the fit."""

    measured_mm: float | None
    truth_mm: float | None


def features(measured_mm: NDArray[np.floating[Any]], truth: Truth) -> dict[str, Feature]:
    """Every feature that the scene's labels offer, from heights (row, col) in mm that are NaN where not valid.

    ``cap_apex`` (label ``cap``): maximum of ``z = a + b x + c y + d x^2 + e x y + f y^2`` fitted to the points of the
    largest cap within 0.35 of its radius from its true highest point, a ``highlight`` on it included.

    ``step_height`` (label ``step``): difference in z, above the middle of the largest step's top, between a plane fitted
    to the top and one fitted to the ``base`` around it (2 px off the edges, out to half the step's width). Shadowed
    pixels take no part.
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
    """Coefficients (n,) of ``values ~ design @ coefficients`` by Tukey's bisquare from a least absolute deviations start.

    `design` is (points, n), finite. None when the points do not determine the coefficients. P. J. Huber and
    E. M. Ronchetti, Robust Statistics, 2nd ed., chapter 7 (iteratively reweighted least squares).
    """
    count = design.shape[1]
    # A fit that has hardly more points than coefficients says nothing of its own noise.
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
    # A uniform disk's edge lies the square root of 2 of these units from its centre; a top beyond it was not seen.
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
    """The mask without its pixels within `EDGE_PX` of an edge; the frame of the image is none."""
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
