"""What the images of a capture show, as a manifest describes it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from scenes.acquisition.patterns import Axis, Bits, Frame, ModulatedPhaseShift, gray_frames
from scenes.support.frozen import Frozen


class Fringes(Frozen):
    """Phase-shifted sinusoids of one period along one axis: ``cos(2 pi (u - origin_px) / period_px + shift_k)``."""

    kind: Literal["fringes"] = "fringes"
    axis: Axis
    period_px: Annotated[float, Field(gt=2.0)]
    steps: Annotated[int, Field(ge=1, le=64)]
    first_phase_deg: float = 0.0
    """Shift of the first frame; a sine is a cosine of first phase -90."""
    direction: Literal[1, -1] = 1
    """Sign of the shift from frame to frame."""
    shifts_deg: tuple[float, ...] | None = None
    """Shift of every frame, where they are not equal steps of 360 / steps (of 90 for two steps)."""
    repeat: bool = False
    """The fringes of an earlier entry are shown again; all their frames are fitted together."""
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
            self.first_phase_deg
            + self.direction * 360.0 * k / (4 if self.steps == 2 else self.steps)
            for k in range(self.steps)
        )
        back = 2.0 * np.pi * self.origin_px / self.period_px
        return [
            Frame(self.axis, self.period_px, k, self.steps, float(np.deg2rad(shift)) - back)
            for k, shift in enumerate(degrees)
        ]


class ModulatedFringes(Frozen):
    """Coarse fringes times a fine carrier, every shift of the fringes with all shifts of the carrier (Chen et al. 2008)."""

    kind: Literal["modulated"] = "modulated"
    axis: Axis
    period_px: Annotated[float, Field(gt=2.0)]
    """Period of the coarse fringes, more than three carrier periods."""
    steps: Annotated[int, Field(ge=3, le=64)]
    carrier_px: Annotated[float, Field(gt=2.0)]
    carrier_steps: Annotated[int, Field(ge=3, le=64)]
    origin_px: float = 0.0
    """Continuous projector coordinate where both cosines' phases are zero in the first frame."""

    def frames(self) -> list[Frame]:
        """The frames in the order shown."""
        coding = ModulatedPhaseShift(
            periods_px=(self.period_px,),
            carrier_px=self.carrier_px,
            steps=self.steps,
            carrier_steps=self.carrier_steps,
            axes=(self.axis,),
        )
        turn = 2.0 * np.pi * self.origin_px
        return [
            replace(
                frame,
                phase_shift_rad=frame.phase_shift_rad - turn / self.period_px,
                carrier_shift_rad=frame.carrier_shift_rad - turn / self.carrier_px,
            )
            for frame in coding.frames()
        ]


class LineShift(Frozen):
    """Lines that are shifted by their own width from frame to frame (Guehring 2001); their centre of light is a phase."""

    kind: Literal["line-shift"] = "line-shift"
    axis: Axis
    period_px: Annotated[float, Field(gt=2.0)]
    """Distance of the lines."""
    steps: Annotated[int, Field(ge=4, le=64)]
    """Frames until every pixel has been lit once."""
    direction: Literal[1, -1] = 1
    """1: the lines move to larger coordinates."""
    origin_px: float = 0.0
    """Continuous projector coordinate of the upper or left edge of a line in the first frame."""

    def frames(self) -> list[Frame]:
        """The frames in the order shown."""
        first = -2.0 * np.pi * (self.origin_px / self.period_px + 0.5 / self.steps)
        step = -2.0 * np.pi * self.direction / self.steps
        return [
            Frame(self.axis, self.period_px, k, self.steps, first + k * step, kind="line")
            for k in range(self.steps)
        ]


class SingleShot(Frozen):
    """One frame of fringes, whose phase is taken from its neighbourhood by Fourier filtering (Takeda, Ina & Kobayashi 1982).

    It is good where height and brightness change little over a fringe; edges bend it, by up to a period.
    """

    kind: Literal["single-shot"] = "single-shot"
    axis: Axis
    period_px: Annotated[float, Field(gt=2.0)]
    first_phase_deg: float = 0.0
    """Shift of the frame; a sine is a cosine of first phase -90."""
    direction: Literal[1, -1] = 1
    """1: the projector's coordinate grows along the image's columns (or rows); -1: the image is mirrored."""
    origin_px: float = 0.0
    """As for fringes."""

    def frames(self) -> list[Frame]:
        """Four steps, which importing makes of the frame."""
        four = Fringes(
            axis=self.axis,
            period_px=self.period_px,
            steps=4,
            first_phase_deg=self.first_phase_deg,
            origin_px=self.origin_px,
        )
        return four.frames()


class PhaseMap(Frozen):
    """A phase that another program computed, in radians, as an array in a .npy or .mat file; NaN where there is none."""

    kind: Literal["phase-map"] = "phase-map"
    axis: Axis
    period_px: Annotated[float, Field(gt=2.0)]
    unwrapped: bool = False
    """Whole turns are in the phase too, counted from `origin_px`."""
    sigma_rad: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    """Standard deviation of the phase's noise."""
    origin_px: float = 0.0
    """Continuous projector coordinate of phase 0."""


class OrderMap(Frozen):
    """The fringe order of the phase map before it, whole numbers: what 2 pi are counted by, phase + 2 pi order."""

    kind: Literal["order-map"] = "order-map"


class GrayFrames(Frozen):
    """Reflected Gray code, or plain binary, along one axis: the number of a pixel's cell, bit by bit."""

    kind: Literal["gray"] = "gray"
    axis: Axis
    bits: Bits
    cell_px: PositiveFloat = 1.0
    """Projector pixels that share a code."""
    origin_px: float = 0.0
    """Continuous projector coordinate at which code 0 begins: negative where a program adds an offset to the pixel's
    index, as it does to centre the code."""
    code: Literal["reflected", "plain"] = "reflected"
    """Reflected: Gray code, in which neighbouring cells differ by one bit; plain: the binary number itself."""
    inverse: Literal["after-each", "after-all", "none"] = "after-each"
    """Where the inverted frames are in the sequence."""
    order: Literal["coarse-first", "fine-first"] = "coarse-first"
    """Which bit comes first."""

    def frames(self) -> list[Frame]:
        """The frames in the order shown."""
        shift = -2.0 * np.pi * self.origin_px / self.cell_px
        pairs = [
            replace(frame, phase_shift_rad=shift, plain=self.code == "plain")
            for frame in gray_frames(self.axis, self.bits, self.cell_px, self.inverse != "none")
        ]
        if self.order == "fine-first":
            pairs.sort(key=lambda frame: -frame.step)
        if self.inverse == "after-all":
            pairs.sort(key=lambda frame: frame.inverted)
        return pairs


class FlatFrame(Frozen):
    """One white, black, or grey frame; grey is the fringes' mean, which completes two steps (2 + 1)."""

    kind: Literal["white", "black", "grey"]

    def frames(self) -> list[Frame]:
        """The frame."""
        return [Frame("column", 0.0, 0, 1, 0.0, 0, self.kind)]


class SkippedImages(Frozen):
    """Images that are no part of the measurement, such as a colour picture."""

    kind: Literal["skip"] = "skip"
    count: PositiveInt = 1

    def frames(self) -> list[Frame]:
        """None."""
        return []


Images = Fringes | ModulatedFringes | LineShift | SingleShot | GrayFrames | FlatFrame
Shown = Annotated[Images | SkippedImages | PhaseMap | OrderMap, Field(discriminator="kind")]


def incomplete(frames: Sequence[Shown]) -> str:
    """Why the fringes of an axis give no phase; empty if they do."""
    grey = any(shown.kind == "grey" for shown in frames)
    for axis in ("column", "row"):
        sets = [shown for shown in frames if isinstance(shown, Fringes) and shown.axis == axis]
        total = {
            s.period_px: sum(t.steps for t in sets if t.period_px == s.period_px) for s in sets
        }
        if not total or min(total.values()) >= 3:
            continue
        if 1 in total.values():
            if grey or total[min(total)] < 3 or len(total) < 3:
                return (
                    f"{axis} fringes of one step need two such periods or more, a finest period of three steps or more, and "
                    "projector_resolution (micro phase shifting); one frame alone is kind = 'single-shot'"
                )
        elif not grey and max(total.values()) < 3:
            return f"{axis} fringes of two steps need their mean: add the frame {{kind = 'grey'}}, or a period of three steps or more"
    return ""


# Codes that other programs show and a manifest cannot say, with the nearest that it can.
NEAREST_KINDS = {
    "binary": 'a plain binary code is {kind = "gray", code = "plain", ...}',
    "gray-code": 'Gray code is {kind = "gray", axis = "column", bits = 10}',
    "phase-shift": 'phase-shifted fringes are {kind = "fringes", axis = "column", period_px = 16.0, steps = 4}',
    "sinusoid": 'phase-shifted fringes are {kind = "fringes", axis = "column", period_px = 16.0, steps = 4}',
    "shift-gray": 'a Gray code shown again with a shift is a second {kind = "gray", ...} with its origin_px, half a cell off',
    "line-shift": 'shifted lines are {kind = "line-shift", axis = "column", period_px = 8.0, steps = 8}',
    "micro": 'sets of one or two steps are {kind = "fringes", ..., steps = 1}, one entry a period',
    "carrier": 'fringes times a carrier are {kind = "modulated", period_px = 128.0, steps = 3, carrier_px = 16.0, carrier_steps = 3}',
    "fourier": 'one frame of fringes is {kind = "single-shot", axis = "column", period_px = 16.0}',
    "2+1": 'two fringes and their mean are {kind = "fringes", ..., steps = 2} and {kind = "grey"}',
    "map": 'arrays of a phase are {kind = "phase-map", axis = "column", period_px = 16.0}, then perhaps {kind = "order-map"}',
    "speckle": "random patterns are matched between two cameras, not decoded; show fringes or Gray code",
}
ALIASES = {
    "plain-binary": "binary", "graycode": "gray-code", "fringe": "phase-shift", "sine": "sinusoid", "cosine": "sinusoid",
    "shifted-gray": "shift-gray", "shifting-gray": "shift-gray", "lines": "line-shift", "line": "line-shift", "two-plus-one": "2+1", "mean": "2+1", "phase": "map", "order": "map",
    "micro-phase-shift": "micro", "micro-phase-shifting": "micro", "embedded": "micro",
    "fourier-transform": "fourier", "ftp": "fourier", "random": "speckle",
}  # fmt: skip


def nearest_kind(tree: Any) -> str:
    """What a manifest can say instead of a code of a kind that it cannot; empty if every kind is known or none is."""
    frames = tree.get("frames") if isinstance(tree, dict) else None
    for i, frame in enumerate(frames if isinstance(frames, list) else []):
        if not isinstance(frame, dict):
            continue
        kind = str(frame.get("kind", "")).casefold().replace("_", "-").replace(" ", "-")
        kind = ALIASES.get(kind, kind)
        if kind in NEAREST_KINDS and kind != "line-shift":
            return f"frames.{i}.kind: there is no '{frame['kind']}': {NEAREST_KINDS[kind]}"
    return ""
