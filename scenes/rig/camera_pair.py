"""What two cameras need to measure heights together."""

from collections.abc import Sequence

import numpy as np

from scenes.rig.devices import Pinhole
from scenes.rig.projectors import Camera, Projector, Screen


def require_pair(camera: Camera, second: Pinhole, projectors: Sequence[Projector]) -> None:
    """Raise `ValueError` for two cameras that are no pair, or that look at a screen."""
    if not isinstance(camera, Pinhole):
        raise ValueError(  # noqa: TRY004
            "second_camera needs a camera of model 'pinhole': stereo of telecentric cameras is not supported"
        )
    if second.resolution != camera.resolution:
        raise ValueError(
            f"second_camera has resolution {list(second.resolution)}, camera {list(camera.resolution)}: give both the same"
        )
    one, two = camera.projection(), second.projection()
    if np.linalg.norm(one.origin_mm - two.origin_mm) < 1e-6:
        raise ValueError(
            "second_camera is where camera is, so no height can be measured: move one of them"
        )
    if one.axis @ two.axis < 0.5:
        raise ValueError(
            "camera and second_camera look more than 60 degrees apart: turn them towards one place"
        )
    if isinstance(projectors[0], Screen):
        raise ValueError("a screen is measured by one camera: leave second_camera out")  # noqa: TRY004
