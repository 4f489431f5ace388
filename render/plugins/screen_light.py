"""Light of a screen that surfaces mirror to the camera, and the same screen as Mitsuba's area light.

Paths find a screen in two ways: in a direction drawn by the surface's BSDF, the only one for a mirror, and at a point drawn
on the screen, the quiet one for a matt surface. Both are weighed by the balance heuristic (Veach and Guibas 1995, eq. 14).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.plugins.lens import Optics, optics
from render.plugins.projector_light import Draw, Light, Patterned
from render.plugins.variant import dr, mi
from scenes.acquisition.pattern_basis import Basis, Channel
from scenes.rig.projectors import Projector, Screen
from scenes.support.errors import RenderError

Floats = NDArray[np.float64]

# Texels of a pixel where fringes are smooth: between their centres Mitsuba interpolates.
TEXELS = 16


class ScreenLight(Patterned):
    """A screen's light for the variant in use."""

    def __init__(self, screen: Screen, geometry: Optics, channels: Sequence[Channel]) -> None:
        super().__init__(screen, channels)
        self.optics = geometry
        self.radiance = dr.opaque(mi.Float, screen.radiance_w_m2_sr)
        self.falloff = dr.opaque(mi.Float, screen.falloff) if screen.falloff else None
        self.size = dr.opaque(mi.Point2f, list(screen.size_mm))
        self.area = dr.opaque(mi.Float, screen.size_mm[0] * screen.size_mm[1])

    def arrive(
        self, scene: Any, si: Any, draw: Draw, active: Any, weight: Any = 1
    ) -> list[tuple[Any, Any, Any]]:
        """As `Light.arrive`: by the BSDF's direction, and by a point of the screen."""
        bsdf, context, pair = si.bsdf(), mi.BSDFContext(), draw(0)
        sample, onward = bsdf.sample(context, si, draw(1).x, pair, active)
        pixel, radiance, density, lit = self._meet(scene, si, si.to_world(sample.wo))
        lit &= active & (onward.x > 0)
        delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        share = dr.select(delta, 1, sample.pdf / (sample.pdf + density))
        found = [(dr.select(lit, weight * onward.x * share * radiance, 0), pixel, lit)]

        place = (draw(2) - 0.5) * self.size
        target = self.optics.to_world(mi.Point3f(place.x, place.y, 0))
        way = dr.normalize(target - si.p)
        value, likely = bsdf.eval_pdf(context, si, si.to_local(way), active)
        pixel, radiance, density, lit = self._meet(scene, si, way, active & (value.x > 0))
        gain = weight * value.x * radiance / (density + likely)
        return [*found, (dr.select(lit, gain, 0), pixel, lit)]

    def _meet(self, scene: Any, si: Any, way: Any, active: Any = True) -> tuple[Any, Any, Any, Any]:
        """Where a direction meets the screen: pixel, radiance of white, density of a point drawn on the screen per solid
        angle, and whether it does, and nothing is between.
        """
        start = self.optics.to_local(si.p)
        along = self.optics.to_local(si.p + way) - start
        distance = -start.z / along.z
        # From the front, where z of the screen's frame is positive.
        ahead = (start.z > 0) & (along.z < 0)
        pixel, lit = self.optics.pixel(start + distance * along + mi.Vector3f(0, 0, 1), None)
        lit &= active & ahead
        ray = si.spawn_ray_to(si.p + dr.select(lit, distance, 1) * way)
        lit &= ~scene.ray_test(ray, lit)
        cosine = dr.select(lit, -along.z, 1)
        radiance = self.radiance
        if self.falloff is not None:
            radiance = radiance * dr.power(cosine, self.falloff)
        radiance = self.uneven(radiance, pixel)
        density = dr.select(lit, dr.square(distance), 1) / (cosine * self.area)
        return pixel, radiance, density, lit


Lights = Sequence[Light | ScreenLight]


def light_of(projector: Projector, channels: Sequence[Channel]) -> Light | ScreenLight:
    """A projector's or a screen's light for the variant in use."""
    if isinstance(projector, Screen):
        return ScreenLight(projector, optics(projector), channels)
    return Light(projector, optics(projector), channels)


def screen_shape(screen: Screen, basis: Basis, frame: int) -> dict[str, Any]:
    """Mitsuba's dictionary of a screen that shows a frame: a rectangle with a bitmap, which shares no code with the pass.

    Raises `RenderError` for what Mitsuba's area light does not have.
    """
    if screen.falloff or not screen.even or (screen.fill_factor or 1.0) < 1.0:
        raise RenderError(
            "a screen's falloff, vignetting, evenness and fill_factor have no counterpart in Mitsuba's area light: leave them out"
        )
    axes = {
        c.axis
        for c, w in zip(basis.channels, basis.weights[frame], strict=True)
        if c.kind != "one" and w
    }
    axis = axes.pop() if axes else "column"
    pixels = screen.resolution[0 if axis == "column" else 1]
    cells = max(c.cells for c in basis.channels if c.kind == "one" or c.axis == axis)
    smooth = any(c.kind in ("cos", "sin") for c in basis.channels)
    texels = TEXELS if smooth else cells
    at = (np.arange(pixels * texels) + 0.5) / texels
    values: Floats = np.zeros(at.size)
    for channel, weight in zip(basis.channels, basis.weights[frame], strict=True):
        match channel.kind:
            case "one":
                values += weight
            case "table":
                if channel.axis == axis:
                    values += weight * np.repeat(channel.values, texels // channel.cells)
            case kind:
                wave = np.cos if kind == "cos" else np.sin
                values += weight * wave(2 * np.pi * at / channel.period_px)
    values *= screen.radiance_w_m2_sr
    # Texture coordinates grow to the right and up; the frame's x points to a viewer's left.
    image = values[None, ::-1] if axis == "column" else values[:, None]
    rotation, translation = screen.pose.matrix()
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = rotation.T, -rotation.T @ translation
    half = np.diag([screen.size_mm[0] / 2, screen.size_mm[1] / 2, 1.0, 1.0])
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f((to_world @ half).tolist()),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
        "emitter": {
            "type": "area",
            "radiance": {
                "type": "bitmap",
                "data": mi.TensorXf(np.ascontiguousarray(image[..., None], np.float32)),
                "raw": True,
                "filter_type": "nearest" if texels == 1 else "bilinear",
                "wrap_mode": "clamp",
            },
        },
    }
