"""Light of a projector whose pixels are dimmed by a mask, from light that was traced without it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from render.transport import Transport
from scenes.acquisition.fringe_fit import fringe_solution
from scenes.files.truth_maps import Truth
from scenes.support.errors import RenderError

# Standard deviation of uniform light over a pixel's width.
SQUARE = 1.0 / np.sqrt(12.0)
# Narrowest width of an origin of indirect light, projector px; each of the next is twice as wide.
NARROW_PX = 4.0


def masked(transport: Transport, truth: Truth, masks: Sequence[NDArray[np.floating]]) -> Transport:
    """The light under masks, one for each projector.

    Parameters
    ----------
    transport
        Light traced without masks, of patterns with a fringe set of three steps or more.
    truth
        Where in the projectors each camera pixel's point is.
    masks
        Of each projector, levels (row, col) of its pixels, 0 to 1, which multiply every pattern.

    Returns
    -------
    Transport
        `total` and `direct` dimmed; ambient light is not.

    Raises
    ------
    RenderError
        Masks that are not those of the projectors, or patterns without a fringe set.

    Notes
    -----
    Direct light is dimmed by the mask at the point's projector pixel, blurred by the projector's point spread and by the
    footprint of a camera pixel (its median over the image). Indirect light comes from elsewhere: the traced patterns know from
    where along their axis, by its coarsest fringe. Its phase is the mean coordinate; its contrast, relative to that of direct
    light, is taken as that of a Gaussian around it, ``exp(-2 (pi s / P)^2)`` for standard deviation s and period P. Across the axis
    the same width around the pixel's own coordinate is assumed. One level dims all patterns of a pixel: what a mask that
    changes within a footprint or the origin of indirect light does to a fringe's phase is left out.

    Examples
    --------
    >>> import numpy as np, scenes, render
    >>> light = render.trace(scenes.load("step", {"camera.resolution": [32, 24]}), samples=2)
    >>> half = masked(light, render.truth(light.scene), [np.full((768, 1024), 0.5)])
    >>> bool(np.allclose(half.total, 0.5 * light.total))
    True
    """
    sizes = [p.resolution[::-1] for p in transport.scene.projectors]
    if [np.shape(mask) for mask in masks] != sizes:
        raise RenderError(
            f"masks have shapes {[np.shape(mask) for mask in masks]}: the projectors' (rows, columns) are {sizes}"
        )
    total, direct = transport.total.copy(), transport.direct.copy()
    for p, mask in enumerate(masks):
        at = np.stack([truth.rows_px[p], truth.columns_px[p]]).astype(np.float64)
        steps = [np.hypot(*np.gradient(image)) for image in at]
        footprint = float(np.nanmedian(steps)) if np.isfinite(steps).any() else 1.0
        sharp = np.hypot(transport.scene.projectors[p].psf_sigma_px, SQUARE * max(footprint, 1.0))
        widths = NARROW_PX * 2.0 ** np.arange(np.ceil(np.log2(max(mask.shape) / NARROW_PX)))
        blurred = _blurred(mask, np.hypot(sharp, [0.0, *widths]))
        centre, width = _origin(transport, p, at)
        near = np.clip(np.log2(np.maximum(width, 1e-3) / NARROW_PX) + 1.0, 0.0, len(widths))
        own, others = (
            _levels(blurred, where, which)
            for where, which in ((at, np.zeros_like(near)), (centre, near))
        )
        indirect = transport.total[p] - transport.direct[p]
        direct[p] = transport.direct[p] * own
        total[p] = direct[p] + indirect * others
    return replace(transport, total=total, direct=direct)


def _blurred(mask: NDArray[np.floating], widths_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """The mask (width, row, col) behind Gaussian blurs; at its borders it is continued by its mirror image."""
    # Waves of the cosine transform: wide kernels would take minutes.
    waves = fft.dctn(np.asarray(mask, np.float64))
    f2 = np.add.outer(*((np.arange(n) / n) ** 2 for n in mask.shape))
    return np.stack([fft.idctn(waves * np.exp(-0.5 * (np.pi * w) ** 2 * f2)) for w in widths_px])


def _levels(
    blurred: NDArray[np.float64], at: NDArray[np.float64], which: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Levels at projector coordinates (row, column; ...) of the mask blurred `which` times; the mask's mean where unknown."""
    found = ndimage.map_coordinates(
        blurred, [which, *(np.nan_to_num(at) - 0.5)], order=1, mode="nearest"
    )
    known = np.isfinite(at).all(axis=0)
    return np.where(known, found, blurred[0].mean()).astype(np.float32)


def _origin(
    transport: Transport, projector: int, at: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean projector coordinate (row, column; ...) and width in projector px of each pixel's indirect light."""
    frames = transport.scene.patterns.frames()
    fringes = [f for f in frames if f.kind == "fringe"]
    if not fringes:
        raise RenderError("masked light needs traced fringes: its patterns are codes alone")
    coarse = max(fringes, key=lambda f: f.period_px)
    mine = [
        i
        for i, f in enumerate(frames)
        if f in fringes and f.period_px == coarse.period_px and f.axis == coarse.axis
    ]
    solve = fringe_solution([frames[i].phase_shift_rad for i in mine])
    if solve is None:
        raise RenderError(
            f"masked light needs three phase shifts of the {coarse.period_px:g} px fringe"
        )
    total, direct = (
        transport.frames(projector, only)[mine] - transport.ambient for only in (False, True)
    )
    offset, cosine, sine = np.tensordot(solve, total - direct, axes=1)
    own = np.tensordot(solve, direct, axes=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        full = np.nanmedian(np.hypot(own[1], own[2]) / own[0])
        contrast = np.clip(np.hypot(cosine, sine) / (full * offset), 1e-6, 1.0)
    along = ("row", "column").index(coarse.axis)
    period = coarse.period_px
    mean = np.arctan2(sine, cosine) * period / (2.0 * np.pi)
    centre = at.copy()
    centre[along] = mean + period * np.round((at[along] - mean) / period)
    width = period / (2.0 * np.pi) * np.sqrt(-2.0 * np.log(contrast))
    return centre, np.nan_to_num(width)
