"""A real capture: image files, and a manifest that says what each one shows.

The manifest is TOML::

    files = ["pat*.png"]                  # in the order shown; names or globs, relative to the manifest
    projector_resolution = [1920, 1080]
    frames = [
      {kind = "fringes", axis = "column", period_px = 100.0, steps = 3, first_phase_deg = -120.0, origin_px = 0.5},
      {kind = "gray", axis = "column", bits = 5, cell_px = 100.0},
      {kind = "white"},
      {kind = "black"},
    ]

`scenes.files.capture` reads it and the images. What the frames contradict is found by `decode.checks`.
"""

from math import isclose
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.acquisition.patterns import Frame
from scenes.acquisition.sensor import Sensor
from scenes.files import images
from scenes.files.capture_frames import Fringes, OrderMap, PhaseMap, Shown, incomplete
from scenes.rig import opencv_calibration
from scenes.rig.calibration import Calibration
from scenes.rig.devices import Resolution
from scenes.support.frozen import Frozen

Channels = images.ImageChannel | Annotated[tuple[images.ImageChannel, ...], Field(min_length=1)]
# Periods of one axis that differ by less are one period, written with other digits.
SAME_PERIOD = 1e-6


class SecondView(Frozen):
    """Images of the same frames by a second camera, which the calibration's second device is."""

    files: Annotated[tuple[str, ...], Field(min_length=1)]
    """As the capture's."""
    folder: Path = Path()
    """Folder of the files, relative to the manifest's."""


class CaptureManifest(Frozen):
    """What a manifest says, as written in the file."""

    files: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names or globs, relative to the manifest's folder, in the order shown; a glob's matches in natural order. They may be
    in several folders: ``["left/*.png", "right/*.png"]``."""
    folder: Path = Path()
    """Folder of the files, relative to the manifest's."""
    frames: Annotated[tuple[Shown, ...], Field(min_length=1)]
    """What the frames show, in order."""
    exposures_ms: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] = (1.0,)
    """Exposure times; several: all frames at the first time, then all at the next. For one time and several brightnesses of
    the projector, give the relative brightnesses."""
    exposures_innermost: bool = False
    """Every exposure of a frame comes before the next frame."""
    channel: Channels = "grey"
    """Colour plane that is the frame; a list: each file holds that many frames, one a plane, in this order."""
    bits: Annotated[int, Field(ge=8, le=16)] = 8
    """Bits of a digital number, as the camera gives it."""
    saturation_dn: PositiveFloat | None = None
    """From here up a sample is saturated; absent: where samples accumulate, else the end of the range."""
    dark_dn: NonNegativeFloat = 0.0
    """Digital number of no light."""
    noise_dn: PositiveFloat | None = None
    """Standard deviation of the noise; absent: estimated from the frames."""
    projector_resolution: Resolution | None = None
    """Columns, rows of the projector; absent: the calibration's."""
    gamma: Annotated[float, Field(ge=0.2, le=5.0)] | None = None
    """Gamma of projector and camera, which decoding undoes; absent: `fringebench import` measures it."""
    second_view: SecondView | None = None
    """The second camera of a pair, for stereo by phase; the projector needs no calibration then."""
    calibration: opencv_calibration.Source | None = None
    """OpenCV's files."""
    rig: Calibration | None = None
    """The rig in this project's own form, as `fringebench export` writes it; instead of `calibration`."""
    sensor: Sensor | None = None
    """The whole noise model, as `fringebench export` writes it; instead of `saturation_dn`, `dark_dn` and `noise_dn`."""

    @model_validator(mode="after")
    def _one_rig(self) -> Self:
        if self.calibration is not None and self.rig is not None:
            raise ValueError("both calibration and rig are given: keep one of them")
        if self.second_view is not None and self.calibration is None:
            raise ValueError(
                "second_view needs the calibration of the two cameras: add [calibration] files"
            )
        return self

    @model_validator(mode="after")
    def _sets_differ(self) -> Self:
        sets = [(i, shown) for i, shown in enumerate(self.frames) if isinstance(shown, Fringes)]
        for n, (j, later) in enumerate(sets):
            for i, first in sets[:n]:
                same = first.axis == later.axis and isclose(
                    first.period_px, later.period_px, rel_tol=SAME_PERIOD
                )
                if same and not later.repeat:
                    raise ValueError(
                        f"frames.{i} and frames.{j} are both {first.axis} fringes of {first.period_px:g} px and would be "
                        f"fitted as one set of {first.steps + later.steps} steps: correct axis or period_px, or set "
                        f"repeat = true in frames.{j} if the same fringes are shown again; other brightnesses or exposure "
                        "times of the same set belong in exposures_ms"
                    )
                if same and first.period_px != later.period_px:
                    raise ValueError(
                        f"frames.{j} repeats the fringes of frames.{i}: give both the same period_px"
                    )
        return self

    @model_validator(mode="after")
    def _fringes_give_a_phase(self) -> Self:
        if why := incomplete(self.frames):
            raise ValueError(why)
        maps = [isinstance(shown, PhaseMap | OrderMap) for shown in self.frames]
        if any(maps) and not all(maps):
            raise ValueError(
                "frames mixes phase maps with images: a manifest has the one or the other"
            )
        return self

    @property
    def patterns(self) -> tuple[Frame, ...]:
        """What each frame of the measurement shows."""
        return tuple(
            frame
            for shown in self.frames
            if not isinstance(shown, PhaseMap | OrderMap)
            for frame in shown.frames()
        )
