"""What a decoder may know of a rig: geometry only, never the objects."""

from typing import Annotated, Self

from pydantic import Field

from scenes.emission import Camera, Projector
from scenes.frozen import Frozen
from scenes.scene import Scene


class Calibration(Frozen):
    """Camera and projectors in one world frame; z = 0 is the reference plane."""

    camera: Camera
    projectors: Annotated[tuple[Projector, ...], Field(min_length=1)]
    height_range_mm: tuple[float, float]
    """Lowest and highest z of the working volume."""

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """The perfect calibration of a scene's rig."""
        return cls(
            camera=scene.camera,
            projectors=scene.projectors,
            height_range_mm=scene.height_range_mm,
        )
