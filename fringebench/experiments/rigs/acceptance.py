"""Virtual acceptance test of a rig: a ball bar and a plane in several positions of the working volume (VDI/VDE 2634-2)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import decode
import render
from evaluation.scoring.reference_bodies import (
    FittedPlane,
    FittedSphere,
    expected_range,
    fit_plane,
    fit_sphere,
)
from fringebench.experiments.rigs.shared_field import CommonField, common_field
from fringebench.progress import Steps
from scenes import Scene
from scenes.support.errors import SceneError

# Of the working volume's diagonal (VDI/VDE 2634-2: sphere 0.02 to 0.2, bar at least 0.3, plane at least 0.5).
SPHERE, BAR, PLANE = 0.08, 0.35, 0.5
# Direction of the bar in the plane of the field in degrees, shift of its middle as a share of the field, and the height
# of its two ends as a share of the volume.
BARS: tuple[tuple[float, tuple[float, float], tuple[float, float]], ...] = (
    (0.0, (0.0, 0.0), (0.5, 0.5)),
    (90.0, (0.0, 0.0), (0.5, 0.5)),
    (35.0, (0.0, 0.0), (0.0, 1.0)),
    (-35.0, (0.0, 0.0), (1.0, 0.0)),
    (0.0, (0.0, 0.25), (0.0, 0.0)),
    (0.0, (0.0, -0.25), (1.0, 1.0)),
    (90.0, (0.2, 0.0), (0.2, 0.8)),
)
# Heights and slopes of the plane: its middle in the volume's height, and its tilt about x and y as far as that allows.
PLANES: tuple[tuple[float, float, float], ...] = (
    (0.0, 0.0, 0.0),
    (1.0, 0.0, 0.0),
    (0.5, 1.0, 0.0),
    (0.5, -1.0, 0.0),
    (0.5, 0.0, 1.0),
    (0.5, 0.0, -1.0),
)
# Pixels along an outline see object and background at once, and belong to neither.
OUTLINE_PX = 2


@dataclass(frozen=True)
class Position:
    """Errors measured in one position, mm."""

    artefact: str
    error_mm: dict[str, float]
    """Error of each measure, by name."""
    noise_mm: dict[str, float]
    """Form and flatness error that the predicted noise alone would cause."""
    points: int


@dataclass(frozen=True)
class Acceptance:
    """Result of an acceptance test: the largest error of each measure over all positions, as the guideline reports it."""

    scene: str
    diagonal_mm: float
    """Diagonal of the working volume: common field times height range."""
    sphere_mm: float
    """Diameter of the spheres."""
    bar_mm: float
    """Distance of their centres."""
    plane_mm: tuple[float, float]
    positions: tuple[Position, ...]

    def worst(self) -> dict[str, float]:
        """Largest absolute error of each measure, mm."""
        return _largest(position.error_mm for position in self.positions)

    def noise(self) -> dict[str, float]:
        """Largest error of each measure that noise alone would cause, mm."""
        return _largest(position.noise_mm for position in self.positions)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {**asdict(self), "worst_mm": self.worst(), "noise_mm": self.noise()}


def accept(scene: Scene, seed: int = 0, steps: Steps | None = None) -> Acceptance:
    """Run a virtual acceptance test: seven positions of a ball bar and six of a plane in the working volume.

    Rig, sensor and patterns are those of `scene`; its objects are replaced by matt white artefacts. The working volume is
    the common field of camera and projector at z = 0, times `height_range_mm`. Points within two pixels of an outline are
    not used.

    Parameters
    ----------
    scene
        A scene with the rig to test.
    seed
        Seed of light paths and sensor noise of the first position, 0 or more; the others count up from it.
    steps
        Shows progress; none by default.

    Returns
    -------
    Acceptance
        Largest probing error (form and size), sphere distance error and flatness error in mm, each position, and the
        part of form and flatness that noise alone explains.

    Raises
    ------
    SceneError
        If the volume is too flat for the spheres.

    Notes
    -----
    Quality parameters after VDI/VDE 2634-2 and ISO 10360-13.

    Examples
    --------
    >>> import fringebench as fb
    >>> scene = fb.load("step", {"camera.resolution": [160, 120], "sampling.samples": 4})
    >>> result = fb.accept(scene)
    >>> len(result.positions), result.worst()["flatness"] < 0.1
    (13, True)
    """
    scene.calibration().require_projectors("an acceptance test")
    steps = steps or Steps()
    field = common_field(scene.calibration())
    low, high = scene.height_range_mm
    diagonal = float(np.linalg.norm([*field.size_mm, high - low]))
    radius = min(0.5 * SPHERE * diagonal, 0.4 * (high - low))
    if radius < 0.01 * diagonal:
        raise SceneError(
            f"height_range_mm {[low, high]} leaves spheres of {2 * radius:.3g} mm in a volume of {diagonal:.3g} mm, and the "
            f"guideline requires at least {0.02 * diagonal:.3g} mm: widen height_range_mm"
        )
    bar = BAR * diagonal
    positions: list[Position] = []
    for i, (direction, shift, heights) in enumerate(BARS):
        with steps.step(f"ball bar {i + 1} of {len(BARS)}"):
            ends = _ends(field, (low, high), radius, bar, direction, shift, heights)
            positions.append(_bar(scene, ends, radius, seed + i))
    width, height = field.size_mm
    size = min(0.9 * width, max(PLANE * diagonal, 0.6 * width)), 0.7 * height
    for i, (level, about_x, about_y) in enumerate(PLANES):
        with steps.step(f"plane {i + 1} of {len(PLANES)}"):
            tilt = _tilt_deg(size, (low, high), (about_x, about_y))
            middle = [*field.middle_mm, _between((low, high), level, 0.1)]
            positions.append(_plane(scene, middle, tilt, size, seed + 100 + i))
    return Acceptance(scene.name, diagonal, 2.0 * radius, bar, size, tuple(positions))


def _largest(found: Iterable[Mapping[str, float]]) -> dict[str, float]:
    largest: dict[str, float] = {}
    for name, value in chain.from_iterable(one.items() for one in found):
        largest[name] = max(largest.get(name, 0.0), abs(value))
    return largest


def _between(span: tuple[float, float], share: float, margin: float) -> float:
    """A height at a share of the span, keeping a margin from both ends."""
    low, high = span
    return low + (high - low) * (margin + (1.0 - 2.0 * margin) * share)


def _ends(
    field: CommonField,
    span: tuple[float, float],
    radius: float,
    bar: float,
    direction_deg: float,
    shift: tuple[float, float],
    heights: tuple[float, float],
) -> NDArray[np.float64]:
    """Sphere centres (2, 3) in mm of a bar of exactly that length, with the tops below the upper end of the volume."""
    room = (span[0], span[1] - radius)
    z = np.array([_between(room, share, 0.1) for share in heights])
    flat = np.sqrt(bar**2 - (z[1] - z[0]) ** 2)
    angle = np.deg2rad(direction_deg)
    half = 0.5 * flat * np.array([np.cos(angle), np.sin(angle)])
    middle = field.middle_mm + np.multiply(shift, field.size_mm)
    ends = np.stack([middle - half, middle + half])
    inside = np.abs(ends - field.middle_mm) + radius <= np.array(field.size_mm) / 2.0
    # A bar that does not fit is moved to the middle of the field, then turned along its longer side.
    if not inside.all():
        along = np.eye(2)[int(field.size_mm[0] < field.size_mm[1])]
        room_across = (np.array(field.size_mm) / 2.0 - radius) * (1.0 - along)
        offset = np.clip(np.multiply(shift, field.size_mm), -room_across, room_across)
        middle = field.middle_mm + offset * (1.0 - along)
        ends = np.stack([middle - 0.5 * flat * along, middle + 0.5 * flat * along])
    return np.column_stack([ends, z])


def _bar(scene: Scene, ends: NDArray[np.float64], radius: float, seed: int) -> Position:
    shape = {"kind": "cap", "profile": "spherical", "radius_mm": radius, "height_mm": radius}
    shape |= {"rings": 512, "segments": 512}
    objects = [
        {"label": label, "material": "artefact", "shape": shape, "position_mm": list(end)}
        for label, end in zip(("one", "two"), ends.tolist(), strict=True)
    ]
    rec, regions = _measure(scene, objects, seed)
    spheres = [fit_sphere(rec.xyz_mm[region]) for region in regions]
    noise = [_noise(rec, region, sphere) for region, sphere in zip(regions, spheres, strict=True)]
    apart = float(np.linalg.norm(spheres[1].centre_mm - spheres[0].centre_mm))
    worst = max(spheres, key=lambda sphere: abs(sphere.radius_mm - radius))
    return Position(
        "ball bar",
        {
            "probing form": max(sphere.form_mm for sphere in spheres),
            "probing form D95": max(sphere.form95_mm for sphere in spheres),
            "probing size": 2.0 * (worst.radius_mm - radius),
            "sphere distance": apart - float(np.linalg.norm(ends[1] - ends[0])),
        },
        {"probing form": max(noise)},
        min(sphere.points for sphere in spheres),
    )


def _plane(
    scene: Scene,
    middle: Sequence[float],
    tilt_deg: tuple[float, float],
    size: tuple[float, float],
    seed: int,
) -> Position:
    objects = [
        {
            "label": "one",
            "material": "artefact",
            "shape": {"kind": "plate", "size_mm": size},
            "position_mm": [float(value) for value in middle],
            "rotation_deg": [*tilt_deg, 0.0],
        }
    ]
    rec, regions = _measure(scene, objects, seed)
    plane = fit_plane(rec.xyz_mm[regions[0]])
    return Position(
        "plane",
        {"flatness": plane.flatness_mm, "flatness D95": plane.flatness95_mm},
        {"flatness": _noise(rec, regions[0], plane)},
        plane.points,
    )


def _measure(
    scene: Scene, objects: list[dict[str, Any]], seed: int
) -> tuple[decode.Reconstruction, list[NDArray[np.bool_]]]:
    """Render, expose and decode artefacts; the measured pixels of each, without its outline."""
    posed = Scene.model_validate(
        {
            **scene.model_dump(exclude={"objects", "exposures"}),
            "objects": objects,
            "materials": {"artefact": {"kind": "diffuse", "reflectance": 0.8}},
            "exposures": {
                "auto": {
                    "label": "one",
                    "level_dn": 0.7 * min(scene.sensor.saturation_dn, 65535.0),
                    "statistic": "peak",
                },
                "relative": [0.6],
            },
        }
    )
    surfaces = render.surfaces(posed)
    transport = render.trace(posed, seed=seed, surfaces=surfaces)
    truth = render.truth(posed, transport, surfaces)
    rec = decode.reconstruct(render.expose(transport, seed=seed))
    regions = []
    for label in posed.labels:
        seen = truth.region(label) & truth.lit
        inner = ndimage.binary_erosion(seen, np.ones((3, 3), np.bool_), iterations=OUTLINE_PX)
        regions.append(inner & rec.valid)
    return rec, regions


def _noise(
    rec: decode.Reconstruction, region: NDArray[np.bool_], fitted: FittedSphere | FittedPlane
) -> float:
    """Range in mm that the predicted height noise alone would cause over so many points, at the median slope."""
    sigma = np.sqrt(np.mean(rec.sigma_mm[region].astype(np.float64) ** 2))
    return float(sigma * expected_range(fitted.points))


def _tilt_deg(
    size: tuple[float, float], span: tuple[float, float], about: tuple[float, float]
) -> tuple[float, float]:
    """Tilts about x and y that keep the plane in the volume."""
    room = 0.8 * (span[1] - span[0])
    limits = [np.rad2deg(np.arcsin(min(1.0, room / side))) for side in (size[1], size[0])]
    # Beyond some 30 degrees a matt plane loses light, not accuracy.
    return tuple(
        float(np.clip(share * limit, -30.0, 30.0))
        for share, limit in zip(about, limits, strict=True)
    )  # type: ignore[return-value]
