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

`Capture.load` reads it, `stack` the images. What the images themselves contradict is `decode.check`'s affair.
"""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    model_validator,
)

from scenes import images, opencv_calibration
from scenes.calibration import Calibration
from scenes.errors import FileError, nearest
from scenes.foreign_text import parse_toml
from scenes.frozen import Frozen
from scenes.patterns import Axis, Bits, Frame, gray_frames
from scenes.rig import Resolution
from scenes.sensor import Sensor, SimpleSensor
from scenes.stack import Stack


class Fringes(Frozen):
    """Phase-shifted sinusoids of one period along one axis: ``cos(2 pi (u - origin_px) / period_px + shift_k)``."""

    kind: Literal["fringes"] = "fringes"
    axis: Axis
    period_px: Annotated[float, Field(gt=2.0)]
    steps: Annotated[int, Field(ge=3, le=64)]
    first_phase_deg: float = 0.0
    """Shift of the first frame; a sine is a cosine of first phase -90."""
    direction: Literal[1, -1] = 1
    """Sign of the shift from frame to frame."""
    shifts_deg: tuple[float, ...] | None = None
    """Shift of every frame, where they are not equal steps of 360 / steps."""
    origin_px: float = 0.0
    """Continuous projector coordinate where the cosine's phase is zero: 0.5 for patterns computed from a pixel's index."""

    @model_validator(mode="after")
    def _one_shift_a_step(self) -> Self:
        if self.shifts_deg is not None and len(self.shifts_deg) != self.steps:
            raise ValueError(
                f"shifts_deg has {len(self.shifts_deg)} values for {self.steps} steps: give one for each"
            )
        return self

    def frames(self) -> list[Frame]:
        """The frames in the order shown."""
        degrees = self.shifts_deg or tuple(
            self.first_phase_deg + self.direction * 360.0 * k / self.steps
            for k in range(self.steps)
        )
        back = 2.0 * np.pi * self.origin_px / self.period_px
        return [
            Frame(self.axis, self.period_px, k, self.steps, float(np.deg2rad(shift)) - back)
            for k, shift in enumerate(degrees)
        ]


class GrayFrames(Frozen):
    """Reflected Gray code along one axis, its code 0 at the projector's first pixel."""

    kind: Literal["gray"] = "gray"
    axis: Axis
    bits: Bits
    cell_px: PositiveFloat = 1.0
    """Projector pixels that share a code."""
    inverse: Literal["after-each", "after-all", "none"] = "after-each"
    """Where the inverted frames stand."""
    order: Literal["coarse-first", "fine-first"] = "coarse-first"
    """Which bit comes first."""

    def frames(self) -> list[Frame]:
        """The frames in the order shown."""
        pairs = gray_frames(self.axis, self.bits, self.cell_px, self.inverse != "none")
        if self.order == "fine-first":
            pairs.sort(key=lambda frame: -frame.step)
        if self.inverse == "after-all":
            pairs.sort(key=lambda frame: frame.inverted)
        return pairs


class Uniform(Frozen):
    """One white or black frame."""

    kind: Literal["white", "black"]

    def frames(self) -> list[Frame]:
        """The frame."""
        return [Frame("column", 0.0, 0, 1, 0.0, 0, self.kind)]


class Skip(Frozen):
    """Images that are no part of the measurement, such as a colour picture."""

    kind: Literal["skip"] = "skip"
    count: PositiveInt = 1

    def frames(self) -> list[Frame]:
        """None."""
        return []


# Errors of a manifest that are told at once.
MOST_TOLD = 10

Shown = Annotated[Fringes | GrayFrames | Uniform | Skip, Field(discriminator="kind")]


class Capture(Frozen):
    """A manifest: how image files become a `Stack`."""

    files: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names or globs, relative to the manifest's folder, in the order shown; a glob's matches in natural order."""
    folder: Path = Path()
    """Folder of the files, relative to the manifest's."""
    frames: Annotated[tuple[Shown, ...], Field(min_length=1)]
    """What the frames show, in order."""
    exposures_ms: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] = (1.0,)
    """Exposure times; several: all frames at the first time, then all at the next."""
    exposures_innermost: bool = False
    """Every exposure of a frame comes before the next frame."""
    channel: images.ImageChannel = "grey"
    bits: Annotated[int, Field(ge=8, le=16)] = 8
    """Bits of a digital number, as the camera gives it."""
    saturation_dn: PositiveFloat | None = None
    """From here up a sample is saturated; absent: the end of the range."""
    dark_dn: NonNegativeFloat = 0.0
    """Digital number of no light."""
    noise_dn: PositiveFloat | None = None
    """Standard deviation of the noise; absent: estimated from the frames."""
    projector_resolution: Resolution | None = None
    """Columns, rows of the projector; absent: the calibration's."""
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
        return self

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a manifest; paths in it are resolved against its folder. Raises `FileError`, naming key and cause."""
        source = Path(path)
        try:
            tree = parse_toml(source.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise FileError(f"manifest '{source}' cannot be read: {error}") from error
        try:
            capture = cls.model_validate(tree)
        except ValidationError as error:
            told = [f"manifest '{source}': {_told(e)}" for e in error.errors()[:MOST_TOLD]]
            raise FileError("\n".join(told)) from None
        base = source.resolve().parent
        placed: dict[str, Any] = {"folder": base / capture.folder}
        if capture.calibration:
            files = tuple(base / file for file in capture.calibration.files)
            placed["calibration"] = capture.calibration.model_copy(update={"files": files})
        return capture.model_copy(update=placed)

    @property
    def patterns(self) -> tuple[Frame, ...]:
        """What each kept frame shows."""
        return tuple(frame for shown in self.frames for frame in shown.frames())

    def paths(self) -> list[list[Path]]:
        """Files by exposure and kept frame. Raises `FileError` if there are too many or too few."""
        found = images.find(self.folder, self.files)
        kept: list[bool] = []
        for shown in self.frames:
            kept += (
                [False] * shown.count if isinstance(shown, Skip) else [True] * len(shown.frames())
            )
        times = len(self.exposures_ms)
        if len(found) != len(kept) * times:
            raise FileError(
                f"'{self.folder}' has {len(found)} images for this manifest, which describes {len(kept)} frames"
                + (f" at {times} exposures" if times > 1 else "")
                + f": {'add the missing' if len(found) < len(kept) * times else 'leave out the surplus'} "
                f"{abs(len(kept) * times - len(found))}, or correct the manifest's frames"
            )
        grid = np.arange(len(found)).reshape(
            (len(kept), times) if self.exposures_innermost else (times, len(kept))
        )
        grid = grid.T if self.exposures_innermost else grid
        return [[found[i] for i, keep in zip(row, kept, strict=True) if keep] for row in grid]

    def stack(self) -> Stack:
        """Read the images. Raises `FileError` for whatever file, size, depth or calibration does not fit."""
        paths = self.paths()
        flat = images.read([path for row in paths for path in row], self.channel)
        frames = flat.reshape(len(paths), len(paths[0]), *flat.shape[1:])
        check_depth(frames, self.bits)
        sensor: Sensor = self.sensor or SimpleSensor(
            bits=self.bits,
            black_level_dn=self.dark_dn,
            sigma_dn=self.noise_dn or noise_dn(frames),
            saturated_from_dn=self.saturation_dn,
        )
        size = (frames.shape[3], frames.shape[2])
        return Stack(frames, self.patterns, self.exposures_ms, sensor, self._rig(size))

    def _rig(self, size: tuple[int, int]) -> Calibration | None:
        if self.calibration is None:
            return self.rig
        return self.calibration.calibration(size, self.projector_resolution)


def check_depth(frames: NDArray[Any], bits: int) -> None:
    """Raise `FileError` if digital numbers cannot come from a camera of that many bits."""
    stored = frames.dtype.itemsize * 8
    if bits > stored:
        raise FileError(
            f"bits = {bits}, but the files hold {stored}-bit numbers: set bits = {stored}"
        )
    brightest = int(frames.max())
    if brightest > 2**bits - 1:
        raise FileError(
            f"bits = {bits} ends at {2**bits - 1}, but the brightest sample is {brightest}: set bits = "
            f"{max(brightest.bit_length(), 8)}, or {stored} if the camera's bits stand at the upper end"
        )
    full = [n for n in range(8, bits) if brightest == 2**n - 1]
    # a sample exactly at a shorter converter's end, in many pixels, is that converter clipping
    # frame by frame: a mask of all of them is half as large as they are
    clipped = sum(int((f == brightest).sum()) for frame in frames for f in frame) if full else 0
    if clipped > 10:
        raise FileError(
            f"bits = {bits}, but {clipped} samples stand exactly at {brightest} and none "
            f"above: the camera has {full[0]} bits; set bits = {full[0]}, or saturation would go unseen"
        )


def noise_dn(frames: NDArray[Any]) -> float:
    """Standard deviation of the noise, DN, seen as roughness of the frames (exposure, frame, row, col).

    Weights 1 -2 1 by 1 -2 1 cancel whatever is linear along a row or a column; the mean absolute value over the brightest
    tenth of the pixels gives sigma (Immerkaer, CVIU 64, 300 (1996)), without the roughest tenth, which is edges.
    Never below rounding noise.
    """
    every = max(1, frames.shape[1] // 6)
    sigmas: list[float] = [
        _roughness(frame)
        for frame in frames.reshape(-1, *frames.shape[2:])[::every]
        if min(frame.shape) >= 3
    ]
    return float(max(np.median(sigmas) if sigmas else 0.0, np.sqrt(1.0 / 12.0)))


# Mean |x| of the smaller nine tenths of Gaussian numbers, in standard deviations: sqrt(2/pi) (1 - exp(-a^2/2)) / 0.9 with
# a = 1.645 the limit of those nine tenths.
TRIMMED_MEAN = 0.6573


def _roughness(frame: NDArray[Any]) -> float:
    plane = frame.astype(np.float32)
    rough = np.abs(np.diff(np.diff(plane, 2, axis=0), 2, axis=1))
    centre = plane[1:-1, 1:-1]
    seen = rough[centre >= np.percentile(centre, 90.0)]
    kept = np.sort(seen)[: max(1, int(0.9 * seen.size))]
    # the weights' squares sum to 36
    return float(kept.mean()) / (6.0 * TRIMMED_MEAN)


def _told(error: Any) -> str:
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return f"unknown key '{key}': {nearest(str(error['loc'][-1]), _keys())}"
    if error["type"] == "missing":
        return f"key '{key}' is missing: it is required"
    return f"{key}: {error['msg'].removeprefix('Value error, ')}"


def _keys() -> list[str]:
    models = (Capture, Fringes, GrayFrames, Uniform, Skip, opencv_calibration.Source)
    return [name for model in models for name in model.model_fields]
