"""What a decoder may know of a rig: its geometry, not the objects."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from scenes.rig.devices import Pinhole
from scenes.rig.projectors import Camera, Projector, Screen, require_one_kind
from scenes.support.errors import SceneError
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
    second_camera: Pinhole | None = None
    """Of a pair of cameras."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        require_one_kind(self.projectors)
        return self

    @property
    def screens(self) -> tuple[Screen, ...]:
        """The screen's positions; empty for projectors."""
        return tuple(p for p in self.projectors if isinstance(p, Screen))

    def require_projectors(self, what: str) -> None:
        """Raise `SceneError` for a rig with a screen or two cameras; `what` needs projectors is for the message.

        >>> import scenes
        >>> scenes.load("step").calibration().require_projectors("a gate")
        """
        if self.screens:
            raise SceneError(
                f"{what} needs a projector, and the rig has a screen, which surfaces mirror: use a rig with projectors, or "
                "render, expose, decode and evaluate"
            )
        if self.second_camera is not None:
            raise SceneError(
                f"{what} is for one camera, and the rig has a second_camera: leave it out, or use render, expose, decode and evaluate"
            )
