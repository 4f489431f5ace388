"""Raw frames as a camera delivers them, with all that a decoder may know."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import OpenEXR
from numpy.typing import DTypeLike, NDArray
from pydantic import BaseModel

from scenes.acquisition.patterns import Frame
from scenes.acquisition.sensor import Sensor
from scenes.files import exr_rows
from scenes.files.exr import Identity
from scenes.files.exr_rows import Bands
from scenes.rig.calibration import Calibration
from scenes.rig.devices import Resolution
from scenes.support import mapped
from scenes.support.errors import DecodeError, FileError
from scenes.support.notebook import Displayed, PreviewPlane
from scenes.support.validation_words import in_words

KIND = "stack"
DTYPES = (np.uint8, np.uint16, np.float32)
# Whole numbers up to here are exact in a half float (11 bits of significand).
HALF_EXACT = 2048
# A reconstruction holds the index of the exposure used in 8 bits; 255 means several or none.
MAX_EXPOSURES = 255


@dataclass(frozen=True, eq=False, repr=False)
class Stack(Displayed):
    """Raw frames of all exposures and patterns, with the sensor and the calibration.

    Raises `DecodeError` for frames, times and patterns that do not fit each other.

    Examples
    --------
    >>> import numpy as np, scenes
    >>> shown = scenes.PhaseShift(steps=4, periods_px=(16.0,)).frames()
    >>> frames = np.zeros((1, 4, 48, 64), np.uint8)
    >>> scenes.Stack(frames, shown, exposure_ms=(2.0,), sensor=scenes.SimpleSensor()).resolution
    (64, 48)
    """

    frames: NDArray[Any]
    """(exposure, frame, row, col) in DN; uint8, uint16 or float32."""
    patterns: tuple[Frame, ...]
    """One per frame, in order."""
    exposure_ms: tuple[float, ...]
    """One per exposure."""
    sensor: Sensor
    calibration: Calibration | None = None
    scene: str = ""
    """TOML of the scene it was made from; empty for real captures."""
    seed: int | None = None
    """Seed of its noise; None for real captures."""
    projector_resolution: tuple[int, int] | None = None
    """Columns, rows of the projectors where there is no calibration; None: unknown. See `projector_size`."""
    gamma: float | None = None
    """Gamma of the fringes' response, which decoding undoes; None: linear."""
    identity: Identity = field(default_factory=dict)
    """Digests of what was traced, see `scenes.scene_identity`; empty: not known, or a real capture."""

    def _facts(self) -> dict[str, str]:
        exposures, frames, rows, columns = self.frames.shape
        times = " ".join(f"{time:.3g}" for time in self.exposure_ms[:8])
        times += " ..." if exposures > 8 else ""
        return {
            "size": f"{columns} x {rows} px",
            "frames": f"{exposures} x {frames} ({self.frames.dtype})",
            "exposures": f"{times} ms",
            "sensor": self.sensor.kind,
            "calibration": "yes" if self.calibration else "no",
        }

    def _planes(self) -> list[PreviewPlane]:
        return [
            PreviewPlane(f"First frame at {time:.3g} ms", "DN", self.frames[e, 0])
            for e, time in enumerate(self.exposure_ms[:4])
        ]

    def __post_init__(self) -> None:
        shape = self.frames.shape
        if self.frames.dtype not in DTYPES:
            raise DecodeError(
                f"frames are {self.frames.dtype}: a stack holds uint8, uint16 or float32"
            )
        if len(shape) != 4 or 0 in shape:
            raise DecodeError(
                f"frames have shape {shape}: expected (exposure, frame, row, col), none of them 0"
            )
        if shape[0] != len(self.exposure_ms) or shape[1] != len(self.patterns):
            raise DecodeError(
                f"frames have shape {shape} (exposure, frame, row, col), but {len(self.exposure_ms)} exposure "
                f"times and {len(self.patterns)} patterns are given: make them agree"
            )
        if shape[0] > MAX_EXPOSURES:
            raise DecodeError(
                f"{shape[0]} exposures are given: a stack holds up to {MAX_EXPOSURES}; leave some out"
            )
        if not all(0.0 < time_ms < float("inf") for time_ms in self.exposure_ms):
            raise DecodeError(
                f"exposure times are {list(self.exposure_ms)} ms: each must be finite and more than 0"
            )

    @property
    def saturation_dn(self) -> float:
        """From this digital number up a sample is saturated."""
        return self.sensor.saturation_dn

    @property
    def resolution(self) -> tuple[int, int]:
        """Columns, rows."""
        return self.frames.shape[3], self.frames.shape[2]

    def projector_size(self, projector: int = 0) -> tuple[int, int] | None:
        """Columns, rows of a projector, from the calibration, else `projector_resolution`; None: unknown."""
        if self.calibration is not None and projector < len(self.calibration.projectors):
            return self.calibration.projectors[projector].resolution
        return self.projector_resolution

    def write(self, path: str | Path) -> None:
        """Write as EXR, one channel a frame, named ``E<exposure>.F<frame>``; digital numbers survive exactly."""
        planes = [frame for exposure in self.frames for frame in exposure]
        channels = dict(zip(_names(*self.frames.shape[:2]), planes, strict=True))
        meta = {
            "dtype": str(self.frames.dtype),
            "units": {"frames": "DN", "exposure_ms": "ms", "period_px": "projector px"},
            "patterns": [asdict(frame) for frame in self.patterns],
            "exposure_ms": list(self.exposure_ms),
            "sensor": self.sensor.model_dump(mode="json"),
            "calibration": self.calibration and self.calibration.model_dump(mode="json"),
            "scene": self.scene,
            "identity": dict(self.identity),
            "seed": self.seed,
            "projector_resolution": self.projector_resolution,
            "gamma": self.gamma,
        }
        standard = {
            "expTime": float(self.exposure_ms[0]) * 1e-3,
            # For noisy counts twice as fast as ZIP, and smaller (docs/files.md).
            "compression": OpenEXR.PIZ_COMPRESSION,
        }
        exr_rows.write(path, KIND, channels, meta, standard, _stored(self.frames))

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a stack; raises `FileError` for anything but a complete stack file of this version."""
        with exr_rows.reading(path, KIND) as bands:
            try:
                told = _Header.model_validate(bands.meta)
                size = len(told.exposure_ms), len(told.patterns)
                dtype = np.dtype(str(bands.meta["dtype"]))
                return cls(_frames(bands, *size, dtype, f"'{path}'"), **dict(told))
            except (KeyError, TypeError, ValueError, DecodeError) as error:
                raise FileError(
                    f"'{path}': its stack header or channels are damaged: {in_words(error)}"
                ) from error


class _Header(BaseModel):
    """What a file's header says of a stack; what is not required is not in older files."""

    patterns: tuple[Frame, ...]
    exposure_ms: tuple[float, ...]
    sensor: Sensor
    calibration: Calibration | None
    scene: str
    seed: int | None
    projector_resolution: Resolution | None = None
    gamma: float | None = None
    identity: dict[str, str] = {}


def _names(exposures: int, frames: int) -> list[str]:
    return [f"E{e:02d}.F{f:03d}" for e in range(exposures) for f in range(frames)]


def _stored(frames: NDArray[Any]) -> DTypeLike:
    """The smallest channel type that holds each digital number exactly: half, else float32."""
    if frames.dtype == np.uint8:
        return np.float16
    if frames.dtype == np.float32:
        return np.float32
    for exposure in frames:
        for frame in exposure:
            if int(frame.max()) > HALF_EXACT:
                return np.float32
            mapped.release_pages(frame)
    return np.float16


def _exact_in_half(stored: NDArray[Any], dtype: np.dtype[Any]) -> bool:
    """Whether numbers of that type, of which these are left in half floats, were not rounded."""
    return dtype.kind != "f" and not (stored > HALF_EXACT).any()


def _frames(
    bands: Bands, exposures: int, count: int, dtype: np.dtype[Any], source: str
) -> NDArray[Any]:
    """The channels as (exposure, frame, row, col); `ValueError` unless each is there and complete."""
    names = _names(exposures, count)
    if set(bands.names) != set(names) or len(bands.names) != len(names):
        raise ValueError(
            f"missing or surplus channels: {sorted(set(bands.names) ^ set(names))[:4]}"
        )
    if dtype not in DTYPES:
        raise ValueError(f"frames are {dtype}")
    frames: NDArray[Any] | None = None
    for rows, channels in bands:
        # A header may claim any size; a band that could be read confirms the width.
        if frames is None:
            frames = mapped.array(
                (exposures, count, *bands.size), dtype, source, "read it on a larger machine"
            )
        for name, plane in zip(names, frames.reshape(-1, *bands.size), strict=True):
            stored = channels.pop(name)
            if stored.dtype == np.float16 and not _exact_in_half(stored, dtype):
                raise ValueError(
                    f"channel {name} was converted to half floats, which do not hold {dtype} exactly"
                )
            with np.errstate(invalid="ignore"):
                plane[rows] = stored
            if dtype.kind != "f" and not np.array_equal(plane[rows], stored):
                raise ValueError(f"channel {name} holds numbers that are no {dtype}")
        mapped.release_pages(frames)
    assert frames is not None  # An image has at least one row.
    return frames
