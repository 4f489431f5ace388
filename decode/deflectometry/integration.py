"""From normals to the surface: distances along the camera's rays whose chords are at right angles to the normals.

Two neighbours' mean normal is at right angles to the chord between their points, exactly on spheres and parabolas' vertical
sections: ``(n_i + n_j) . (p_j - p_i) = 0`` with ``p = o + t d``. That is linear in the unknown distances t whatever the
camera, so perspective and lens distortion need no correction. All neighbours together are more equations than unknowns,
solved by least squares, as zonal integration of slopes is (W. H. Southwell, J. Opt. Soc. Am. 70, 998 (1980); L. Huang,
M. Idir, C. Zuo, A. Asundi, Review of phase measuring deflectometry, Opt. Lasers Eng. 107, 247 (2018)).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu

from decode.deflectometry.reflection import Rays

Floats = NDArray[np.float64]
Counts = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Patches:
    """Pixels to integrate over, in connected patches, and their pairs of neighbours."""

    patch: Counts
    """(pixel,) number of each pixel's patch, from 0."""
    pairs: Counts
    """(pair, 2) numbers of pixels."""

    @classmethod
    def of(cls, mask: NDArray[np.bool_]) -> "Patches":
        """Patches of an image's pixels (row, col); pixels are numbered in row order."""
        number = np.full(mask.shape, -1)
        number[mask] = np.arange(int(mask.sum()))
        pairs = [
            np.stack([a[both], b[both]], axis=-1)
            for a, b in ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:]))
            for both in [(a >= 0) & (b >= 0)]
        ]
        return cls(ndimage.label(mask)[0][mask].astype(np.intp) - 1, np.concatenate(pairs))

    @property
    def count(self) -> int:
        """Number of patches."""
        return int(self.patch.max()) + 1


@dataclass(frozen=True, eq=False)
class Integration:
    """The equations of given normals, whose solution is free in one number per patch."""

    patches: Patches
    rays: Rays
    normal: Floats
    """(pixel, 3)."""

    def distances(self, height_mm: Floats, weight: Floats) -> Floats:
        """Distances (pixel,) along the rays whose heights are nearest to known ones (pixel,), by weight (pixel,)."""
        particular = self._solve(self._right[:, None])
        rest = (height_mm - self.rays.points(particular[:, 0])[:, 2])[:, None]
        return np.asarray((particular + self._nearest(rest, weight))[:, 0])

    def noise(self, point: Floats, change: Floats, height_mm: Floats, weight: Floats) -> Floats:
        """First-order changes of the distances at surface points, (pixel, sample), where normals change by (pixel, 3, sample)
        and known heights by (pixel, sample).
        """
        i, j = self.patches.pairs.T
        own = self._solve(-np.einsum("pk,pks->ps", point[j] - point[i], change[i] + change[j]))
        return own + self._nearest(height_mm - own * self.rays.direction[:, 2:], weight)

    def _nearest(self, rest_mm: Floats, weight: Floats) -> Floats:
        """Of each patch, the multiple of the free solution whose heights are nearest to (pixel, sample)."""
        rise, patch = self._free * self.rays.direction[:, 2], self.patches.patch
        square = np.bincount(patch, weight * rise**2)
        sums = [np.bincount(patch, weight * rise * column) for column in rest_mm.T]
        return np.asarray(self._free[:, None] * (np.stack(sums, axis=-1) / square[:, None])[patch])

    @cached_property
    def _fixed(self) -> Counts:
        """The first pixel of each patch."""
        return np.unique(self.patches.patch, return_index=True)[1]

    @cached_property
    def _free(self) -> Floats:
        """(pixel,) solution without a right side in which each patch's first pixel is 1."""
        one = np.zeros((len(self.normal), 1))
        one[self._fixed] = 1.0
        return np.asarray((one + self._solve(-(self._matrix @ one)))[:, 0])

    @cached_property
    def _matrix(self) -> Any:
        """(pair, pixel)."""
        i, j = self.patches.pairs.T
        mean, d = self.normal[i] + self.normal[j], self.rays.direction
        values = np.concatenate([(mean * d[j]).sum(-1), -(mean * d[i]).sum(-1)])
        at = np.tile(np.arange(len(i)), 2)
        shape = (len(i), len(self.normal))
        return sparse.csc_matrix((values, (at, np.concatenate([j, i]))), shape)

    @property
    def _right(self) -> Floats:
        i, j = self.patches.pairs.T
        ahead = self.rays.origin_mm[i] - self.rays.origin_mm[j]
        return np.asarray(((self.normal[i] + self.normal[j]) * ahead).sum(-1))

    @cached_property
    def _others(self) -> tuple[NDArray[np.bool_], Any, Any]:
        """Which pixels are not fixed, their part of the matrix, and its factors."""
        others = np.ones(len(self.normal), np.bool_)
        others[self._fixed] = False
        part = self._matrix[:, np.flatnonzero(others)]
        square = (part.T @ part).tocsc()
        return (
            others,
            part,
            splu(square, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}),
        )

    def _solve(self, right: Floats) -> Floats:
        """Least-squares distances (pixel, sample) of right sides (pair, sample), 0 at the fixed pixels."""
        result = np.zeros((len(self.normal), right.shape[1]))
        if len(self.patches.pairs):
            others, part, factors = self._others
            result[others] = factors.solve(np.ascontiguousarray(part.T @ right))
        return result
