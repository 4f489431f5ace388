"""A scene: everything that determines what the camera sees. Frozen and validated."""

from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.acquisition.patterns import EvenLight, Frame, Patterns, RandomDots
from scenes.acquisition.sensor import Sensor, SimpleSensor
from scenes.board.board import Board
from scenes.rig.calibration import Calibration
from scenes.rig.camera_pair import require_pair
from scenes.rig.devices import Pinhole, Vector
from scenes.rig.projectors import Camera, Projector, Screen, require_one_kind
from scenes.shapes.materials import LIBRARY, Material
from scenes.shapes.solids import Shape
from scenes.support.distribution import Distribution
from scenes.support.errors import nearest
from scenes.support.frozen import Frozen

# Beyond this, a float32 sum no longer grows by one sample.
MAX_SAMPLES = 2**24
# Float32 rounds the phase of light to about this.
MIN_PHASE_ERROR_RAD = 1e-6
# Below this a pass would need too many paths.
MIN_RENDER_NOISE = 0.01

Step = Annotated[float, Field(ge=-1e5, le=1e5)]
Label = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=64)]


class Object(Frozen):
    """A placed shape with a material and a label."""

    label: Label
    """Region under which the object is scored; several objects may share one."""
    shape: Shape
    material: str
    """Name of a material of the scene or of the library."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Turns about the world's x, y, z axes, in that order, before the move to `position_mm`."""
    smooth: bool = False
    """Shade with vertex normals: for curved mirrors and metals."""

    def placement(self) -> NDArray[np.float64]:
        """Transform from the shape's frame to the world.

        Returns
        -------
        ndarray of float64, (4, 4)
            Homogeneous matrix; translation in mm.
        """
        transform = trimesh.transformations.euler_matrix(
            *np.deg2rad(self.rotation_deg), axes="sxyz"
        )
        transform[:3, 3] = self.position_mm
        return np.asarray(transform, dtype=np.float64)


class Ambient(Frozen):
    """Unmodulated light from all directions."""

    radiance_w_m2_sr: NonNegativeFloat = 0.0
    flicker_hz: NonNegativeFloat = 100.0
    """Frequency of its flicker: twice the mains'."""
    flicker_depth: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Amplitude of its flicker over its mean."""


class AutoExposure(Frozen):
    """Scale the exposure times so that one label reaches a digital number."""

    label: Label
    level_dn: PositiveFloat
    statistic: Literal["mean", "peak"] = "mean"
    """mean: the label's mean over pixels and frames; peak: the 99th percentile over its pixels of the brightest frame."""


class Exposures(Frozen):
    """Exposures of every pattern: fixed times, or relative times scaled by `auto`."""

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
        """Number of exposures."""
        return len(self.times_ms or self.relative)


class Acquisition(Frozen):
    """What pictures cost on the machine: `fringebench compare --budget cycle-time` charges it. A rolling shutter depends on it, too."""

    overhead_ms: NonNegativeFloat = 5.0
    """Time of a frame besides its exposure: readout of the camera, switch of the pattern, refresh of the projector."""
    min_exposure_ms: NonNegativeFloat = 0.0
    """Shortest exposure of the camera; strategies that need a shorter one are left out."""


class Sampling(Frozen):
    """How finely light is simulated."""

    samples: Annotated[int, Field(ge=1, le=MAX_SAMPLES)] = 64
    """Points of a pixel at which direct light is evaluated where it varies, a quarter of them where it is smooth; indirect
    light gets a quarter as many paths to as many, on average over the image. With `phase_error_rad`: of each first pass.
    Even numbers: points come in opposite pairs, and an odd one has 25 times the phase noise of direct light (`bench`, 31
    against 30 and 32)."""
    depth: Annotated[int, Field(ge=1, le=64)] = 3
    """Surfaces the projector's light may meet on its way to the camera; 1 is direct light only."""
    phase_error_rad: Annotated[float, Field(ge=MIN_PHASE_ERROR_RAD, le=1.0)] | None = None
    """Trace passes until 95 % of the lit pixels have less noise of light in the finest fringe's phase; absent: trace
    `samples`."""
    render_noise: Annotated[float, Field(ge=MIN_RENDER_NOISE, le=1e3)] | None = None
    """Trace until the noise of light paths in the finest fringe's phase is below this share of the sensor's, root mean square
    over each label's lit pixels; absent: trace `samples`."""
    labels: tuple[Label, ...] | None = None
    """With `render_noise`: the labels that must reach it; absent: all."""
    most_samples: Annotated[int, Field(ge=1, le=MAX_SAMPLES)] = 16384
    """With `phase_error_rad` or `render_noise`: stop here, with a warning, if it is not reached."""


class Scene(Frozen):
    """Objects, rig, patterns, sensor and exposures: all that `render` needs."""

    name: str = "untitled"
    """Name of the scene, in reports and as the default output folder."""
    description: str = ""
    """One line on what the scene shows."""
    camera: Camera
    """The camera that takes the frames."""
    second_camera: Pinhole | None = None
    """A second camera that takes the same frames at the same time, for stereo; heights are those of `camera`'s pixels. Both are
    pinhole cameras of one resolution, which need be given for `camera` only."""
    projectors: Annotated[tuple[Projector, ...], Field(min_length=1, max_length=16)]
    """Each shows all patterns, one projector after the other; or one or two positions of a screen."""
    objects: tuple[Object, ...] = ()
    """Meshes and simple shapes, placed; a scene has these, a board, or both."""
    board: Board | None = None
    """A circuit board with solder paste, its laminate's surface at z = 0."""
    materials: dict[str, Material] = {}
    """Name -> the scene's own material, in addition to or instead of the library's."""
    ambient: Ambient = Ambient()
    """Light from other sources than the projectors."""
    vibration_um: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """Standard deviation of the scene's height from one picture to the next."""
    conveyor_um: tuple[Step, Step] = (0.0, 0.0)
    """How far the objects move along x and y from each picture to the next: pattern by pattern, of each all exposures. They are at
    their places in the middle of the pictures. Pictures cost a trace each."""
    patterns: Patterns
    """Patterns that the projectors show."""
    sensor: Sensor = SimpleSensor()
    """Model that turns light into digital numbers."""
    exposures: Exposures
    """Exposure times of each pattern."""
    acquisition: Acquisition = Acquisition()
    """Overhead of a frame, and the shortest exposure."""
    sampling: Sampling = Sampling()
    """Number and depth of light paths."""
    height_range_mm: tuple[float, float]
    """Minimum and maximum z expected: the working volume, which decoding may use to find the fringe order."""
    randomise: dict[str, Distribution] = {}
    """Dotted key of this scene -> the distribution that `scenes.realise` draws it from for each sample."""

    def calibration(self) -> Calibration:
        """The perfect calibration of this scene's rig."""
        return Calibration(
            camera=self.camera,
            projectors=self.projectors,
            height_range_mm=self.height_range_mm,
            second_camera=self.second_camera,
        )

    def second_view(self) -> "Scene":
        """What the second camera sees, as a scene of one camera."""
        return self.model_copy(update={"camera": self.second_camera, "second_camera": None})

    @model_validator(mode="before")
    @classmethod
    def _one_resolution(cls, tree: Any) -> Any:
        """The second camera's resolution is the camera's."""
        if isinstance(tree, dict):
            one, two = tree.get("camera"), tree.get("second_camera")
            if isinstance(one, dict) and isinstance(two, dict) and "resolution" in one:
                return tree | {"second_camera": {"resolution": one["resolution"]} | two}
        return tree

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        low, high = self.height_range_mm
        if not low < high:
            raise ValueError(f"height_range_mm {[low, high]}: the first must be below the second")
        if not self.objects and self.board is None:
            raise ValueError("the scene is empty: give objects, or a board")
        known = LIBRARY.keys() | self.materials.keys()
        used = [("the board", name) for name in (self.board.materials if self.board else ())]
        used += [(f"object '{item.label}'", item.material) for item in self.objects]
        for what, name in used:
            if name not in known:
                raise ValueError(f"{what} has unknown material '{name}': {nearest(name, known)}")
        auto = self.exposures.auto
        if auto and auto.label not in self.labels:
            raise ValueError(
                f"exposures.auto.label '{auto.label}' is not an object's label: use one of {list(self.labels)}"
            )
        require_one_kind(self.projectors)
        for index, projector in enumerate(self.projectors):
            self._check_rig(index, projector)
        self._check_pair()
        return self

    def _check_pair(self) -> None:
        second = self.second_camera
        alone = isinstance(self.patterns, RandomDots | EvenLight)
        if second is None:
            if alone:
                raise ValueError(
                    f"patterns of kind '{self.patterns.kind}' need a second_camera: with one camera no height can be measured from "
                    "them; add one, or use phase-shift"
                )
            return
        require_pair(self.camera, second, self.projectors)
        dotted = isinstance(self.patterns, RandomDots)
        for index, projector in enumerate(self.projectors):
            if dotted and (projector.fill_factor is not None or projector.psf_sigma_px > 0.0):
                raise ValueError(
                    f"projector {index} has fill_factor or psf_sigma_px, which random dots do not have: leave them out"
                )

    def _check_rig(self, index: int, projector: Projector) -> None:
        if isinstance(projector, Screen):
            missing = {"column", "row"} - {frame.axis for frame in self.patterns.frames()}
            if missing:
                raise ValueError(
                    f"patterns have no {missing.pop()} fringes: a screen needs both, patterns.axes = ['column', 'row'], as a "
                    "slope has two components"
                )
            hidden = projector.hidden_share(self.camera.projection(), self.height_range_mm[0])
            if hidden > 0.0:
                raise ValueError(
                    f"the screen in position {index} hides {hidden:.0%} of the camera's view: move it away from the line between "
                    "camera and objects, or give it a smaller size_mm"
                )
            return
        camera, light = self.camera.projection(), projector.projection()
        both = camera.telecentric and light.telecentric
        apart = np.cross(camera.axis, light.axis) if both else camera.origin_mm - light.origin_mm
        if np.linalg.norm(apart) < 1e-6:
            raise ValueError(
                f"camera and projector {index} see along the same rays, so no height can be measured: "
                "move or tilt one of them"
            )

    @property
    def seen_board(self) -> Board | None:
        """The board, its paste as granular as the camera's pixels resolve."""
        if self.board is None:
            return None
        camera = self.camera.projection()
        places = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
        pixels, _ = camera.project(places)
        paste = self.board.paste.seen_by(0.1 / float(np.linalg.norm(pixels[1] - pixels[0])))
        return self.board.model_copy(update={"paste": paste})

    @property
    def screens(self) -> tuple[Screen, ...]:
        """The screen's positions; empty for projectors."""
        return self.calibration().screens

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels in order of first use; label i of this tuple has id i + 1 in label maps, 0 is nothing."""
        own = [item.label for item in self.objects]
        return tuple(dict.fromkeys([*own, *(self.board.labels if self.board else ())]))

    @property
    def frames(self) -> tuple[Frame, ...]:
        """All frames of all projectors, in the order shown; then those of the second camera."""
        shown = self.patterns.frames(len(self.projectors))
        if self.second_camera is None:
            return shown
        return (*shown, *(replace(f, camera=1) for f in shown))
