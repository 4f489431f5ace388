"""A scene: everything that decides what the camera sees. Frozen and validated."""

from typing import Annotated, Literal, Self

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.board import Board
from scenes.distribution import Distribution
from scenes.emission import Camera, Projector
from scenes.errors import nearest
from scenes.frozen import Frozen
from scenes.materials import LIBRARY, Material
from scenes.patterns import Frame, Patterns
from scenes.rig import Vector
from scenes.sensor import Sensor, SimpleSensor
from scenes.shapes import Shape

# Beyond, a sum in float32 no longer grows by one sample.
MOST_SAMPLES = 2**24
# Finer, the phase of light in float32 is rounded.
FINEST_PHASE_ERROR_RAD = 1e-6

Label = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=64)]


class Object(Frozen):
    """A shape, placed, of one material, under one label."""

    label: Label
    """Region the object is scored under; several objects may share one."""
    shape: Shape
    material: str
    """Name of a material of the scene or of the library."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Turns about the world's x, y, z axes, in that order, before the move to `position_mm`."""
    smooth: bool = False
    """Shade with vertex normals: for curved mirrors and metals."""

    def placement(self) -> NDArray[np.float64]:
        """The 4 x 4 transform from the shape's frame to the world."""
        transform = trimesh.transformations.euler_matrix(
            *np.deg2rad(self.rotation_deg), axes="sxyz"
        )
        transform[:3, 3] = self.position_mm
        return np.asarray(transform, dtype=np.float64)


class Ambient(Frozen):
    """Unmodulated light from all directions."""

    radiance_w_m2_sr: NonNegativeFloat = 0.0


class AutoExposure(Frozen):
    """Bring one label to one digital number by scaling the exposure time."""

    label: Label
    level_dn: PositiveFloat
    statistic: Literal["mean", "peak"] = "mean"
    """mean: the label's mean over pixels and frames; peak: the 99th percentile over its pixels of the brightest frame."""


class Exposures(Frozen):
    """The exposures taken of every pattern: times as given, or relative times scaled by `auto`."""

    times_ms: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] | None = None
    relative: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] = (1.0,)
    """Times relative to the one that `auto` finds."""
    auto: AutoExposure | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.times_ms is None) == (self.auto is None):
            raise ValueError(
                "give either times_ms, or auto (with relative for several exposures); in place of a scene's auto, set the "
                "whole table: exposures = {times_ms = [2.0, 8.0]}"
            )
        if self.times_ms and self.relative != (1.0,):
            raise ValueError(
                f"relative {list(self.relative)} scales what auto finds, but times_ms is given: drop one of them"
            )
        return self

    @property
    def count(self) -> int:
        """How many exposures are taken."""
        return len(self.times_ms or self.relative)


class Sampling(Frozen):
    """How finely light is simulated."""

    samples: Annotated[int, Field(ge=1, le=MOST_SAMPLES)] = 64
    """Light paths per pixel; with `phase_error_rad`, of each of the first passes."""
    depth: Annotated[int, Field(ge=1, le=64)] = 3
    """Surfaces the projector's light may meet on its way to the camera; 1 is direct light only."""
    phase_error_rad: Annotated[float, Field(ge=FINEST_PHASE_ERROR_RAD, le=1.0)] | None = None
    """Trace passes until 95 % of the lit pixels have less noise of light in the finest fringe's phase; absent: trace
    `samples`."""
    most_samples: Annotated[int, Field(ge=1, le=MOST_SAMPLES)] = 16384
    """With `phase_error_rad`: stop here, with a warning, if it is not reached."""


class Scene(Frozen):
    """What stands before the camera, and how it is lit, shown and taken."""

    name: str = "untitled"
    """Of the scene, in reports and as the folder's default."""
    description: str = ""
    """One line: what it shows."""
    camera: Camera
    """The one that takes the frames."""
    projectors: Annotated[tuple[Projector, ...], Field(min_length=1, max_length=16)]
    """Each shows all patterns, one projector after the other."""
    objects: tuple[Object, ...] = ()
    """Meshes and simple shapes, placed; a scene has these, a board, or both."""
    board: Board | None = None
    """A circuit board with solder paste, its laminate's surface at z = 0."""
    materials: dict[str, Material] = {}
    """Name -> a material of the scene's own, beside or instead of the library's."""
    ambient: Ambient = Ambient()
    """Light that is not the projectors'."""
    patterns: Patterns
    """What the projectors show."""
    sensor: Sensor = SimpleSensor()
    """How light becomes digital numbers."""
    exposures: Exposures
    """How long each pattern is exposed, and how often."""
    sampling: Sampling = Sampling()
    """Light paths, and how many surfaces they may meet."""
    height_range_mm: tuple[float, float]
    """Lowest and highest z expected: the working volume, which decoding may use to find the fringe order."""
    randomise: dict[str, Distribution] = {}
    """Dotted key of this scene -> the distribution that `scenes.realise` draws it from for each sample."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        low, high = self.height_range_mm
        if not low < high:
            raise ValueError(f"height_range_mm {[low, high]}: the first must be below the second")
        if not self.objects and self.board is None:
            raise ValueError("nothing to see: give objects, or a board")
        known = LIBRARY.keys() | self.materials.keys()
        for name in self.board.materials if self.board else ():
            if name not in known:
                raise ValueError(f"the board has unknown material '{name}': {nearest(name, known)}")
        for item in self.objects:
            if item.material not in known:
                raise ValueError(
                    f"object '{item.label}' has unknown material '{item.material}': "
                    + nearest(item.material, known)
                )
        auto = self.exposures.auto
        if auto and auto.label not in self.labels:
            raise ValueError(
                f"exposures.auto.label '{auto.label}' is no object's label: use one of {list(self.labels)}"
            )
        for index, projector in enumerate(self.projectors):
            self._check_rig(index, projector)
        return self

    def _check_rig(self, index: int, projector: Projector) -> None:
        camera, light = self.camera.projection(), projector.projection()
        parallel = np.linalg.norm(np.cross(camera.axis, light.axis)) < 1e-6
        together = np.linalg.norm(camera.origin_mm - light.origin_mm) < 1e-6
        blind = parallel if camera.telecentric and light.telecentric else together
        if blind:
            raise ValueError(
                f"camera and projector {index} see along the same rays, so no height can be measured: "
                "move or tilt one of them"
            )

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels in order of first use; label i of this tuple has id i + 1 in label maps, 0 is nothing."""
        own = [item.label for item in self.objects]
        return tuple(dict.fromkeys([*own, *(self.board.labels if self.board else ())]))

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Every frame shown, in order, of all projectors."""
        return self.patterns.frames(len(self.projectors))
