"""The rig of a user as a scene that can be rendered."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fringebench.experiments.rigs.shared_field import common_field
from scenes import Calibration, Scene
from scenes.support.errors import FileError

# Half the height range of the twin, as a fraction of the working distance.
VOLUME = 0.05
FINEST_FRINGES = 64


def twin(
    rig: Calibration, name: str, distance_mm: float, sensor: Mapping[str, float] | None = None
) -> Scene:
    """A plate, a cap and a step at z = 0, `distance_mm` in front of the rig's camera.

    `sensor` has further keys of the EMVA 1288 sensor. Raises `FileError` for a distance of 0, `SceneError` for fields of
    view that do not meet there.
    """
    if distance_mm <= 0.0:
        raise FileError(f"working distance {distance_mm:g} mm: give --distance-mm, more than 0")
    rig.require_projectors("a twin")
    field = common_field(rig)
    width, height = field.size_mm
    x, y = (float(v) for v in field.middle_mm)
    unit = min(width, height)
    light = rig.projectors[0]
    finest = max(4.0, float(np.ceil(light.resolution[0] / FINEST_FRINGES)))
    periods = [finest]
    while periods[-1] < light.resolution[0]:
        periods.append(periods[-1] * 8.0)
    reach = VOLUME * distance_mm
    scene: dict[str, Any] = {
        "name": name,
        "description": f"Twin of a rig, {distance_mm:g} mm in front of its camera.",
        "camera": rig.camera,
        "projectors": [light.model_copy(update={"reference_mm": distance_mm})],
        "patterns": {"kind": "phase-shift", "steps": 4, "periods_px": periods},
        "sensor": {"kind": "emva1288", "bits": 12, **(sensor or {})},
        # The plate is larger than the light, so its brightest part sets the exposure.
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
