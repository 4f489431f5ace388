"""Solder paste as printed: transferred volume, and the shape of one deposit.

The shape is a heightfield over the aperture, ``h = s f + p``: f the shape without units (rounded shoulder, scoop,
dog ears, texture), p a peak in mm, and the scale s solved for so that the mesh holds exactly the deposit's volume.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat
from scipy.spatial import cKDTree

from scenes.board.transfer import PackageTransfer, Transfer
from scenes.shapes.grains import Powder
from scenes.shapes.heightfield import Heightfield
from scenes.shapes.tessellation import Tessellation
from scenes.support.distribution import NonNegative, Quantity, within
from scenes.support.errors import MeshError
from scenes.support.frozen import Frozen

Floats = NDArray[np.float64]

# Material of paste whose grains are not resolved.
UNRESOLVED = "solder-paste"
# Plane waves that texture a smooth deposit; more make no visible difference.
WAVES = 12
# A peak takes its paste from the deposit, and never more than this share of it.
PEAK_SHARE = 0.5
# Height of a leaning wall's foot, relative to the wall: solids need some.
FOOT = 0.1
# Distance of grains and level of the flux between them, in median diameters: their light is that of packed spheres.
GRAIN_PITCH, FLUX_DEPTH = 1.2, 0.375


class Paste(Frozen):
    """How paste is printed: numbers, or the distributions each deposit's own are drawn from."""

    material: str = UNRESOLVED
    """Of paste whose grains are not resolved."""
    grain_material: str = "solder"
    flux_material: str = "flux"
    """Between the grains of granular paste."""
    stencil_mm: Annotated[Quantity, within(0.02, 0.5)] = 0.12
    """Stencil thickness, drawn once a print; 0.08 to 0.15 is usual."""
    transfer: Transfer = Transfer()
    packages: dict[str, PackageTransfer] = {}
    """Name of a part, its letters (`R`), its size (`0402`) or its package (`bga`) -> what differs there; the first that is given
    counts. Boards from files name their pads only: `P12`, or `P` for all."""
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
    """Growth of the footprint on every side at unchanged volume. The walls' feet move out and their tops do not, so that they lean by
    as much."""
    corner_mm: Annotated[float, Field(ge=0.0, le=0.2)] = 0.05
    """Radius of the footprint's corners, a quarter of its shorter side at most: openings are cut with radii of 2 mil (T. Lentz, SMT007
    Magazine, July 2019, p. 37)."""
    edge_mm: Annotated[Quantity, within(0.001, 1.0)] = 0.04
    """Radius of the rounded shoulder: no edge is sharper than a grain, 40 um at most in type 4."""
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
    texture: Literal["auto", "smooth", "granular"] = "auto"
    """granular: the surface is a layer of alloy grains, one diameter deep at most. auto: granular where the camera's pixels on the
    board are smaller than half a grain's median diameter, else smooth, with a material that looks the same; smooth, too, where
    `material` is another."""
    powder: Literal[3, 4, 5, 6, 7] = 4
    """Powder type of J-STD-005, for the grains."""
    step_mm: Annotated[float, Field(ge=0.001, le=0.2)] = 0.01
    """Width of the triangles; granular paste takes a third of the grains' mean radius if that is less."""

    def seen_by(self, pixel_mm: float) -> "Paste":
        """The same with `auto` decided for pixels of this size on the board."""
        if self.texture != "auto":
            return self
        resolved = pixel_mm < self.grain_mm / 2 and self.material == UNRESOLVED
        return self.model_copy(update={"texture": "granular" if resolved else "smooth"})

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of the materials it may show."""
        grains = (self.grain_material, self.flux_material)
        return (self.material, *(grains if self.texture != "smooth" else ()))

    def transfer_to(self, names: Iterable[str]) -> Transfer:
        """What is transferred to a part of these names, most special first."""
        own = next((self.packages[name] for name in names if name in self.packages), None)
        return own.of(self.transfer) if own else self.transfer

    @property
    def fine_step_mm(self) -> float:
        """Triangle width that shows the texture."""
        if self.texture != "granular":
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
    lean_mm: float = 0.0
    """How far the walls lean in from their feet."""
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
    bed = None
    if paste.texture == "granular":
        height, bed = _grains(xy, height, paste, rng)
        height *= volume_mm3 / float((weights * height).sum())
    return Heightfield(xy, mesh.faces, mesh.rims, height, bed)


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
    lean = min(form.lean_mm, deepest / 2)
    edge = min(form.edge_mm, max(deepest - lean, 1e-9))
    shape = shoulder(np.maximum(depth - lean, 0.0), edge, form.wall)
    if lean > 0.0:
        # What is narrower than a triangle is seen as a lower rim.
        foot = max(1.0 - lean / paste.fine_step_mm, FOOT)
        shape = np.where(depth < lean, form.wall * np.maximum(depth / lean, foot), shape)
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


def _grains(
    xy: Floats, height: Floats, paste: Paste, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.bool_]]:
    """The surface as a layer of spheres whose tops touch the envelope: a jittered hexagonal packing seen from above; and where the
    flux between them is seen.

    Seen from above only, so that the deposit stays a heightfield and its volume exact; `scenes.shapes.grains` packs whole
    spheres. Between the grains the surface falls to the flux that fills the gaps.
    """
    pitch = GRAIN_PITCH * paste.grain_mm
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
    relief, bed = dome.max(axis=1), -FLUX_DEPTH * paste.grain_mm
    return np.maximum(height + np.maximum(relief, bed), 0.2 * height), relief <= bed
