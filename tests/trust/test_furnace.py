"""Scenes whose radiance is known in closed form. Tolerances are the standard error of independent repeats, and float32."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import stats

import render
from scenes import Scene
from scenes.rig.projectors import PinholeProjector, Screen
from scenes.shapes.materials import LIBRARY, Conductor
from tests.render import rigs
from tests.trust import chance

pytestmark = pytest.mark.trust

Floats = NDArray[np.float64]
Figure = Callable[[str, str], None]
SKY = 7.0
REPEATS = 12
# Facets of a sphere as wide as 2 pi / FACETS of its radius R are inside it by (width / R)^2 / 8 of R, which is
# the order of their effect on the light inside.
FACETS = 256
FACET_SLACK = (2.0 * np.pi / FACETS) ** 2 / 8.0


def repeats(scene: Scene, what: str, samples: int, *names: object) -> Floats:
    """Images (repeat, row, col) of a transport's `ambient`, or of a white pattern in `total` or `direct`."""
    images = []
    for seed in chance.seeds(REPEATS, "furnace", *names):
        found = getattr(render.trace(scene, seed=seed, samples=samples), what)
        images.append(found if what == "ambient" else found[0, 0])
    return np.asarray(images, np.float64)


def p_of_mean(images: Floats, expected: float | Floats, slack: float = 0.0) -> float:
    """P-value that the mean over the image is the expected one's, apart from float32 and a relative `slack`."""
    ratio = np.mean(images / expected, axis=(1, 2))
    error = np.hypot(stats.sem(ratio), chance.ROUNDING)
    off = max(0.0, abs(ratio.mean() - 1.0) - slack)
    return float(2.0 * stats.t.sf(off / error, REPEATS - 1))


def of_mesh(mesh: trimesh.Trimesh, path: Path, material: str, **more: Any) -> list[dict[str, Any]]:
    mesh.export(path)
    shape = {"kind": "file", "path": str(path)}
    return [{"label": "body", "material": material, "shape": shape, **more}]


def in_furnace(
    objects: list[dict[str, Any]], materials: dict[str, Any], depth: int, field_mm: float = 14.0
) -> Scene:
    """Objects under uniform light, seen close enough to fill the image; the projector is far to the side."""
    return Scene.model_validate(
        {
            "camera": rigs.pinhole((16, 12), field_mm=field_mm),
            "projectors": [rigs.pinhole_projector()],
            "objects": objects,
            "materials": materials,
            "ambient": {"radiance_w_m2_sr": SKY},
            "patterns": {"kind": "phase-shift", "periods_px": (16.0,), "steps": 3},
            "exposures": {"times_ms": (1.0,)},
            "sampling": {"depth": depth},
            "height_range_mm": (-1.0, 60.0),
        }
    )


def test_convex_body_in_a_furnace_shows_its_reflectance(tmp_path: Path) -> None:
    """A failure points to the weight of a bounce or of sky light. The body sees only sky: L = rho L_sky."""
    rng = chance.generator("hull")
    p = []
    for i in range(6):
        rho = float(rng.uniform(0.02, 1.0))
        hull = trimesh.convex.convex_hull(rng.normal(size=(40, 3)) * 20.0)
        paint = {"own": {"kind": "diffuse", "reflectance": rho}}
        scene = in_furnace(of_mesh(hull, tmp_path / f"{i}.ply", "own"), paint, 4)
        images = repeats(scene, "ambient", 16, "hull", i)
        p.append(p_of_mean(images, rho * SKY))
    assert chance.family(p) > chance.ALPHA


def bowl(radius_mm: float, half_angle_deg: float, rows: int, columns: int) -> trimesh.Trimesh:
    """The part of a sphere about (0, 0, radius) within an angle of its lowest point, which is the origin."""
    polar = np.linspace(0.0, np.deg2rad(half_angle_deg), rows + 1)[1:]
    around = np.arange(columns) * (2.0 * np.pi / columns)
    ring = np.stack([np.cos(around), np.sin(around)], axis=-1)
    points = np.concatenate(
        [
            np.sin(polar)[:, None, None] * ring,
            np.broadcast_to(1.0 - np.cos(polar)[:, None, None], (rows, columns, 1)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    r, c = (x.ravel() for x in np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij"))
    a, b = r * columns + c, r * columns + (c + 1) % columns
    quads = np.concatenate(
        [np.stack([a, b, b + columns], axis=-1), np.stack([a, b + columns, a + columns], axis=-1)]
    )
    tip = len(points)
    first = np.arange(columns)
    fan = np.stack([np.full(columns, tip), (first + 1) % columns, first], axis=-1)
    return trimesh.Trimesh(
        radius_mm * np.vstack([points, np.zeros(3)]), np.vstack([fan, quads]), process=False
    )


@pytest.mark.parametrize(
    ("half_angle_deg", "depth"), [(60.0, 3), (120.0, 1), (120.0, 2), (120.0, 4), (120.0, 8)]
)
def test_bowl_under_the_sky_has_the_series_of_its_bounces(
    half_angle_deg: float, depth: int, tmp_path: Path, record_property: Figure
) -> None:
    """A failure points to a bounce lost or counted twice, or its weight.

    In a sphere every point sees every other alike: a bowl that is a share f of its sphere sees itself with f and the sky
    with 1 - f, from everywhere. So ``L = rho (1 - f) L_sky (1 + rho f + ... + (rho f)^(d-1))``.
    """
    rho, f = 0.9, (1.0 - np.cos(np.deg2rad(half_angle_deg))) / 2.0
    mesh = bowl(30.0, half_angle_deg, 128, FACETS)
    objects = of_mesh(mesh, tmp_path / "bowl.ply", "own")
    scene = in_furnace(objects, {"own": {"kind": "diffuse", "reflectance": rho}}, depth)
    images = repeats(scene, "ambient", 512, "bowl", half_angle_deg, depth)
    expected = rho * (1.0 - f) * SKY * sum((rho * f) ** k for k in range(depth))
    ratio = images.mean(axis=(1, 2)) / expected
    record_property("figure", f"{ratio.mean() - 1.0:+.1e}, standard error {stats.sem(ratio):.1e}")
    assert p_of_mean(images, expected, FACET_SLACK) > chance.ALPHA / 5


@pytest.mark.parametrize("depth", [2, 3, 6])
def test_closed_sphere_has_the_series_of_its_bounces(
    depth: int, tmp_path: Path, record_property: Figure
) -> None:
    """A failure points to a bounce of the projector's light lost or counted twice, its weight, or the projector's power.

    Bounce k adds ``rho^k E / pi`` evenly, E the projector's power over the sphere's area.
    """
    radius, rho = 100.0, 0.5
    ball = bowl(radius, 180.0 - 1e-3, 128, FACETS)
    ball.apply_translation([0.0, 0.0, -radius])
    light = rigs.pinhole((64, 48), field_mm=160.0, x_mm=-30.0, height_mm=50.0, reference_mm=60.0)
    scene = rigs.scene(
        rigs.pinhole((16, 12), field_mm=90.0, x_mm=30.0, height_mm=60.0),
        light,
        objects=of_mesh(ball, tmp_path / "ball.ply", "grey-paint"),
        depth=depth,
    )
    images = repeats(scene, "total", 1024, "sphere", depth)
    images -= repeats(scene, "direct", 1024, "sphere", depth)
    focal = light["fx_px"]
    power = 100.0 * (60.0 * 64 / focal) * (60.0 * 48 / focal)
    expected = sum(rho**k for k in range(2, depth + 1)) / np.pi * power / (4 * np.pi * radius**2)
    ratio = images.mean(axis=(1, 2)) / expected
    record_property("figure", f"{ratio.mean() - 1.0:+.1e}, standard error {stats.sem(ratio):.1e}")
    assert p_of_mean(images, expected, FACET_SLACK) > chance.ALPHA / 3


def fresnel(cosine: Floats, eta: float, k: float) -> Floats:
    """Unpolarised reflectance of a metal at an angle of incidence (Born & Wolf, complex Snell)."""
    n = eta - 1j * k
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / n**2)
    s = (cosine - n * inside) / (cosine + n * inside)
    p = (n * cosine - inside) / (n * cosine + inside)
    return np.asarray((np.abs(s) ** 2 + np.abs(p) ** 2) / 2.0)


def ggx_albedo(cosine: float, alpha: float, eta: float, k: float) -> float:
    """Share of uniform light that a rough metal returns towards an angle: ``int D F G / (4 cos_o) dw_i`` over normals.

    Walter et al. 2007, eqs. 20 (through its Jacobian 1 / (4 w_o.m)), 33 and 34, with separable shadowing. By quadrature
    over the slope's radius and azimuth.
    """
    node, weight = np.polynomial.legendre.leggauss(600)
    u, du = (node + 1.0) / 2.0, weight / 2.0
    # D cos dm is a density over u with tan^2 = alpha^2 u / (1 - u).
    tangent = alpha * np.sqrt(u / (1.0 - u))
    azimuth = np.arange(400) * (2.0 * np.pi / 400)
    m_z = 1.0 / np.sqrt(1.0 + tangent**2)
    m = np.stack(
        [
            (tangent * m_z)[:, None] * np.cos(azimuth),
            (tangent * m_z)[:, None] * np.sin(azimuth),
            np.broadcast_to(m_z[:, None], (600, 400)),
        ]
    )
    out = np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
    along = np.tensordot(out, m, axes=1)
    back = 2.0 * along * m - out[:, None, None]

    def shadow(w: Floats, dot: Floats) -> Floats:
        tan2 = (w[0] ** 2 + w[1] ** 2) / np.maximum(w[2] ** 2, 1e-12)
        seen = 2.0 / (1.0 + np.sqrt(1.0 + alpha**2 * tan2))
        return np.where((dot > 0) & (w[2] > 0), seen, 0.0)

    mask = shadow(np.broadcast_to(out[:, None, None], m.shape), along) * shadow(back, along)
    value = fresnel(np.clip(along, 0.0, 1.0), eta, k) * mask * along / (cosine * m[2])
    return float((value.mean(axis=1) * du).sum())


@pytest.mark.parametrize("tilt_deg", [0.0, 40.0, 70.0])
@pytest.mark.parametrize("name", ["mirror", "solder", "gold", "solder-paste"])
def test_metal_in_a_furnace_shows_its_directional_reflectance(
    name: str, tilt_deg: float, record_property: Figure
) -> None:
    """A failure points to Fresnel's equations, the microfacets or their sampling."""
    metal = LIBRARY[name]
    assert isinstance(metal, Conductor)
    plate = {"kind": "plate", "size_mm": (200.0, 200.0)}
    tilted = {"rotation_deg": (0.0, tilt_deg, 0.0), "shape": plate, "material": name}
    # A telecentric camera sees every point of the plate at one angle.
    scene = in_furnace([{"label": "plate", **tilted}], {}, 2)
    camera = rigs.telecentric((16, 12), field_mm=14.0)
    scene = Scene.model_validate(scene.model_dump(mode="json") | {"camera": camera})
    cosine = float(np.cos(np.deg2rad(tilt_deg)))
    if metal.roughness:
        expected = ggx_albedo(cosine, metal.roughness, metal.eta, metal.k)
    else:
        expected = float(fresnel(np.array(cosine), metal.eta, metal.k))
    images = repeats(scene, "ambient", 256, "metal", name, tilt_deg)
    ratio = images.mean(axis=(1, 2)) / (expected * SKY)
    record_property(
        "figure", f"{expected:.4f}, {ratio.mean() - 1:+.1e}, s.e. {stats.sem(ratio):.1e}"
    )
    # 600 x 400 nodes leave 1e-5 where half of the facets at grazing angles are cut off; angles are float32.
    assert p_of_mean(images, expected * SKY, 1e-4) > chance.ALPHA / 12


@pytest.mark.parametrize("name", sorted(LIBRARY))
def test_materials_return_no_more_light_than_they_receive(name: str, tmp_path: Path) -> None:
    """A failure points to a BSDF that makes energy. A closed convex body under a uniform sky is nowhere brighter than the sky."""
    body = trimesh.creation.icosphere(subdivisions=3, radius=15.0)
    objects = of_mesh(body, tmp_path / "body.ply", name, position_mm=(0.0, 0.0, 15.0))
    images = repeats(in_furnace(objects, {}, 16), "ambient", 64, "energy", name)
    mean, error = images.mean(axis=0), stats.sem(images, axis=0)
    over = (mean - SKY) / np.hypot(error, chance.ROUNDING * SKY)
    p = stats.t.sf(over, REPEATS - 1)
    assert chance.family(p) > chance.ALPHA / len(LIBRARY)
    assert 0.0 < images.mean() < SKY


def test_clear_resin_loses_only_what_single_scattering_loses(
    tmp_path: Path, record_property: Figure
) -> None:
    """A failure points to the change of radiance by the index squared, or its inverse on the way out. Lossless but for what single
    scattering by microfacets loses, which falls with roughness: 3 % a crossing at 0.1, and a few crossings.
    """
    body = trimesh.creation.icosphere(subdivisions=3, radius=15.0)
    objects = of_mesh(body, tmp_path / "body.ply", "own", position_mm=(0.0, 0.0, 15.0))
    shares = {}
    for roughness in (0.1, 0.3):
        resin = {"own": {"kind": "dielectric", "ior": 1.5, "roughness": roughness}}
        images = repeats(in_furnace(objects, resin, 32), "ambient", 256, "resin", roughness)
        shares[roughness] = float(images.mean() / SKY)
    record_property(
        "figure", f"share returned at roughness 0.1: {shares[0.1]:.4f}, 0.3: {shares[0.3]:.4f}"
    )
    assert shares[0.3] < shares[0.1] <= 1.0
    # Index squared, were it forgotten on one of the two ways, is 2.25.
    assert shares[0.1] > 0.97


@pytest.mark.parametrize("case", range(8))
def test_tilted_plate_is_lit_by_cosine_and_distance(case: int, record_property: Figure) -> None:
    """A failure points to the projector's cosine, or its inverse square. Paint under white light alone, random pose.

    ``E = E0 cos a`` (telecentric), ``E0 (z_ref / z)^2 cos a / cos b`` (pinhole; a from the surface's normal, b from the
    projector's axis), averaged over each pixel by quadrature.
    """
    rng = chance.generator("plate", case)
    parallel = bool(case % 2)
    angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(20.0, 120.0)
    pose = {
        "origin_mm": (far * np.cos(angle), far * np.sin(angle), float(rng.uniform(120.0, 250.0))),
        "target_mm": (*rng.uniform(-3.0, 3.0, 2), 0.0),
    }
    light = (
        rigs.telecentric((64, 48), field_mm=300.0)
        if parallel
        else rigs.pinhole((64, 48), field_mm=300.0, reference_mm=float(rng.uniform(100.0, 300.0)))
    )
    light |= {"pose": pose, "irradiance_w_m2": float(rng.uniform(10.0, 300.0))}
    scene = rigs.scene(
        rigs.pinhole((16, 12), x_mm=20.0), light, objects=rigs.plane("grey-paint"), depth=1
    )
    expected = 0.5 / np.pi * _irradiance(scene)
    images = repeats(scene, "direct", 16, "plate", case)
    error = np.hypot(stats.sem(images, axis=0), chance.ROUNDING * expected)
    z = (images.mean(axis=0) - expected) / error
    record_property("figure", f"largest of {z.size} pixels {np.abs(z).max():.2f} standard errors")
    p = 2.0 * stats.t.sf(np.abs(z), REPEATS - 1)
    assert chance.family(p) > chance.ALPHA / 8


def _irradiance(scene: Scene, nodes: int = 8) -> Floats:
    """Of the plane z = 0, averaged over each pixel's square, (row, col), W/m^2."""
    camera, light = scene.camera.projection(), scene.projectors[0]
    assert not isinstance(light, Screen)
    projector = light.projection()
    node, weight = np.polynomial.legendre.leggauss(nodes)
    total = np.zeros((camera.height, camera.width))
    for x, wx in zip(node / 2, weight / 2, strict=True):
        for y, wy in zip(node / 2, weight / 2, strict=True):
            origin, way = camera.rays(camera.pixel_centres() + np.array([x, y]))
            points = origin - way * (origin[..., 2:] / way[..., 2:])
            if projector.telecentric:
                here = np.full(total.shape, light.irradiance_w_m2 * abs(projector.axis[2]))
            else:
                ray = points - projector.origin_mm
                depth = ray @ projector.axis
                # cos a / cos b: both over the ray's length, which cancels
                assert isinstance(light, PinholeProjector)
                here = light.irradiance_w_m2 * (light.reference_mm / depth) ** 2
                here = here * np.abs(ray[..., 2]) / depth
            total += wx * wy * here
    return total
