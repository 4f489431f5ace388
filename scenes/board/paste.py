"""Solder paste as printed: transferred volume, and the shape of one deposit.

The shape is a heightfield over the aperture, ``h = s f + p``: f the shape without units (rounded shoulder, scoop,
dog ears, texture), p a peak in mm, and the scale s solved for so that the mesh holds exactly the deposit's volume.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, model_validator
from scipy.spatial import cKDTree

from scenes.shapes.grains import Powder
from scenes.shapes.heightfield import Heightfield
from scenes.shapes.tessellation import Tessellation
from scenes.support.distribution import NonNegative, Quantity, within
from scenes.support.errors import MeshError
from scenes.support.frozen import Frozen

Floats = NDArray[np.float64]

# Plane waves that texture a smooth deposit; more make no visible difference.
WAVES = 12
# A peak takes its paste from the deposit, and never more than this share of it.
PEAK_SHARE = 0.5
# Spread of openings that empty wholly, and lumps of the transfer model.
FLOOR_CV = 0.05
LUMPS = 33.0
# Waves of the field that neighbours share.
FIELD_WAVES = 64


class TransferPoint(Frozen):
    """Statistics of deposits of one area ratio, as an inspection machine reports them."""

    area_ratio: PositiveFloat
    efficiency: Annotated[float, Field(ge=0.0, le=3.0)]
    """Mean transfer efficiency; above 1 where paste is pressed out under the stencil."""
    cv: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Coefficient of variation: standard deviation over mean."""


class Transfer(Frozen):
    """Share of an aperture's volume that stays on the board, by area ratio (IPC-7525: opening area over wall area).

    Without a table the mean is ``e = 1 - exp(-(ratio - onset) / scale)``. The defaults pass through the ends of the range
    that T. Lentz reports for laser-cut steel and Types 3-6 ("Size Matters", SMT007 Magazine, July 2019, p. 44), 5 % at
    0.30 and 60 % at 0.50, and through 80 % at 0.66, the industry's limit of acceptance at IPC-7525B's minimum area ratio,
    within 1 %. The coefficient of variation is ``sqrt(0.05^2 + (1 - e) / (33 e))``: 5 % between large openings, and the
    scatter of a share e of 33 lumps that each stay on the board or in the opening. 33 makes it 10 % at 0.66, the limit
    that print studies use (SMT007 Magazine, March 2018, p. 50). The form is a model: a table of one's own line is better.
    """

    onset: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.288
    """Area ratio up to which nothing transfers."""
    scale: PositiveFloat = 0.231
    table: tuple[TransferPoint, ...] = ()
    """Measured statistics, in rising order of area ratio; linear in between, constant beyond. It replaces both curves."""
    spread: Annotated[float, Field(ge=0.0, le=5.0)] = 1.0
    """Factor of the coefficient of variation; 0: every deposit has the mean."""
    neighbours: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3
    """Share of the variance that neighbours have in common: pressure, stencil and board vary slowly over the print."""
    reach_mm: PositiveFloat = 5.0
    """Distance at which the common part's correlation is ``exp(-1/2)``."""
    across: Annotated[float, Field(gt=0.0, le=2.0)] = 1.0
    """Transfer of long openings across the stroke relative to those along it."""
    clogging: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Growth of the exponent of the mean per print since the stencil was wiped: small openings clog first."""
    prints_since_wipe: Annotated[int, Field(ge=0, le=1000)] = 0

    @model_validator(mode="after")
    def _rising(self) -> Self:
        ratios = [point.area_ratio for point in self.table]
        if any(b <= a for a, b in pairwise(ratios)):
            raise ValueError(f"table: area ratios {ratios} must rise from row to row")
        return self

    def efficiency(self, area_ratio: float, slant: float = 0.0) -> float:
        """Mean transfer efficiency, 0 or more; `slant` is -1 for a line along the stroke, 1 for one across it."""
        if self.table:
            mean = self._interpolated(area_ratio, "efficiency")
        else:
            mean = float(-np.expm1(-max(area_ratio - self.onset, 0.0) / self.scale))
        # At most the whole opening clogs: an efficiency above 1 stays as it is.
        worn = float(mean ** (1.0 + self.clogging * self.prints_since_wipe)) if mean < 1.0 else mean
        return worn * float(self.across ** max(slant, 0.0))

    def cv(self, area_ratio: float) -> float:
        """Coefficient of variation of the volume."""
        if self.table:
            return self.spread * self._interpolated(area_ratio, "cv")
        mean = max(self.efficiency(area_ratio), 1e-3)
        return self.spread * float(np.sqrt(FLOOR_CV**2 + (1.0 - min(mean, 1.0)) / (LUMPS * mean)))

    def factor(self, area_ratio: float, deviate: float) -> float:
        """A deposit's volume relative to the mean: log-normal, of mean 1 for standard normal deviates."""
        variance = float(np.log1p(self.cv(area_ratio) ** 2))
        return float(np.exp(np.sqrt(variance) * deviate - variance / 2.0))

    def common(self, xy_mm: tuple[float, float], rng: np.random.Generator) -> float:
        """The print's smooth field at a place: standard normal over prints, for the print's own random numbers."""
        phase = rng.uniform(0.0, 2.0 * np.pi, FIELD_WAVES)
        number = rng.standard_normal((FIELD_WAVES, 2)) / self.reach_mm
        return float(np.sqrt(2.0 / FIELD_WAVES) * np.cos(number @ np.asarray(xy_mm) + phase).sum())

    def _interpolated(self, area_ratio: float, name: Literal["efficiency", "cv"]) -> float:
        ratios = [point.area_ratio for point in self.table]
        return float(np.interp(area_ratio, ratios, [getattr(point, name) for point in self.table]))


class Paste(Frozen):
    """How paste is printed: numbers, or the distributions each deposit's own are drawn from."""

    material: str = "solder-paste"
    stencil_mm: Annotated[Quantity, within(0.02, 0.5)] = 0.12
    """Stencil thickness, drawn once a print; 0.08 to 0.15 is usual."""
    transfer: Transfer = Transfer()
    volume: NonNegative = 1.0
    """Each deposit's volume relative to aperture area x stencil thickness x transfer efficiency."""
    shift_x_mm: Quantity = 0.0
    """Registration of the stencil, drawn once a print."""
    shift_y_mm: Quantity = 0.0
    turn_deg: Quantity = 0.0
    """Turn of the stencil about the middle of the region, drawn once a print."""
    stretch: Annotated[Quantity, within(-0.01, 0.01)] = 0.0
    """How much larger than the board the stencil is, mm per mm from the middle of the region, drawn once a print: it
    moves openings and leaves their sizes."""
    offset_x_mm: Quantity = 0.0
    """Scatter of each deposit about its aperture."""
    offset_y_mm: Quantity = 0.0
    rotation_deg: Quantity = 0.0
    slump_mm: NonNegative = 0.0
    """Growth of the footprint on every side at unchanged volume."""
    edge_mm: Annotated[Quantity, within(0.001, 1.0)] = 0.04
    """Radius of the rounded shoulder."""
    wall: Annotated[Quantity, within(0.05, 1.0)] = 0.3
    """Height of the upright wall at the rim, relative to the plateau."""
    scoop: Annotated[Quantity, within(0.0, 0.9)] = 0.0
    """Depth of the hollow the squeegee leaves in the middle, relative to the plateau."""
    dog_ear: Annotated[Quantity, within(0.0, 3.0)] = 0.0
    """Height of the ridges left at both ends along the stroke, relative to the plateau."""
    stroke: Literal["x", "y"] = "y"
    """Direction of printing."""
    roughness: Annotated[Quantity, within(0.0, 0.5)] = 0.0
    """Standard deviation of the surface's lumps, relative to the plateau."""
    lump_mm: PositiveFloat = 0.15
    """Wavelength of the lumps."""
    texture: Literal["smooth", "granular"] = "smooth"
    """granular: the surface is a layer of alloy grains, one diameter deep at most."""
    powder: Literal[3, 4, 5, 6, 7] = 4
    """Powder type of J-STD-005, for the grains."""
    step_mm: Annotated[float, Field(ge=0.001, le=0.2)] = 0.01
    """Width of the triangles; granular paste takes a third of the grains' mean radius if that is less."""

    @property
    def fine_step_mm(self) -> float:
        """Triangle width that shows the texture."""
        if self.texture == "smooth":
            return self.step_mm
        return min(self.step_mm, self.grain_mm / 2 / 3)

    @property
    def grain_mm(self) -> float:
        """Median diameter of the grains by number (Hatch and Choate 1929: smaller than that by mass)."""
        powder = Powder.of_type(self.powder)
        return float(powder.median_um * np.exp(-3.0 * powder.spread**2)) * 1e-3


@dataclass(frozen=True)
class Form:
    """The drawn shape parameters of one deposit; names and units as in `Paste`."""

    edge_mm: float
    wall: float
    scoop: float
    dog_ear: float
    roughness: float
    stroke: tuple[float, float] = (0.0, 1.0)
    """Unit vector along which the stencil was printed, in the aperture's own frame."""
    peak_mm: float = 0.0
    """Height of a peak above the surface around it."""
    peak_width_mm: float = 0.1
    """Its full width at half height."""
    peak_at: tuple[float, float] = (0.0, 0.0)
    """Its place relative to half the footprint's extent, -1 to 1 along x and y."""


def deposit(
    mesh: Tessellation,
    volume_mm3: float,
    stretch: tuple[float, float],
    form: Form,
    paste: Paste,
    rng: np.random.Generator,
) -> Heightfield:
    """One deposit of exactly a given volume above 0 on a tessellated aperture; `stretch` is its growth along x and y."""
    if not volume_mm3 > 0.0:
        raise MeshError(f"a deposit of {volume_mm3:.3g} mm3 has no shape: mark the pad as missing")
    centre, _ = _extent(mesh.xy_mm)
    xy = centre + (mesh.xy_mm - centre) * np.asarray(stretch)
    weights = mesh.weights_mm2 * (stretch[0] * stretch[1])
    shape = _shape(mesh, xy, form, paste, rng)
    peak = _peak(mesh, xy, form, paste)
    # Sums, not matrix products: BLAS's order of addition, and so the last bit, depends on its threads.
    taken = float((weights * peak).sum()) if form.peak_mm else 0.0
    if taken > PEAK_SHARE * volume_mm3:
        peak *= PEAK_SHARE * volume_mm3 / taken
        taken = PEAK_SHARE * volume_mm3
    scale = (volume_mm3 - taken) / float((weights * shape).sum())
    height = scale * shape + peak
    if paste.texture == "granular":
        height = _grains(xy, height, paste, rng)
        height *= volume_mm3 / float((weights * height).sum())
    return Heightfield(xy, mesh.faces, mesh.rims, height)


def shoulder(depth_mm: Floats, edge_mm: float, wall: float) -> Floats:
    """Profile of a deposit's edge: an upright wall up to `wall`, then a quarter ellipse up to 1 at the depth `edge_mm`."""
    q = np.minimum(depth_mm / edge_mm, 1.0)
    return np.asarray(wall + (1.0 - wall) * np.sqrt(q * (2.0 - q)))


def _shape(
    mesh: Tessellation, xy: Floats, form: Form, paste: Paste, rng: np.random.Generator
) -> Floats:
    """The deposit's height relative to the plateau, positive everywhere."""
    depth = mesh.depth_mm
    deepest = float(depth.max())
    # A narrow deposit's shoulders meet in its middle.
    edge = min(form.edge_mm, max(deepest, 1e-9))
    shape = shoulder(depth, edge, form.wall)
    relief = np.zeros(1)
    if form.scoop:
        relief = relief - form.scoop * (1.0 - (1.0 - depth / max(deepest, 1e-9)) ** 2)
    if form.dog_ear:
        # A ridge across each end along the stroke, its crest where the shoulder ends.
        along = mesh.xy_mm @ np.asarray(form.stroke)
        from_end = np.minimum(along.max() - along, along - along.min())
        beyond = np.maximum(from_end - edge, 0.0) / (1.5 * edge)
        relief = relief + form.dog_ear * np.exp(-(beyond**2))
    if form.roughness:
        relief = relief + form.roughness * _waves(xy, paste.lump_mm, rng)
    # Lumps of three sd and a deep scoop together may not cut through to the pad.
    return shape * np.maximum(1.0 + relief, 0.05)


def _peak(mesh: Tessellation, xy: Floats, form: Form, paste: Paste) -> Floats:
    """The peak in mm: a Gaussian, brought down to nothing at the rim."""
    if not form.peak_mm:
        return np.zeros(len(xy))
    centre, half = _extent(xy)
    sigma = form.peak_width_mm / 2.3548
    offset = xy - (centre + half * np.asarray(form.peak_at))
    bump = np.exp(-0.5 * (offset**2).sum(axis=1) / sigma**2)
    return np.asarray(form.peak_mm * bump * shoulder(mesh.depth_mm, paste.fine_step_mm, 0.0))


def _extent(xy: Floats) -> tuple[Floats, Floats]:
    """Centre and half extent of the bounds."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    return (low + high) / 2, (high - low) / 2


def _waves(xy: Floats, wavelength_mm: float, rng: np.random.Generator) -> Floats:
    """An isotropic random texture of unit variance: plane waves of random direction, of about one wavelength.

    Waves of one length alone look like a fingerprint.
    """
    angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, WAVES))
    number = 2.0 * np.pi / wavelength_mm * rng.uniform(0.4, 1.6, WAVES)
    k = number * np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(np.sqrt(2.0 / WAVES) * np.cos(xy @ k + phase).sum(axis=1))


def _grains(xy: Floats, height: Floats, paste: Paste, rng: np.random.Generator) -> Floats:
    """The surface as a layer of spheres whose tops touch the envelope: a jittered hexagonal packing seen from above.

    Seen from above only, so that the deposit stays a heightfield and its volume exact; `scenes.shapes.grains` packs whole
    spheres. Between the grains the surface falls to the flux that fills the gaps.
    """
    pitch = paste.grain_mm
    low, high = xy.min(axis=0) - pitch, xy.max(axis=0) + pitch
    rows = np.arange(low[1], high[1], pitch * np.sqrt(3.0) / 2.0)
    x, y = np.meshgrid(np.arange(low[0], high[0], pitch), rows)
    x[1::2] += pitch / 2
    centres = np.column_stack([x.ravel(), y.ravel()])
    centres += rng.normal(0.0, 0.08 * pitch, centres.shape)
    radius = Powder.of_type(paste.powder).diameters_um(len(centres), rng) * 0.5e-3
    distance, nearest = cKDTree(centres).query(xy, k=3)
    reach = radius[nearest]
    dome = np.sqrt(np.maximum(reach**2 - distance**2, 0.0)) - reach
    # The flux level is three quarters of a radius below the tops.
    relief = np.maximum(dome.max(axis=1), -0.375 * pitch)
    return np.asarray(np.maximum(height + relief, 0.2 * height))
