"""A real capture: the image files of a manifest, read into a `Stack`.

`Capture.load` reads the manifest, `imported` the images. What the frames contradict is found by `decode.checks`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import ValidationError

from scenes.acquisition.patterns import Frame
from scenes.acquisition.sensor import Sensor, SimpleSensor
from scenes.files import images, phase_maps, single_shot
from scenes.files.capture_frames import OrderMap, PhaseMap, SingleShot, SkippedImages, nearest_kind
from scenes.files.capture_manifest import CaptureManifest, SecondView
from scenes.files.digital_range import DigitalRange
from scenes.files.stack import Stack
from scenes.support.errors import FileError
from scenes.support.finding import Finding
from scenes.support.safe_parse import parse_toml
from scenes.support.validation_words import first_lines, mistakes


@dataclass(frozen=True)
class Imported:
    """A capture as it was read."""

    stack: Stack
    findings: tuple[Finding, ...]
    """What was found in the files themselves."""


class Capture(CaptureManifest):
    """A manifest: how image files become a `Stack`."""

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a manifest (TOML); paths in it are relative to its folder. `FileError` names the nearest valid key or
        value.
        """
        source = Path(path)
        try:
            tree = parse_toml(source.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise FileError(f"manifest '{source}' cannot be read: {error}") from error
        try:
            capture = cls.model_validate(tree)
        except ValidationError as error:
            hint = nearest_kind(tree)
            lines = [f"manifest '{source}': {m.message}" for m in mistakes(error, cls, tree)]
            raise FileError(
                f"manifest '{source}': {hint}" if hint else first_lines(lines)
            ) from None
        base = source.resolve().parent
        placed: dict[str, Any] = {"folder": base / capture.folder}
        if capture.second_view:
            folder = base / capture.second_view.folder
            placed["second_view"] = capture.second_view.model_copy(update={"folder": folder})
        if capture.calibration:
            files = tuple(base / file for file in capture.calibration.files)
            placed["calibration"] = capture.calibration.model_copy(update={"files": files})
        return capture.model_copy(update=placed)

    def planes(self) -> list[list[images.Plane]]:
        """File and channel by exposure and frame. Raises `FileError` if there are too many or too few files."""
        channels = (self.channel,) if isinstance(self.channel, str) else self.channel
        files = images.find(self.folder, self.files)
        found = [images.Plane(path, channel) for path in files for channel in channels]
        kept: list[bool] = []
        for shown in self.frames:
            if isinstance(shown, SkippedImages):
                kept += [False] * shown.count
            elif isinstance(shown, SingleShot | PhaseMap | OrderMap):
                kept += [True]
            else:
                kept += [True] * len(shown.frames())
        times = len(self.exposures_ms)
        if len(found) != len(kept) * times:
            of_files = f" of {len(channels)} frames" if len(channels) > 1 else ""
            surplus = len(found) - len(kept) * times
            raise FileError(
                f"'{self.folder}' has {len(files)} images{of_files} for this manifest, which describes {len(kept)} frames"
                + (f" at {times} exposures" if times > 1 else "")
                + f": {'leave out the surplus' if surplus > 0 else 'add the missing'} {abs(surplus)}, or correct the "
                "manifest's frames"
            )
        grid = np.arange(len(found)).reshape(
            (len(kept), times) if self.exposures_innermost else (times, len(kept))
        )
        grid = grid.T if self.exposures_innermost else grid
        return [[found[i] for i, keep in zip(row, kept, strict=True) if keep] for row in grid]

    def stack(self) -> Stack:
        """The stack alone.

        Returns
        -------
        stack
            Frames (exposure, frame, row, col) in DN, with the calibration; see `imported`.
        """
        return self.imported().stack

    def imported(self) -> Imported:
        """Read the images and the calibration.

        Returns
        -------
        imported
            The stack, and what was found in the files.

        Raises
        ------
        FileError
            A file, its size or depth, or the calibration does not fit the manifest.
        """
        if self.second_view is not None:
            return self._of_pair(self.second_view)
        if isinstance(self.frames[0], PhaseMap | OrderMap):
            return self._of_maps()
        planes = self.planes()
        flat = images.read([plane for row in planes for plane in row])
        frames = flat.reshape(len(planes), len(planes[0]), *flat.shape[1:])
        sensor, findings = self._sensor(frames)
        shots = [shown for shown in self.frames if isinstance(shown, SingleShot)]
        if shots:
            shown = [s for s in self.frames if not isinstance(s, SkippedImages)]
            frames = single_shot.expanded(frames, shown, sensor.saturation_dn)
        said = "the phase is its neighbourhood's: right where height and brightness change little over a fringe, bent at edges"
        limits = [
            Finding(f"{s.axis} fringes of {s.period_px:g} px, single shot", "unknown", said)
            for s in shots
        ]
        return Imported(self._stack(frames, self.patterns, sensor), (*findings, *limits))

    def _stack(self, frames: Any, patterns: tuple[Frame, ...], sensor: Sensor) -> Stack:
        rig = self.rig
        if self.calibration is not None:
            size = (frames.shape[3], frames.shape[2])
            rig = self.calibration.calibration(size, self.projector_resolution)
        return Stack(
            frames,
            patterns,
            self.exposures_ms,
            sensor,
            rig,
            projector_resolution=self.projector_resolution,
            gamma=self.gamma,
        )

    def _of_pair(self, second: SecondView) -> Imported:
        """Both cameras' frames, one after the other, with the noise model of the noisier one that saturates first."""
        plain = {"second_view": None, "calibration": None}
        views = [
            self.model_copy(update=plain | changes).imported()
            for changes in ({}, {"files": second.files, "folder": second.folder})
        ]
        first, other = (view.stack for view in views)
        if first.frames.shape != other.frames.shape:
            raise FileError(
                f"the views have {first.resolution} and {other.resolution} pixels: import each by itself, and use "
                "`fringebench stereo` with the two stacks"
            )
        sensor = min(first.sensor, other.sensor, key=lambda sensor: sensor.saturation_dn)
        if isinstance(sensor, SimpleSensor):
            noise = max(
                s.sigma_dn for s in (first.sensor, other.sensor) if isinstance(s, SimpleSensor)
            )
            sensor = sensor.model_copy(update={"sigma_dn": noise})
        assert self.calibration is not None
        found = [
            replace(f, name=f"{name}, {f.name}")
            for name, view in zip(("first view", "second view"), views, strict=True)
            for f in view.findings
        ]
        stack = Stack(
            np.concatenate([first.frames, other.frames], axis=1),
            (*first.patterns, *(replace(f, camera=1) for f in other.patterns)),
            self.exposures_ms,
            sensor,
            self.calibration.camera_pair(first.resolution, self.projector_resolution),
            gamma=self.gamma,
        )
        return Imported(stack, tuple(found))

    def _of_maps(self) -> Imported:
        """The stack whose phases are those of the maps."""
        files = images.find(self.folder, self.files, phase_maps.SUFFIXES)
        made = phase_maps.as_frames(files, self.frames, self.projector_resolution)
        return Imported(self._stack(made.frames, made.patterns, made.sensor), ())

    def _sensor(self, frames: Any) -> tuple[Sensor, Sequence[Finding]]:
        """The noise model, given or found in the frames."""
        given = self.saturation_dn if self.sensor is None else self.sensor.saturation_dn
        # A single shot is one image so far.
        shown = tuple(
            frame
            for one in self.frames
            if not isinstance(one, PhaseMap | OrderMap)
            for frame in one.frames()[: 1 if isinstance(one, SingleShot) else None]
        )
        found = DigitalRange.of(frames, shown, self.bits, given)
        if self.sensor is not None:
            return self.sensor, found.findings
        sensor = SimpleSensor(
            bits=self.bits,
            black_level_dn=self.dark_dn,
            sigma_dn=self.noise_dn or found.noise_dn,
            saturated_from_dn=found.saturation_dn,
        )
        return sensor, found.findings
