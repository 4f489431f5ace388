"""Ordering: two coordinates that exclude each other, because either point would block the projector's light to the other.

Along an epipolar line of the camera the projector's coordinate grows; where a shadow begins it stops, and continues where
the shadow ends (the ordering constraint of stereo, Baker & Binford 1981). So a shadow has no coordinates of its own: the
coordinate of its stray light belongs to the lit surface before or behind it, which is brighter.

The constraint holds where no light passes beneath the surface. Behind a wire or a lead in the air the board is lit out of
order, and correctly: so only dim pixels are rejected.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decode.height.rig_geometry import Rig
from scenes.acquisition.patterns import Axis

Points = NDArray[np.float64]

# Standard deviations by which a coordinate is surely before another: as `shadow.SURE`.
SURE = 3.0
# Pixels with less than this share of the image's typical light may be stray light, if what contradicts them is brighter by
# the inverse of this share.
DIMMER = 0.5
# Pixels this far apart or further are compared: the coordinates of nearer ones may overlap.
APART = 2
# A line this near to a pixel's middle, px, counts as inside that pixel alone.
INSIDE = 0.1
# The epipolar lines' directions are evaluated on a grid of this many pixels each way.
GRID = 5
# Sideways px per px along a line: lines steeper than this run in all directions, from a projector next to the camera's
# axis, and are not followed.
STEEPEST = 2.0
# Sideways px per px below which a row or column of the image is taken for an epipolar line.
STRAIGHT = 0.15


@dataclass(frozen=True)
class Claims:
    """Projector coordinates that pixels claim; images are (row, col) and float32."""

    least_px: NDArray[np.float32]
    """Smallest projector coordinate that the pixel may have; -inf for a pixel that is rejected already."""
    most_px: NDArray[np.float32]
    """The largest; inf for a pixel that is rejected already."""
    level: NDArray[np.float32]
    """Light as in `shadow.level`."""
    typical: float
    """Typical level of the image."""


def contradicted(
    claims: Claims, rig: Rig, axis: Axis, heights_mm: tuple[float, float]
) -> NDArray[np.bool_]:
    """Dim trusted pixels (row, col) that are out of order with bright ones of at least twice their light.

    Dim is less than half the typical light. Pixels `APART` or more along an epipolar line are out of order if the one
    behind surely has the smaller coordinate. The line is followed as far as the highest point can cast a shadow onto
    the lowest.
    """
    found = np.zeros(claims.level.shape, np.bool_)
    lines = _Lines.of(rig, axis, heights_mm, found.shape)
    if lines.reach < APART:
        return found
    bright = claims.level >= DIMMER * claims.typical
    least, most = claims.least_px, claims.most_px
    for way, mine, others in ((-1, most, least), (1, -least, -most)):
        stated = np.where(bright, others, np.float32(-np.inf))
        short, long = lines.masks(way)
        # A first pass that misses nothing: the maximum over a few steps, then over those maxima.
        near = cv2.dilate(stated, short) + lines.aside_px
        at = np.flatnonzero((cv2.dilate(near, long) > mine) & ~bright)
        look = _LineSamples(
            mine.reshape(-1)[at], stated.reshape(-1), near.reshape(-1), claims.level, way
        )
        found.reshape(-1)[at[_out_of_order(look, lines, at)]] = True
    return found


def image_lead(
    rig: Rig, axis: Axis, heights_mm: tuple[float, float], image: tuple[int, ...]
) -> tuple[int, int] | None:
    """Image axis that epipolar lines run along (0: from column to column), and the sign of the coordinate's growth;
    None if inclined.
    """
    lines = _Lines.of(rig, axis, heights_mm, image)
    if not len(lines.steps) or np.abs(lines.steps[:, 1 - lines.lead]).max() > STRAIGHT:
        return None
    return lines.lead, int(lines.steps[0, lines.lead])


@dataclass(frozen=True)
class _LineSamples:
    """Coordinates of some pixels, and those along their lines one way; flat."""

    mine: NDArray[np.float32]
    """Largest coordinate that the pixels may have."""
    stated: NDArray[np.float32]
    """Smallest coordinate that each bright pixel of the image may have."""
    near: NDArray[np.float32]
    """The maximum over a few steps from each pixel of the image."""
    level: NDArray[np.float32]
    """(row, col)."""
    way: int
    """1: towards larger coordinates, and coordinates are negated; -1: towards smaller."""


def _out_of_order(look: _LineSamples, lines: "_Lines", at: NDArray[np.intp]) -> NDArray[np.bool_]:
    """For which pixels with flat indices `at` a coordinate on their lines exceeds their own.

    Between two pixels a line is as much in the one as in the other, and both must contradict: where a surface's edge runs
    along the line, their light may come from the near side of it.
    """
    rows, columns = look.level.shape
    level = look.level.reshape(-1)
    lead, side = lines.lead, 1 - lines.lead
    size, stride = (columns, rows), (1, columns)
    start = np.stack([at % columns, at // columns], axis=-1)
    steps, gradients = lines.steps_at(start + 0.5)
    steps *= look.way
    slant = -look.way * gradients[:, side]
    found = np.zeros(at.size, np.bool_)

    def pixels(who: NDArray[np.intp], k: int) -> tuple[Points, Points, NDArray[np.bool_]]:
        ahead = start[who, lead] + k * steps[who, lead]
        return ahead, start[who, side] + k * steps[who, side], (ahead >= 0) & (ahead < size[lead])

    for begin in range(0, lines.reach, lines.stride):
        everyone = np.flatnonzero(~found)
        ahead, exact, inside = pixels(everyone, begin)
        aside = np.rint(exact)
        inside &= (aside >= 0) & (aside < size[side])
        place = np.where(inside, ahead * stride[lead] + aside * stride[side], 0).astype(np.intp)
        who = everyone[inside & (look.near[place] > look.mine[everyone])]
        last = min(begin + APART + lines.stride, lines.reach + 1)
        for k in range(begin + APART, last):
            ahead, exact, inside = pixels(who, k)
            for aside in np.floor(exact + INSIDE), np.ceil(exact - INSIDE):
                inside &= (aside >= 0) & (aside < size[side])
                place = np.where(inside, ahead * stride[lead] + aside * stride[side], 0).astype(
                    np.intp
                )
                inside &= look.stated[place] - (aside - exact) * slant[who] > look.mine[who]
                inside &= level[place] >= level[at[who]] / np.float32(DIMMER)
            found[who[inside]] = True
    return found


@dataclass(frozen=True)
class _Lines:
    """Epipolar lines in the camera's image, followed in whole steps along the axis they mostly run along."""

    rig: Rig
    axis: Axis
    heights_mm: tuple[float, float]
    lead: int
    """The axis: 0 for lines that run from column to column, 1 from row to row."""
    reach: int
    """Steps that the longest shadow takes."""
    steps: Points
    """Directions that lines have, (n, 2) as (column, row): towards larger coordinates, 1 along `lead`."""
    aside_px: np.float32
    """Largest change of the coordinate from a line to a neighbouring pixel."""

    @classmethod
    def of(
        cls, rig: Rig, axis: Axis, heights_mm: tuple[float, float], image: tuple[int, ...]
    ) -> "_Lines":
        """The lines of an image of so many rows and columns; a `reach` of 0 where there are none to follow."""
        down, right = (np.linspace(0.5, size - 0.5, GRID) for size in image)
        pixels = np.stack(np.meshgrid(right, down), axis=-1).reshape(-1, 2)
        blank = cls(rig, axis, heights_mm, 0, 0, np.empty((0, 2)), np.float32(0.0))
        pieces, gradients = blank.pieces(pixels)
        known = np.isfinite(pieces).all(axis=1) & np.isfinite(gradients).all(axis=1)
        pieces, gradients = pieces[known], gradients[known]
        lead = int(np.abs(pieces).sum(axis=0).argmax())
        length = np.abs(pieces[:, lead])
        if not length.any():
            return blank
        pieces, gradients, length = (a[length > 0.0] for a in (pieces, gradients, length))
        steps = pieces / length[:, None]
        if np.ptp(steps[:, lead]) > 0.0 or np.abs(steps[:, 1 - lead]).max() > STEEPEST:
            return blank
        return cls(
            rig,
            axis,
            heights_mm,
            lead,
            min(math.ceil(length.max()), image[1 - lead]),
            steps,
            np.float32(np.abs(gradients[:, 1 - lead]).max()),
        )

    @property
    def stride(self) -> int:
        """A long step."""
        return math.isqrt(self.reach)

    def masks(self, way: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Offsets of all lines' pixels and their neighbours from a pixel: every short step from every long one."""
        masks = []
        for ahead, sides in (
            (np.arange(APART, APART + self.stride), (-1, 0, 1)),
            (np.arange(0, self.reach, self.stride), (0,)),
        ):
            at = np.rint(way * ahead[:, None, None] * self.steps).astype(int)
            spread = np.abs(at).max(axis=(0, 1)) + 1
            mask = np.zeros(2 * spread[::-1] + 1, np.uint8)
            for side in sides:
                place = [at[..., 0] + spread[0], at[..., 1] + spread[1]]
                place[1 - self.lead] = place[1 - self.lead] + side
                mask[place[1], place[0]] = 1
            masks.append(mask)
        return masks[0], masks[1]

    def pieces(self, pixels: Points) -> tuple[Points, Points]:
        """Of pixels (n, 2): the piece of line between the heights, towards larger coordinates, px; and the coordinate's
        gradient on the plane between them; each (n, 2) as (column, row), NaN where rays do not meet.
        """
        camera, projector = self.rig.camera, self.rig.projector
        low, high = self.heights_mm
        here = self._between(pixels)
        light = projector.axis if projector.telecentric else here - projector.origin_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            half = (high - low) / 2 * light / light[..., 2:]
            piece = camera.project(here + half)[0] - camera.project(here - half)[0]
        right, down = (
            self._coordinate(pixels + step) - self._coordinate(pixels - step)
            for step in (np.array([0.5, 0.0]), np.array([0.0, 0.5]))
        )
        gradient = np.stack([right, down], axis=-1)
        return np.sign((piece * gradient).sum(axis=1, keepdims=True)) * piece, gradient

    def steps_at(self, pixels: Points) -> tuple[Points, Points]:
        """The line's direction as in `steps`, NaN where there is none, and the coordinate's gradient, of pixels (n, 2)."""
        piece, gradient = self.pieces(pixels)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = piece / np.abs(piece[:, self.lead, None])
        return np.where(np.isfinite(step), step, np.nan), gradient

    def _coordinate(self, pixels: Points) -> NDArray[np.float64]:
        where, _ = self.rig.projector.project(self._between(pixels))
        return np.asarray(where[:, 0 if self.axis == "column" else 1])

    def _between(self, pixels: Points) -> Points:
        """Points of the pixels' rays half-way between the heights, mm."""
        return self.rig.camera.points_at(sum(self.heights_mm) / 2, pixels)
