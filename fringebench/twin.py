"""A user's own rig as a scene: from an OpenCV calibration to a TOML that renders."""

from typing import Any

import numpy as np

from fringebench.common_field import common_field
from scenes import Scene
from scenes.errors import FileError
from scenes.opencv_calibration import Source
from scenes.rig import Resolution

# Beside the working distance, as its fraction: the volume in which the twin is asked to measure.
VOLUME = 0.05
FINEST_FRINGES = 64


def twin(
    source: Source,
    name: str,
    camera: Resolution | None = None,
    projector: Resolution | None = None,
) -> Scene:
    """A plate, a cap and a step at `source.distance_mm` before the camera of a calibrated rig; z = 0 is the plate.

    Resolutions are needed where the calibration does not tell them. Raises `FileError` for a calibration that cannot be
    used, `SceneError` for fields of view that do not meet at that distance.
    """
    if source.distance_mm <= 0.0:
        raise FileError("a twin needs a working distance in mm (--distance-mm), more than 0")
    rig = source.calibration(camera, projector)
    field = common_field(rig)
    width, height = field.size_mm
    x, y = (float(v) for v in field.middle_mm)
    unit = min(width, height)
    light = rig.projectors[0]
    finest = max(4.0, float(np.ceil(light.resolution[0] / FINEST_FRINGES)))
    periods = [finest]
    while periods[-1] < light.resolution[0]:
        periods.append(periods[-1] * 8.0)
    reach = VOLUME * source.distance_mm
    scene: dict[str, Any] = {
        "name": name,
        "description": f"Twin of a calibrated rig, {source.distance_mm:g} mm before its camera.",
        "camera": rig.camera,
        "projectors": [light.model_copy(update={"reference_mm": source.distance_mm})],
        "patterns": {"kind": "phase-shift", "steps": 4, "periods_px": periods},
        "sensor": {"kind": "emva1288", "bits": 12},
        # the plate is larger than the light: its brightest part counts
        "exposures": {"auto": {"label": "base", "level_dn": 3000.0, "statistic": "peak"}},
        "height_range_mm": [-reach, reach],
        "objects": [
            {
                "label": "base",
                "material": "grey-paint",
                "shape": {"kind": "plate", "size_mm": [3.0 * width, 3.0 * height]},
                "position_mm": [x, y, 0.0],
            },
            {
                "label": "cap",
                "material": "grey-paint",
                "shape": {
                    "kind": "cap",
                    "radius_mm": 0.2 * unit,
                    "height_mm": min(0.05 * unit, 0.5 * reach),
                },
                "position_mm": [x - 0.22 * width, y, 0.0],
            },
            {
                "label": "step",
                "material": "grey-paint",
                "shape": {
                    "kind": "box",
                    "size_mm": [0.25 * unit, 0.25 * unit, min(0.03 * unit, 0.5 * reach)],
                },
                "position_mm": [x + 0.22 * width, y, 0.0],
            },
        ],
    }
    return Scene.model_validate(scene)
