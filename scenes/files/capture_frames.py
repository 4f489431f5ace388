"""What the images of a capture show, as a manifest describes it."""

from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from scenes.acquisition.patterns import Axis, Bits, Frame, gray_frames
from scenes.support.frozen import Frozen


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
            self.first_phase_deg + self.direction * 360.0 * k / self.steps
            for k in range(self.steps)
        )
        back = 2.0 * np.pi * self.origin_px / self.period_px
        return [
            Frame(self.axis, self.period_px, k, self.steps, float(np.deg2rad(shift)) - back)
            for k, shift in enumerate(degrees)
        ]


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
    """Where the inverted frames stand."""
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
    """One white or black frame."""

    kind: Literal["white", "black"]

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


Shown = Annotated[Fringes | GrayFrames | FlatFrame | SkippedImages, Field(discriminator="kind")]

# Codes that other programs show and a manifest cannot say, with the nearest that it can.
NEAREST_KINDS = {
    "binary": 'a plain binary code is {kind = "gray", code = "plain", ...}',
    "gray-code": 'Gray code is {kind = "gray", axis = "column", bits = 10}',
    "phase-shift": 'phase-shifted fringes are {kind = "fringes", axis = "column", period_px = 16.0, steps = 4}',
    "sinusoid": 'phase-shifted fringes are {kind = "fringes", axis = "column", period_px = 16.0, steps = 4}',
    "shift-gray": (
        "a Gray code shown again with a shift is read once: give one of the two as gray with its origin_px, and the other's "
        'images as {kind = "skip", count = ...}; together with fringes, cells of half a period do the same'
    ),
    "line-shift": (
        'lines have no phase: their Gray code alone is read; give it as gray, and the lines as {kind = "skip", count = ...}'
    ),
    "micro": (
        "sets of one or two steps give no phase of their own, and a joint fit of several periods is not offered: show three "
        "steps of each period (fringes of close periods beat to the projector's width)"
    ),
    "carrier": "a modulated carrier must be demodulated first; show plain fringes of the carrier's period",
    "fourier": (
        "a single frame gives no phase without neighbours; show three steps of that period, of which the first may be this one"
    ),
    "speckle": "random patterns are matched between two cameras, not decoded; show fringes or Gray code",
}
ALIASES = {
    "plain-binary": "binary", "graycode": "gray-code", "fringe": "phase-shift", "sine": "sinusoid", "cosine": "sinusoid",
    "shifted-gray": "shift-gray", "shifting-gray": "shift-gray", "lines": "line-shift", "line": "line-shift",
    "micro-phase-shift": "micro", "micro-phase-shifting": "micro", "embedded": "micro", "modulated": "carrier",
    "fourier-transform": "fourier", "single-shot": "fourier", "ftp": "fourier", "random": "speckle",
}  # fmt: skip


def nearest_kind(tree: Any) -> str:
    """What a manifest can say instead of a code of a kind that it cannot; empty if every kind is known or none is."""
    frames = tree.get("frames") if isinstance(tree, dict) else None
    for i, frame in enumerate(frames if isinstance(frames, list) else []):
        if not isinstance(frame, dict):
            continue
        kind = str(frame.get("kind", "")).casefold().replace("_", "-").replace(" ", "-")
        kind = ALIASES.get(kind, kind)
        if kind in NEAREST_KINDS:
            return f"frames.{i}.kind: there is no '{frame['kind']}': {NEAREST_KINDS[kind]}"
        steps = frame.get("steps")
        if kind == "fringes" and isinstance(steps, int) and 0 < steps < 3:
            return f"frames.{i}.steps is {steps}: {NEAREST_KINDS['micro']}"
    return ""
