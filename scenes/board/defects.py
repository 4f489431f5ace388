"""Printing defects: probability, size, and name in labels.

Each pad draws each defect independently, so a pad may have several. The exceptions: a missing deposit has no other
defect of shape, and a volume (or an area) is either too low or too high.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field

from scenes.support.distribution import NonNegative, Quantity, Uniform, draw, within
from scenes.support.frozen import Frozen

DefectClass = Literal[
    "missing",
    "insufficient",
    "excess",
    "low-area",
    "high-area",
    "offset",
    "peak",
    "smear",
    "bridge",
    "contamination",
]
CLASSES: tuple[DefectClass, ...] = get_args(DefectClass)

Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Length = Annotated[Quantity, within(0.001)]


class Defect(Frozen):
    """What all defects share."""

    probability: Probability = 0.0
    """For each pad; for a bridge, each pair of neighbouring pads."""


class Missing(Defect):
    """No paste left the aperture."""


class Insufficient(Defect):
    """Too little volume at the same footprint."""

    volume: Annotated[Quantity, within(0.01, 1.0)] = Uniform(low=0.2, high=0.6)
    """Relative to the volume it would have had."""


class Excess(Defect):
    """Too much volume at the same footprint."""

    volume: Annotated[Quantity, within(1.0, 10.0)] = Uniform(low=1.5, high=2.5)


class LowArea(Defect):
    """Too small a footprint at unchanged volume: paste that drew together."""

    area: Annotated[Quantity, within(0.05, 1.0)] = Uniform(low=0.4, high=0.7)
    """Relative to the footprint it would have had."""


class HighArea(Defect):
    """Too large a footprint at unchanged volume: paste pressed out under the stencil."""

    area: Annotated[Quantity, within(1.0, 10.0)] = Uniform(low=1.3, high=1.8)


class Offset(Defect):
    """Printed off its pad or turned."""

    distance: NonNegative = Uniform(low=0.3, high=0.6)
    """How far, relative to the aperture's shorter side."""
    direction_deg: Quantity = Uniform(low=0.0, high=360.0)
    rotation_deg: Quantity = Uniform(low=-15.0, high=15.0)


class Peak(Defect):
    """A tip drawn up as the stencil lifted."""

    height_mm: Length = Uniform(low=0.06, high=0.15)
    """Above the deposit around it; its paste comes from the deposit, at most half of it."""
    width_mm: Length = Uniform(low=0.06, high=0.15)
    """Full width at half height."""


class Smear(Defect):
    """A thin tail wiped off the deposit over the board."""

    length_mm: Length = Uniform(low=0.15, high=0.4)
    width: Annotated[Quantity, within(0.05, 1.0)] = Uniform(low=0.4, high=0.9)
    """Relative to the aperture's shorter side."""
    height_mm: Length = Uniform(low=0.02, high=0.06)
    """At the deposit, above the pad's surface; it thins to a third at its end."""
    direction_deg: Quantity = Uniform(low=0.0, high=360.0)


class Bridge(Defect):
    """Paste that joins two neighbours."""

    longest_mm: Annotated[float, Field(gt=0.0)] = 0.4
    """Pads further apart are not neighbours."""
    width_mm: Length = Uniform(low=0.1, high=0.3)
    height_mm: Length = Uniform(low=0.05, high=0.1)
    """Above the pads' surface."""


class Contamination(Defect):
    """A foreign body on or next to the pad: dust, a drop of flux, a chip of laminate."""

    material: str = "laminate"
    radius_mm: Length = Uniform(low=0.05, high=0.2)
    height_mm: Length = Uniform(low=0.03, high=0.2)
    """Above the pads' surface."""
    distance: NonNegative = Uniform(low=0.5, high=1.5)
    """From the pad's centre, relative to half the aperture's longer side."""


class Scratch(Defect):
    """A groove through the mask, down to copper or laminate; a pad's finish stays whole."""

    length_mm: Length = Uniform(low=0.5, high=4.0)
    """Between the middles of its round ends."""
    width_mm: Length = Uniform(low=0.03, high=0.12)
    direction_deg: Quantity = Uniform(low=0.0, high=360.0)
    distance: NonNegative = Uniform(low=0.5, high=2.0)
    """Of its middle from the pad's, relative to half the aperture's longer side."""


class Residue(Defect):
    """A patch of a thin film, such as flux or a stain of cleaning; it follows what is below."""

    material: str = "flux"
    radius_mm: Length = Uniform(low=0.2, high=0.8)
    """Of the disk of its area."""
    height_mm: Length = 0.008
    """Of the film, the same for a whole board."""
    distance: NonNegative = Uniform(low=0.0, high=2.0)
    """Of its middle from the pad's, relative to half the aperture's longer side."""


class Defects(Frozen):
    """All defects; absent ones never occur."""

    missing: Missing = Missing()
    insufficient: Insufficient = Insufficient()
    excess: Excess = Excess()
    low_area: LowArea = LowArea()
    high_area: HighArea = HighArea()
    offset: Offset = Offset()
    peak: Peak = Peak()
    smear: Smear = Smear()
    bridge: Bridge = Bridge()
    contamination: Contamination = Contamination()
    scratch: Scratch = Scratch()
    residue: Residue = Residue()


@dataclass(frozen=True)
class Tail:
    """A drawn smear."""

    length_mm: float
    width: float
    height_mm: float
    direction_rad: float


@dataclass(frozen=True)
class Speck:
    """A drawn contamination; `at` relative to half the aperture's longer side."""

    radius_mm: float
    height_mm: float
    at: tuple[float, float]


@dataclass(frozen=True)
class PadDefects:
    """The defects drawn for one pad, as factors and offsets of its deposit."""

    classes: tuple[DefectClass, ...] = ()
    volume: float = 1.0
    area: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)
    """Relative to the aperture's shorter side."""
    rotation_rad: float = 0.0
    peak_mm: float = 0.0
    peak_width_mm: float = 0.1
    peak_at: tuple[float, float] = (0.0, 0.0)
    tail: Tail | None = None
    speck: Speck | None = None


def draw_defects(defects: Defects, rng: np.random.Generator) -> PadDefects:
    """Draw one pad's defects: the classes that occur, and their sizes in mm and radians."""
    # One number decides each class, drawn before any size, so that raising one probability moves no other class.
    happens = dict(zip(CLASSES, rng.random(len(CLASSES)), strict=True))

    def occurs(name: DefectClass) -> bool:
        defect: Defect = getattr(defects, name.replace("-", "_"))
        return bool(happens[name] < defect.probability)

    speck = _speck(defects.contamination, rng) if occurs("contamination") else None
    contaminated: tuple[DefectClass, ...] = ("contamination",) if speck else ()
    if occurs("missing"):
        return PadDefects(("missing", *contaminated), volume=0.0, speck=speck)
    classes: list[DefectClass] = []
    changes: dict[str, object] = {}
    if occurs("insufficient"):
        classes.append("insufficient")
        changes["volume"] = draw(defects.insufficient.volume, rng)
    elif occurs("excess"):
        classes.append("excess")
        changes["volume"] = draw(defects.excess.volume, rng)
    if occurs("low-area"):
        classes.append("low-area")
        changes["area"] = draw(defects.low_area.area, rng)
    elif occurs("high-area"):
        classes.append("high-area")
        changes["area"] = draw(defects.high_area.area, rng)
    if occurs("offset"):
        classes.append("offset")
        distance = draw(defects.offset.distance, rng)
        direction = np.deg2rad(draw(defects.offset.direction_deg, rng))
        changes["shift"] = (
            distance * float(np.cos(direction)),
            distance * float(np.sin(direction)),
        )
        changes["rotation_rad"] = float(np.deg2rad(draw(defects.offset.rotation_deg, rng)))
    if occurs("peak"):
        classes.append("peak")
        changes["peak_mm"] = draw(defects.peak.height_mm, rng)
        changes["peak_width_mm"] = draw(defects.peak.width_mm, rng)
        x, y = rng.uniform(-0.6, 0.6, 2)
        changes["peak_at"] = (float(x), float(y))
    if occurs("smear"):
        classes.append("smear")
        changes["tail"] = _tail(defects.smear, rng)
    return PadDefects((*classes, *contaminated), speck=speck, **changes)  # type: ignore[arg-type]


def _tail(smear: Smear, rng: np.random.Generator) -> Tail:
    return Tail(
        draw(smear.length_mm, rng),
        draw(smear.width, rng),
        draw(smear.height_mm, rng),
        float(np.deg2rad(draw(smear.direction_deg, rng))),
    )


def _speck(contamination: Contamination, rng: np.random.Generator) -> Speck:
    radius, height = draw(contamination.radius_mm, rng), draw(contamination.height_mm, rng)
    distance, angle = draw(contamination.distance, rng), rng.uniform(0.0, 2.0 * np.pi)
    return Speck(radius, height, (distance * float(np.cos(angle)), distance * float(np.sin(angle))))
