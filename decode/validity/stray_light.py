"""Stray light in a shadow: the search on a whole decode, from its levels, its borders and its order along epipolar lines."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from decode.device import Device, Lanes
from decode.fusion.interface import FusionRule, Samples
from decode.height.rig_geometry import Rig
from decode.reason import Reason
from decode.validity import epipolar_order, shadow
from scenes.acquisition.patterns import Axis


@dataclass(frozen=True)
class Coordinates:
    """Measured projector coordinates, as lanes, and the rig along whose epipolar lines they are ordered."""

    rig: Rig
    axis: Axis
    at_px: Lanes
    sigma_px: Lanes
    height_mm: NDArray[np.float32] | None
    """Measured heights (row, col); None for phases alone."""
    volume_mm: tuple[float, float] | None
    """Heights that are accepted; None if unknown."""

    def range_mm(self, trusted: NDArray[np.bool_]) -> tuple[float, float] | None:
        """Lowest and highest trusted height in mm, else the volume's, else None."""
        if self.height_mm is None or not trusted.any():
            return self.volume_mm
        found = self.height_mm[trusted]
        return float(found.min()), float(found.max())


class StrayLight:
    """The search for stray light; made before the kernel is traced, so that the image's typical light is known in time."""

    def __init__(
        self,
        device: Device,
        image: tuple[int, int],
        fraction: float,
        read: Callable[[Lanes | None], Samples],
    ) -> None:
        """`fraction` is the share of the typical light below which light is stray; `read` gives samples of pixels."""
        self._device, self._image, self._fraction, self._read = device, image, fraction, read
        self._few_levels = shadow.level(read(device.types.UInt32(shadow.grid(image))))
        device.dr.eval(self._few_levels)

    @cached_property
    def _typical(self) -> float:
        return shadow.typical(self._few_levels.numpy())

    def lit(self, samples: Samples) -> Lanes:
        """Where there is more than stray light has, as booleans."""
        return shadow.level(samples) >= self._device.dr.opaque(
            self._device.types.Float, self._fraction * self._typical
        )

    def spread(
        self,
        reason: NDArray[np.uint8],
        rule: FusionRule,
        coordinates: Callable[[], Coordinates | None],
    ) -> NDArray[np.uint8]:
        """`Reason` codes (row, col) with the shadow that its borders show, or that contradicts the order of the
        coordinates in px.
        """
        # The greatest code first: without the comparison's image, which costs a fifth of all decoding.
        if not self._typical or reason.max() < Reason.SHADOW:
            return reason
        if not (reason == Reason.SHADOW).any():
            return reason
        level, shade = self._borders(rule)
        shade &= (reason != Reason.SATURATED) & (reason != Reason.NOT_A_NUMBER)
        reason = np.where(shade, np.uint8(Reason.SHADOW), reason)
        trusted, at = reason == Reason.OK, coordinates()
        heights_mm = None if at is None else at.range_mm(trusted)
        if at is not None and heights_mm is not None:
            reason[self._contradicted(trusted, at, heights_mm, level)] = Reason.SHADOW
        return reason

    def _borders(self, rule: FusionRule) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Level and shadow next to shadow, (row, col)."""
        minimum = self._fraction * self._typical
        dr, types = self._device.dr, self._device.types
        samples = self._read(None)
        levels = shadow.level(samples)
        phasor = rule.fuse(samples)
        # Clipped light is no shadow; NaN, and what float32 cannot square, is neither shadow nor light.
        real = dr.isfinite(phasor.offset) & dr.isfinite(levels)
        dark = phasor.usable & real & ~(levels >= dr.opaque(types.Float, minimum))
        what = dr.select(
            dark,
            types.UInt32(shadow.DARK),
            dr.select(real, types.UInt32(0), types.UInt32(shadow.NOTHING)),
        )
        dr.eval(levels, what)
        level, where = (self._device.image(lanes, self._image) for lanes in (levels, what))
        nothing = where == shadow.NOTHING
        return level, shadow.borders(level, where == shadow.DARK, nothing, minimum)

    def _contradicted(
        self,
        trusted: NDArray[np.bool_],
        at: Coordinates,
        heights_mm: tuple[float, float],
        level: NDArray[np.float32],
    ) -> NDArray[np.bool_]:
        """Which trusted pixels others contradict, (row, col)."""
        device = self._device
        margin = epipolar_order.SURE * at.sigma_px
        known = device.plane(trusted.view(np.uint8)) > 0.5
        minimum = device.dr.select(known, at.at_px - margin, float("-inf"))
        maximum = device.dr.select(known, at.at_px + margin, float("inf"))
        device.dr.eval(minimum, maximum)
        claims = epipolar_order.Claims(
            device.image(minimum, self._image),
            device.image(maximum, self._image),
            level,
            self._typical,
        )
        return epipolar_order.contradicted(claims, at.rig, at.axis, heights_mm)
