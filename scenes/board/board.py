"""A printed circuit board in a scene: artwork, layers, printed paste and defects."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from scenes.board import component_packages
from scenes.board.board_settings import BoardBase
from scenes.board.component_packages import Component
from scenes.board.extras.fiducials import with_drawn
from scenes.board.extras.holes import with_holes
from scenes.board.gerber.gerber_board import GerberBoard
from scenes.board.pad_layout import Area, Bounds, Layout, Pad
from scenes.support.errors import nearest


class ParametricBoard(BoardBase):
    """A board of standard parts; board coordinates have their origin in its middle."""

    kind: Literal["parametric"] = "parametric"
    size_mm: tuple[PositiveFloat, PositiveFloat]
    parts: Annotated[tuple[Component, ...], Field(min_length=1)]
    aperture_inset_mm: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """Stencil openings are smaller than pads by this on every side."""
    mask_clearance_mm: Annotated[float, Field(gt=0.0, le=0.5)] = 0.05
    """Mask openings are larger than pads by this on every side."""

    @model_validator(mode="after")
    def _packages_known(self) -> Self:
        known = {name for part in self.parts for name in part.names}
        for name in self.paste.packages:
            if name not in known:
                raise ValueError(f"paste.packages: no part is '{name}': {nearest(name, known)}")
        return self

    def whole(self) -> tuple[Sequence[Pad], Area]:
        layout = self._parts(None)
        return layout.pads, layout.board

    def part(self, pads: Sequence[Pad], outline: Area, box: Bounds) -> Layout:
        layout = self._parts(box)
        if self.fiducials is not None:
            layout = with_drawn(layout, self.fiducials)
        if self.holes is None:
            return layout
        return with_holes(layout, (), self.holes, self.mask_clearance_mm, outline)

    def _parts(self, box: Bounds | None) -> Layout:
        return component_packages.layout(
            self.parts, self.size_mm, self.aperture_inset_mm, self.mask_clearance_mm, box
        )


Board = Annotated[GerberBoard | ParametricBoard, Field(discriminator="kind")]
