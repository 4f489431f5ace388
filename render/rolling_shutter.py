"""A rolling shutter: each row of a picture is exposed a little later than the row above, so that it finds other light.

A pattern is shown from the beginning of a picture's first row until the next pattern's picture begins, an exposure and
`acquisition.overhead_ms` later. Rows that are still exposed then see the next pattern as well. The scene's height and the
projector's gain, which change at random from picture to picture, are the same for all rows.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from render.chip_image import Image
from render.sensor_stages import Floats
from render.unsteady_light import STEADY, ExposurePart, Moment, moment
from scenes.acquisition.sensor import Emva
from scenes.scene import Scene


class Seen(NamedTuple):
    """A part of a row's exposure."""

    share: float
    projector: int
    weights: Floats
    """(channel,)"""
    moment: Moment


Rows = Sequence[Sequence[Seen]]
"""What each row sees."""


def pictures_seen(
    scene: Scene,
    seed: int,
    times_ms: Sequence[float],
    shown: Sequence[tuple[int, Floats]],
    planes: Sequence[Floats],
    still: bool,
    random: bool,
) -> tuple[list[list[Seen]], list[list[Rows]]]:
    """What every picture (frame, exposure) sees, and what its rows do: empty for a global shutter.

    `shown` are the projector and the weights of each frame, `planes` those of its bit planes. `still`: no light varies;
    `random`: of what varies, everything, not only what is the same for every seed.
    """

    def look(f: int, e: int, part: ExposurePart | None = None, ahead: int = 0) -> Seen:
        projector, weights = shown[f + ahead]
        now = STEADY
        if not still:
            now = moment(scene, seed, e, f, projector, times_ms[e], random, part)
        if now.shares:
            weights = np.asarray(now.shares) @ planes[f + ahead]
        return Seen(1.0, projector, weights, now)

    def rows(f: int, e: int) -> Rows:
        # The pattern changes after its last exposure, and stays after the last picture.
        stays = e + 1 < len(times_ms) or f + 1 == len(shown)
        delays_ms = row_ms * np.arange(scene.camera.resolution[1])
        parts = row_parts(delays_ms, times_ms[e], scene.acquisition.overhead_ms, stays)
        return [
            [look(f, e, p, n)._replace(share=p.length_ms / times_ms[e]) for n, p in row.items()]
            for row in parts
        ]

    pictures = [range(len(times_ms)) for _ in shown]
    row_ms = scene.sensor.row_time_us * 1e-3 if isinstance(scene.sensor, Emva) else 0.0
    seen = [[look(f, e) for e in picture] for f, picture in enumerate(pictures)]
    rolled = [[rows(f, e) for e in picture] for f, picture in enumerate(pictures)] if row_ms else []
    return seen, rolled


def row_parts(
    delays_ms: NDArray[np.floating], exposure_ms: float, overhead_ms: float, stays: bool
) -> list[dict[int, ExposurePart]]:
    """Parts of each row's exposure, which begins so much later (row,), that see the picture's own pattern (0) and the next (1).

    `stays`: no other pattern follows.
    """
    change_ms = exposure_ms + overhead_ms
    found = []
    for delay_ms in delays_ms.tolist():
        late_ms = 0.0 if stays else min(max(delay_ms - overhead_ms, 0.0), exposure_ms)
        parts = {
            0: ExposurePart(delay_ms, exposure_ms - late_ms),
            1: ExposurePart(max(delay_ms, change_ms), late_ms, change_ms),
        }
        found.append({n: part for n, part in parts.items() if part.length_ms > 0.0})
    return found


def radiance(image: Image, rows: Rows, pixels: slice) -> Floats:
    """Radiance (pixel,) of some pixels in row order, as `Image.radiance`."""
    width = image.shape[1]
    found = np.empty(pixels.stop - pixels.start)
    for row in range(pixels.start // width, -(-pixels.stop // width)):
        at = slice(max(pixels.start, row * width), min(pixels.stop, (row + 1) * width))
        light = [s.share * image.radiance(s.projector, s.weights, at, s.moment) for s in rows[row]]
        found[at.start - pixels.start : at.stop - pixels.start] = sum(light)
    return found
