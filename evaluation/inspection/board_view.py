"""A height map over a board's artwork: which pad each pixel belongs to, and how large it is there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from decode import Reason, Reconstruction
from scenes.labels.pad_truth import BoardTruth, PadTruth
from scenes.rig.projection import Projection
from scenes.support.errors import ScoreError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Bare board begins this far from apertures: past the mask's opening, and past paste that slumped or is turned.
CLEAR_MM = 0.1
# How far around a pad the plane is fitted; doubled until enough bare board is found.
AROUND_MM = 0.4


@dataclass(frozen=True, eq=False)
class BoardView:
    """A height map over the artwork; images are (row, col)."""

    xy: Floats
    """(row, col, 2) world point of each pixel on the pads' surface."""
    valid: Mask
    saturated: Mask
    """Rejected because no exposure is free of clipping."""
    filled: Floats
    """Heights, invalid ones taken from the nearest valid pixel."""
    pixel_mm2: Floats
    """Area of a pixel's footprint at its own height."""
    owner: NDArray[np.int32]
    """Pad nearest to each pixel within reach, 0 for none."""
    distance_mm: Floats
    """To the nearest aperture, as far as known; infinite beyond."""
    inside: Mask
    """In an aperture."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return self.valid.shape[0], self.valid.shape[1]

    @classmethod
    def of(cls, rec: Reconstruction, board: BoardTruth, reach_mm: float) -> "BoardView":
        """The view of a reconstruction; pads own pixels up to `reach_mm` from them."""
        camera = _camera(rec)
        z = board.pad_surface_mm
        xy, area = _footprints(camera, z)
        valid = rec.valid & np.isfinite(rec.height_mm)
        if not valid.any():
            raise ScoreError("no pixel of the reconstruction is valid: there is nothing to measure")
        rows, cols = ndimage.distance_transform_edt(
            ~valid, return_distances=False, return_indices=True
        )
        filled = rec.height_mm.astype(np.float64)[rows, cols]
        if not camera.telecentric:
            _, up = _footprints(camera, z + 1.0)
            area = (np.sqrt(area) + (np.sqrt(up) - np.sqrt(area)) * (filled - z)) ** 2
        owner, distance = _ownership(xy, board.pads, max(reach_mm, CLEAR_MM + AROUND_MM))
        inside = distance <= 0.0
        return cls(
            xy,
            valid,
            rec.reason == Reason.SATURATED,
            filled,
            area,
            np.where(distance <= reach_mm, owner, 0),
            distance,
            inside,
        )


def _camera(rec: Reconstruction) -> Projection:
    if rec.calibration is None:
        raise ScoreError(
            "pads are in world coordinates, and this reconstruction has no calibration to place its pixels there: "
            "decode a calibrated stack"
        )
    camera = rec.calibration.camera.projection()
    camera.require_shape(rec.height_mm.shape, "the heights", ScoreError)
    return camera


def _footprints(camera: Projection, z_mm: float) -> tuple[Floats, Floats]:
    """Where pixels meet the plane z: centres (row, col, 2), and areas (row, col) of their quadrilaterals."""
    u, v = np.meshgrid(np.arange(camera.width + 1.0), np.arange(camera.height + 1.0))
    corners = camera.points_at(z_mm, np.stack([u, v], axis=-1))[..., :2]
    one = corners[1:, 1:] - corners[:-1, :-1]
    two = corners[1:, :-1] - corners[:-1, 1:]
    area = 0.5 * np.abs(one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0])
    return camera.points_at(z_mm)[..., :2], area


def _ownership(
    xy: Floats, pads: Sequence[PadTruth], reach_mm: float
) -> tuple[NDArray[np.int32], Floats]:
    """Nearest pad (0 for none) and distance to its aperture (0 inside), within reach."""
    owner = np.zeros(xy.shape[:2], np.int32)
    distance = np.full(xy.shape[:2], np.inf)
    for pad in pads:
        shape = shapely.Polygon(pad.aperture_mm)
        x0, y0, x1, y1 = shape.buffer(reach_mm).bounds
        near = (xy[..., 0] >= x0) & (xy[..., 0] <= x1) & (xy[..., 1] >= y0) & (xy[..., 1] <= y1)
        if not near.any():
            continue
        apart = shapely.distance(shapely.points(xy[near]), shape)
        closer = (apart < distance[near]) & (apart <= reach_mm)
        owner[near] = np.where(closer, pad.pad, owner[near])
        distance[near] = np.where(closer, apart, distance[near])
    return owner, distance
