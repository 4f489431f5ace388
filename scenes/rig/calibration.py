"""What a decoder may know of a rig: its geometry, not the objects."""

from typing import Annotated

from pydantic import Field

from scenes.rig.projectors import Camera, Projector
from scenes.support.frozen import Frozen


class Calibration(Frozen):
    """Camera and projectors in one world frame; z = 0 is the reference plane.

    Examples
    --------
    >>> import scenes
    >>> scenes.load("step").calibration().camera.resolution
    (640, 480)
    """

    camera: Camera
    projectors: Annotated[tuple[Projector, ...], Field(min_length=1)]
    height_range_mm: tuple[float, float]
    """Lowest and highest z of the working volume."""
