"""How long to expose: times as given, or found from the light of one label."""

from collections.abc import Sequence

import numpy as np

from render.chip_image import Image
from render.sensor_stages import Floats
from scenes.acquisition.sensor import Sensor
from scenes.scene import AutoExposure, Exposures
from scenes.support.errors import RenderError, nearest


def exposure_times_ms(
    image: Image,
    labels: Sequence[str],
    shown: Sequence[tuple[int, Floats]],
    exposures: Exposures,
    sensor: Sensor,
) -> tuple[float, ...]:
    """Exposure times in ms, as given or found; arguments and errors as those of `auto_exposure_ms`."""
    if exposures.times_ms is not None:
        return exposures.times_ms
    assert exposures.auto is not None
    unit_ms = auto_exposure_ms(image, labels, shown, exposures.auto, sensor)
    return tuple(unit_ms * relative for relative in exposures.relative)


def auto_exposure_ms(
    image: Image,
    labels: Sequence[str],
    shown: Sequence[tuple[int, Floats]],
    auto: AutoExposure,
    sensor: Sensor,
) -> float:
    """Exposure time in ms at which a label's mean or peak is `level_dn`, black level included; `shown`: projector and
    weights of each frame.

    Noise and clipping are left out, so the digital number is linear in time and this is a division. Raises
    `RenderError` if the label is not in the scene, not in view or dark, or if the level is outside the sensor's range.
    """
    what = f"exposures.auto: label '{auto.label}'"
    if auto.label not in labels:
        raise RenderError(f"{what} is not in the scene: {nearest(auto.label, labels)}")
    seen = np.flatnonzero(image.label == labels.index(auto.label) + 1)
    if not seen.size:
        raise RenderError(
            f"{what} is seen by no pixel, so no exposure time can be computed: choose a label in view, or give times_ms"
        )
    if not sensor.black_level_dn < auto.level_dn <= sensor.saturation_dn:
        raise RenderError(
            f"exposures.auto: level_dn {auto.level_dn:g} cannot be reached: choose one above the black level "
            f"{sensor.black_level_dn:g} and up to saturation {sensor.saturation_dn:g}"
        )
    frames = (image.radiance(p, row, seen) for p, row in shown)
    if auto.statistic == "mean":
        level = float(np.mean([frame.mean() for frame in frames]))
    else:
        level = max(float(np.percentile(frame, 99.0)) for frame in frames)
    if not level > 0:
        raise RenderError(
            f"{what} is dark: no light reaches the camera from it; light it, choose another label, or give times_ms"
        )
    per_ms = float(sensor.mean_dn(level, 1.0)) - sensor.black_level_dn
    return (auto.level_dn - sensor.black_level_dn) / per_ms
