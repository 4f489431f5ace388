"""Where a decoder errs in a case: maps over the image, and the place of a failure in words."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.gate.regression import GROSS_RAD, SILENT_SIGMAS, UNLIT, JudgedFigure
from fringebench.gate.cases import Case

Floats = NDArray[np.float64]
# So many of a case's worst pixels are listed.
PIXELS = 5
SHARES = ("missing", "silent", "wrong_order")


@dataclass(frozen=True, eq=False)
class ErrorMaps:
    """Mean error in mm, NaN where no repeat is valid, and shares of the repeats in which a pixel is wrong; (row, col)."""

    error_mm: Floats
    missing: Floats
    silent: Floats
    wrong_order: Floats

    @classmethod
    def of(cls, case: Case, height_mm: Floats, sigma_mm: Floats) -> "ErrorMaps":
        """From heights and sigmas (repeat, row, col) of a case, heights NaN where not valid."""
        error = height_mm - case.height_mm
        valid = np.isfinite(height_mm)
        silent = valid & ~(np.abs(error) <= SILENT_SIGMAS * sigma_mm)
        gross = valid & ~(np.abs(error) <= GROSS_RAD * case.mm_per_rad)
        seen = np.isfinite(error)
        count = np.maximum(seen.sum(axis=0), 1)
        mean = np.where(seen.any(axis=0), np.where(seen, error, 0.0).sum(axis=0) / count, np.nan)
        return cls(mean, 1.0 - valid.mean(axis=0), silent.mean(axis=0), gross.mean(axis=0))

    def to_arrays(self) -> dict[str, NDArray[np.float32]]:
        """As arrays for a file."""
        return {name: np.asarray(values, np.float32) for name, values in vars(self).items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> "ErrorMaps":
        """From the arrays of a file."""
        names = ("error_mm", *SHARES)
        return cls(*(np.asarray(arrays[name], np.float64) for name in names))

    def of_metric(self, metric: str) -> Floats:
        """The map (row, col) that shows where a figure is bad."""
        if metric == "invented_fraction":
            return 1.0 - self.missing
        for name in SHARES:
            if metric == f"{name}_fraction":
                return np.asarray(getattr(self, name))
        return np.abs(self.error_mm)


@dataclass(frozen=True)
class WorstPixel:
    """Where a case failed most, and what the camera saw there."""

    case: str
    region: str
    row: int
    col: int
    true_mm: float | None
    """True height; None where the camera sees nothing."""
    error_mm: float | None
    """Mean error over the repeats; None where no repeat is valid."""
    counts_dn: tuple[tuple[float, ...], ...]
    """Digital numbers (exposure, frame) in the first repeat."""


def worst_pixels(
    cases: Iterable[Case], failed: Iterable[JudgedFigure], maps: Mapping[str, ErrorMaps], seed: int
) -> tuple[WorstPixel, ...]:
    """The worst pixel of each figure that failed, at most `PIXELS` a case; counts are those with the noise of `seed`."""
    rows = list(failed)
    found: list[WorstPixel] = []
    for case in cases:
        seen = maps[case.name]
        places: dict[tuple[int, int], str] = {}
        for row in (row for row in rows if row.case == case.name):
            values = seen.of_metric(row.metric)
            there = region_of(case, row.region) & np.isfinite(values)
            if there.any():
                at = np.argmax(np.where(there, values, -np.inf))
                y, x = map(int, np.unravel_index(at, values.shape))
                places.setdefault((y, x), row.region)
        frames = case.stack(seed).frames if places else None
        for (y, x), region in list(places.items())[:PIXELS]:
            assert frames is not None
            true, error = float(case.height_mm[y, x]), float(seen.error_mm[y, x])
            found.append(
                WorstPixel(
                    case.name,
                    region,
                    y,
                    x,
                    true if np.isfinite(true) else None,
                    error if np.isfinite(error) else None,
                    tuple(tuple(map(float, exposure)) for exposure in frames[:, :, y, x]),
                )
            )
    return tuple(found)


def region_of(case: Case, name: str) -> NDArray[np.bool_]:
    """Pixels (row, col) of a region of a case, the unlit ones included."""
    return case.unlit if name == UNLIT else case.regions[name]


def place(case: Case, region: str, values: Floats) -> str:
    """Where in a region a map (row, col) is largest, in words.

    >>> from fringebench.gate.cases import suite
    >>> case = suite(("sweep",))[0]
    >>> values = np.zeros(case.height_mm.shape)
    >>> values[5:9, 40:50] = 1.0
    >>> place(case, "ratio-0.90", values)
    'rows 5 to 8, columns 40 to 49'
    """
    mask = region_of(case, region)
    bad = mask & (values > 0.0)
    # Without a value above 0 nowhere is worse than elsewhere.
    bad = bad & (values >= 0.5 * np.percentile(values[bad], 99.0)) if bad.any() else mask
    # The middle 90 %: single pixels elsewhere do not stretch the place.
    rows, cols = (np.percentile(axis, [5, 95], method="nearest") for axis in np.nonzero(bad))
    around = [np.percentile(axis, [5, 95], method="nearest") for axis in np.nonzero(mask)]
    whole = all(np.ptp(a) >= 0.8 * np.ptp(b) for a, b in zip((rows, cols), around, strict=True))
    where = f"rows {rows[0]} to {rows[1]}, columns {cols[0]} to {cols[1]}"
    return f"throughout the region, {where}" if whole else where
