"""Truth: what every camera pixel should have measured, from rays through pixel centres against the meshes.

Mitsuba finds which triangle a ray meets, in float32; the point, its normal and its projector pixel are then computed
from that triangle in float64.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from render.mitsuba_scene import geometry
from render.surfaces import Surfaces, shared
from render.tracer import trace
from render.transport import Transport
from render.variant import mi, use
from scenes.errors import RenderError
from scenes.load import dumps
from scenes.materials import Diffuse
from scenes.memory import room_for
from scenes.meshes import Part
from scenes.patterns import PhaseShift
from scenes.rig import Projection
from scenes.scene import Scene
from scenes.truth import Truth

Points = NDArray[np.float64]

# Pixels worked on at once: their float64 numbers stay in the cache, twice as fast as a megapixel at once.
BLOCK = 1 << 15
# Light paths per pixel where the share of direct light has to be traced first.
SAMPLES = 16
# How far from its surface a shadow ray starts, in scene radii: 50 times float32's rounding of a coordinate.
LIFT = 50 * 2.0**-24


def truth(
    scene: Scene, transport: Transport | None = None, surfaces: Surfaces | None = None
) -> Truth:
    """Ground truth of every pixel's centre: point, normal, label, and for each projector what it lights and where.

    A camera or projector with a lens is taken at the centre of its pupil. `lit` says that a point lies in the
    projector's image, turns the side that the camera sees to the projector, and that no triangle lies between. Normals
    are the triangles' own, also where shading is smooth.

    `direct_fraction` is the mean over the pixel's area, not its centre's, and is as noisy as its light: that of
    `transport`, or of a small one (16 paths per pixel, white only) traced here. For a projector with gamma or
    quantised values a transport holds no white; the nearest combination of its patterns stands for it. `surfaces` are
    those of `render.surfaces`, where they were needed before.

    Raises `RenderError` for a transport of another camera or other projectors, `TooLargeError` for more pixels than
    memory holds.
    """
    use()
    surfaces = shared(scene, surfaces)
    if transport is None:
        transport = trace(_white(scene), samples=SAMPLES, surfaces=surfaces)
    elif not _same_light(scene, transport.scene):
        raise RenderError(
            "the transport was traced from another scene (its camera, projectors or objects differ): "
            "trace this scene, or give no transport"
        )
    surface = _Surface.of(scene, surfaces.parts)
    camera = scene.camera.projection()
    projectors = [projector.projection() for projector in scene.projectors]
    with room_for(
        (60 + 21 * len(projectors)) * camera.width * camera.height,
        f"the truth of {camera.width} x {camera.height} pixels",
        "lower camera.resolution",
    ):
        return _truth(scene, surface, camera, projectors, transport)


def _truth(
    scene: Scene,
    surface: "_Surface",
    camera: Projection,
    projectors: Sequence[Projection],
    transport: Transport,
) -> Truth:
    pixels = camera.pixel_centres().reshape(-1, 2)
    count, shape = len(pixels), (camera.height, camera.width)

    xyz = np.full((count, 3), np.nan, np.float32)
    normal = np.full((count, 3), np.nan, np.float32)
    label = np.zeros(count, np.uint16)
    pad, material = np.zeros(count, np.uint32), np.zeros(count, np.uint16)
    lit = np.zeros((len(projectors), count), np.bool_)
    image = np.full((2, len(projectors), count), np.nan, np.float32)
    for start in range(0, count, BLOCK):
        origin, direction = camera.rays(pixels[start : start + BLOCK])
        triangle = surface.first_hit(origin, direction)
        hit = np.flatnonzero(triangle >= 0)
        triangle, at = triangle[hit], start + hit
        point, facing = surface.meet(triangle, origin[hit], direction[hit])
        xyz[at], normal[at], label[at] = point, facing, surface.label[triangle]
        pad[at], material[at] = surface.pad[triangle], surface.material[triangle]
        for p, projection in enumerate(projectors):
            where, _ = projection.project(point)
            image[:, p, at] = where.T
            lit[p, at] = surface.lit(point, facing, where, projection)
    label = label.reshape(shape)
    return Truth(
        xyz.reshape(*shape, 3),
        normal.reshape(*shape, 3),
        label,
        scene.labels,
        lit.reshape(-1, *shape),
        image[0].reshape(-1, *shape),
        image[1].reshape(-1, *shape),
        _direct_fraction(transport, label > 0),
        dumps(scene),
        pad.reshape(shape) if scene.board else None,
        material.reshape(shape),
        surface.materials,
    )


@dataclass(frozen=True)
class _Surface:
    """All objects as one mesh."""

    corners: Points
    """(triangle, 3, 3) world mm."""
    label: NDArray[np.uint16]
    """Of each triangle, as are `pad` and `material`."""
    pad: NDArray[np.uint32]
    material: NDArray[np.uint16]
    materials: tuple[str, ...]
    centre: Points
    radius: float
    """Of a sphere around everything."""
    scene: Any
    """The same about the origin, for Mitsuba."""

    @classmethod
    def of(cls, scene: Scene, surfaces: Sequence[Part]) -> "_Surface":
        ids = [scene.labels.index(part.label) + 1 for part in surfaces]
        counts = [len(part.mesh.faces) for part in surfaces]
        pads = [
            np.zeros(n, np.uint32) if part.face_pad is None else part.face_pad.astype(np.uint32)
            for part, n in zip(surfaces, counts, strict=True)
        ]
        materials = tuple(dict.fromkeys(part.material_name for part in surfaces))
        made_of = [materials.index(part.material_name) + 1 for part in surfaces]
        # One shape, so that Mitsuba's triangle numbers are the mesh's, about the origin, where float32 is finest.
        vertices = np.concatenate([np.asarray(part.mesh.vertices) for part in surfaces])
        first = np.cumsum([0, *(len(part.mesh.vertices) for part in surfaces)])
        faces = np.concatenate(
            [part.mesh.faces + n for part, n in zip(surfaces, first, strict=False)]
        )
        corners = vertices[faces]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        centre = (low + high) / 2
        mesh = trimesh.Trimesh(vertices - centre, faces, process=False)
        whole = Part("", mesh, Diffuse(reflectance=0.5), smooth=False)
        return cls(
            corners,
            np.repeat(ids, counts).astype(np.uint16),
            np.concatenate(pads),
            np.repeat(made_of, counts).astype(np.uint16),
            materials,
            centre,
            float(np.linalg.norm(high - low)) / 2,
            mi.load_dict(geometry([whole])),
        )

    def first_hit(self, origin: Points, direction: Points) -> NDArray[np.int64]:
        """The triangle each ray meets first, -1 for none."""
        # Rays start beside the scene, not at a camera far away, where float32 is coarse.
        ahead = ((self.centre - origin) * direction).sum(axis=-1, keepdims=True)
        skip = np.maximum(ahead - 1.01 * self.radius, 0.0)
        ray = mi.Ray3f(self._local(origin + skip * direction), _vector(direction))
        hit = self.scene.ray_intersect_preliminary(ray, coherent=True)
        index: NDArray[np.int64] = np.where(
            hit.is_valid().numpy(), hit.prim_index.numpy().astype(np.int64), -1
        )
        return index

    def meet(
        self, triangle: NDArray[np.int64], origin: Points, direction: Points
    ) -> tuple[Points, Points]:
        """Where rays meet their triangles' planes, and the unit normals that face the rays' origins."""
        a, b, c = np.moveaxis(self.corners[triangle], 1, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        slope = (normal * direction).sum(axis=-1, keepdims=True)
        distance = (normal * (a - origin)).sum(axis=-1, keepdims=True) / slope
        return origin + distance * direction, np.where(slope > 0, -normal, normal)

    def lit(
        self, point: Points, normal: Points, pixel: Points, projector: Projection
    ) -> NDArray[np.bool_]:
        """Whether a projector's light reaches points from the side of their normals."""
        if projector.telecentric:
            depth = point @ projector.axis + projector.t[2]
            towards = -depth[:, None] * projector.axis
        else:
            depth = np.ones(len(point))
            towards = projector.origin_mm - point
        with np.errstate(invalid="ignore"):
            inside = ((pixel >= 0) & (pixel < (projector.width, projector.height))).all(axis=-1)
        reached: NDArray[np.bool_] = inside & (depth > 0) & ((normal * towards).sum(axis=-1) > 0)
        if not reached.any():
            # Mitsuba aborts the process when asked for no rays at all.
            return reached
        distance = np.linalg.norm(towards[reached], axis=-1)
        # What stands beyond the projector casts no shadow, and neither does what is out of the scene's sphere.
        ray = mi.Ray3f(
            self._local(point[reached] + LIFT * self.radius * normal[reached]),
            _vector(towards[reached] / distance[:, None]),
            mi.Float(np.minimum(distance, 2.1 * self.radius).astype(np.float32)),
            0,
            [],
        )
        reached[reached] = ~self.scene.ray_test(ray).numpy()
        return reached

    def _local(self, point: Points) -> Any:
        return _vector(point - self.centre)


def _vector(array: Points) -> Any:
    return mi.Vector3f(np.ascontiguousarray(array.T, dtype=np.float32))


def _direct_fraction(transport: Transport, hit: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(projector, row, col) share of direct light under white."""
    shares = []
    for p, basis in enumerate(transport.bases):
        # White is the constant channel; without one, of tables (orthogonal, mean square 1) each by its mean.
        weights = [float(channel.kind == "one") for channel in basis.channels]
        if not any(weights):
            weights = [float(np.mean(channel.values)) for channel in basis.channels]
        white, count = np.array(weights, np.float32), len(weights)
        total = np.tensordot(white, transport.total[p, :count], axes=1)
        direct = np.tensordot(white, transport.direct[p, :count], axes=1)
        bright = hit & (total > 0)
        share = np.full(hit.shape, np.nan, np.float32)
        share[bright] = np.clip(direct[bright] / total[bright], 0.0, 1.0)
        shares.append(share)
    return np.stack(shares)


def _white(scene: Scene) -> Scene:
    """The scene with the fewest channels that include white."""
    linear = [p.model_copy(update={"gamma": 1.0, "bits": 0}) for p in scene.projectors]
    wide = PhaseShift(steps=3, periods_px=(1e6,))
    return scene.model_copy(update={"projectors": tuple(linear), "patterns": wide})


def _same_light(scene: Scene, other: Scene) -> bool:
    keys = ("camera", "projectors", "objects", "board", "materials")
    return all(getattr(scene, key) == getattr(other, key) for key in keys)
