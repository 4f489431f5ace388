"""Whether a reconstruction and a truth belong together: the same scene and rig, the same unit."""

import warnings

import numpy as np
from numpy.typing import NDArray

from decode import Reconstruction
from scenes.files.truth_maps import Truth
from scenes.support.errors import FringebenchWarning, ScoreError

# Unit that heights may be in by mistake -> its size in mm.
UNITS_MM = {"metres": 1000.0, "inches": 25.4, "micrometres": 0.001}
# Heights above this share of the highest show the unit; those near zero look the same in every unit.
HIGH = 0.25
MINIMUM_PIXELS = 30
UNIT_TOLERANCE = 0.1


def differing_parts(rec: Reconstruction, truth: Truth) -> dict[str, tuple[str, str]]:
    """Parts of scene and rig in which both differ: part -> digests of the reconstruction's and of the truth's.

    ``camera second_camera projectors objects board materials``; empty also if one of the two does not know its digests.
    """
    return {
        part: (digest, truth.identity[part])
        for part, digest in rec.identity.items()
        if truth.identity.get(part, digest) != digest
    }


def require_same_scene(rec: Reconstruction, truth: Truth, force: bool) -> tuple[str, ...]:
    """The parts that differ, where that was forced; raises `ScoreError` for them otherwise.

    Warns if a file that names its scene is of a version that kept no digests, so that nothing was compared.
    """
    differing = differing_parts(rec, truth)
    if differing and not force:
        parts = ", ".join(f"{part} ({a}, {b})" for part, (a, b) in differing.items())
        raise ScoreError(
            f"the reconstruction and the truth are of different scenes: they differ in {parts} (digests of the two); give the "
            "truth of the same scene (render --truth), or --force"
        )
    for name, file in (("reconstruction", rec), ("truth", truth)):
        if rec.scene and truth.scene and not file.identity:
            warnings.warn(
                f"whether reconstruction and truth are of one scene is not known: the {name} is of a version without digests; "
                "make it again to have them compared",
                FringebenchWarning,
                stacklevel=3,
            )
    return tuple(differing)


def other_unit(measured_mm: NDArray[np.floating], true_mm: NDArray[np.floating]) -> str:
    """``metres``, ``inches`` or ``micrometres`` if the extent says that heights (row, col) are in it by mistake, else
    empty.

    >>> true = np.linspace(0.0, 5.0, 100).reshape(10, 10)
    >>> other_unit(true / 1000.0, true)
    'metres'
    """
    known = np.isfinite(measured_mm) & np.isfinite(true_mm)
    if not known.any():
        return ""
    high = known & (np.abs(true_mm) > HIGH * np.abs(true_mm[known]).max())
    if int(high.sum()) < MINIMUM_PIXELS:
        return ""
    ratio = float(np.median(measured_mm[high].astype(np.float64) / true_mm[high]))
    for unit, size_mm in UNITS_MM.items():
        if abs(ratio * size_mm - 1.0) < UNIT_TOLERANCE:
            return unit
    return ""
