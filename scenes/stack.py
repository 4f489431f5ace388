"""Raw frames as a camera delivers them, with what a decoder may know."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from scenes import exr
from scenes.calibration import Calibration
from scenes.errors import DecodeError, FileError
from scenes.patterns import Frame
from scenes.sensor import Sensor

KIND = "stack"


@dataclass(frozen=True, eq=False)
class Stack:
    """Frames (exposure, frame, row, col) in digital numbers; uint8, uint16 or float32."""

    frames: NDArray[Any]
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

    def __post_init__(self) -> None:
        shape = self.frames.shape
        if self.frames.dtype not in (np.uint8, np.uint16, np.float32):
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

    @property
    def saturation_dn(self) -> float:
        """From this digital number up a sample is saturated."""
        return self.sensor.saturation_dn

    @property
    def resolution(self) -> tuple[int, int]:
        """Columns, rows."""
        return self.frames.shape[3], self.frames.shape[2]

    def write(self, path: str | Path) -> None:
        """Write as EXR, one channel a frame, named ``E<exposure>.F<frame>``; counts survive exactly."""
        planes = exr.counts(self.frames)
        channels = {
            f"E{e:02d}.F{f:03d}": planes[e, f]
            for e in range(planes.shape[0])
            for f in range(planes.shape[1])
        }
        meta = {
            "dtype": str(self.frames.dtype),
            "units": {"frames": "DN", "exposure_ms": "ms", "period_px": "projector px"},
            "patterns": [asdict(frame) for frame in self.patterns],
            "exposure_ms": list(self.exposure_ms),
            "sensor": self.sensor.model_dump(mode="json"),
            "calibration": self.calibration and self.calibration.model_dump(mode="json"),
            "scene": self.scene,
            "seed": self.seed,
        }
        exr.write(path, KIND, channels, meta, {"expTime": float(self.exposure_ms[0]) * 1e-3})

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a stack; raises `FileError` on anything but a whole stack file of this version."""
        channels, meta = exr.read(path, KIND)
        try:
            patterns = TypeAdapter(tuple[Frame, ...]).validate_python(meta["patterns"])
            exposure_ms = TypeAdapter(tuple[float, ...]).validate_python(meta["exposure_ms"])
            sensor: Sensor = TypeAdapter(Sensor).validate_python(meta["sensor"])
            calibration = meta["calibration"]
            frames = _frames(
                channels, len(exposure_ms), len(patterns), np.dtype(str(meta["dtype"]))
            )
            return cls(
                frames,
                patterns,
                exposure_ms,
                sensor,
                None if calibration is None else Calibration.model_validate(calibration),
                str(meta["scene"]),
                meta["seed"],
            )
        except (KeyError, TypeError, ValueError, ValidationError, DecodeError) as error:
            raise FileError(
                f"'{path}': its stack header or channels are damaged: {error}"
            ) from error


def _frames(
    channels: dict[str, NDArray[Any]], exposures: int, frames: int, dtype: np.dtype[Any]
) -> NDArray[Any]:
    """The channels as (exposure, frame, row, col), one by one; `ValueError` unless each is there and whole."""
    names = [f"E{e:02d}.F{f:03d}" for e in range(exposures) for f in range(frames)]
    if channels.keys() != set(names):
        raise ValueError(f"missing or surplus channels: {sorted(channels.keys() ^ set(names))[:4]}")
    planes = np.empty((len(names), *channels[names[0]].shape), dtype)
    for name, plane in zip(names, planes, strict=True):
        stored = channels.pop(name)
        with np.errstate(invalid="ignore"):
            plane[:] = stored
        if dtype.kind != "f" and not np.array_equal(plane, stored):
            raise ValueError(f"channel {name} holds numbers that are no {dtype}")
    return planes.reshape(exposures, frames, *planes.shape[1:])
