"""Light of a projector at a point: irradiance of white, and the values of the pattern's basis channels."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from render.plugins.lens import Optics
from render.plugins.variant import dr, mi
from scenes.acquisition.pattern_basis import Channel
from scenes.acquisition.projector_pixels import across
from scenes.acquisition.stereo_light import dot_table
from scenes.rig.projectors import PinholeProjector, Projector, TelecentricProjector

Draw = Callable[[int], Any]
"""Independent pairs of random numbers, Point2f, by number."""


class Patterned:
    """What a projector or a screen shows: the values of its basis channels at its pixels."""

    def __init__(self, device: Projector, channels: Sequence[Channel]) -> None:
        polynomials = not device.polynomials_even
        self.vignetting = device.smooth_illumination if polynomials else None
        self.map = None
        if device.illumination_map is not None:
            values = device.illumination_map.values().astype(np.float32)[..., None]
            # Texture units of a GPU would interpolate in 256 steps.
            self.map = mi.Texture2f(mi.TensorXf(values), use_accel=False)
        self.resolution = device.resolution
        self.channels = tuple(channels)
        self.periods = {
            (c.axis, c.period_px): dr.opaque(mi.Float, c.period_px)
            for c in channels
            if c.kind in ("cos", "sin")
        }
        self.tables = [_table(channel) for channel in channels]
        comb = across(device)
        self.comb = None if comb is None else mi.Float(comb.astype(np.float32))
        dr.eval(self.tables, self.comb)

    def uneven(self, light: Any, pixel: Any) -> Any:
        """Light of a pixel, dimmed by its place in the image."""
        if self.vignetting is not None:
            light = light * self.vignetting(pixel.x, pixel.y)
        if self.map is not None:
            columns, rows = self.resolution
            light = light * self.map.eval(mi.Point2f(pixel.x / columns, pixel.y / rows))[0]
        return light

    def channel_values(self, pixel: Any, active: Any) -> list[Any]:
        """Each basis channel's value at a continuous projector pixel."""
        along = {"column": pixel.x, "row": pixel.y}
        waves = {}
        for key, period in self.periods.items():
            u = along[key[0]]
            # Whole fringes are subtracted first, with one rounding, so that the phase keeps float32's digits.
            rest = dr.fma(-period, dr.round(u / period), u)
            waves[key] = dr.sincos(2 * dr.pi * rest / period)
        values = []
        for channel, table in zip(self.channels, self.tables, strict=True):
            if channel.kind == "one":
                values.append(mi.Float(1))
            elif channel.kind == "dots":
                values.append(_dots(table, channel, pixel, active))
            elif channel.kind == "table":
                value = _read(table, along[channel.axis], channel.cells, active)
                if self.comb is not None:
                    u = along["row" if channel.axis == "column" else "column"]
                    value *= _read(self.comb, u - dr.floor(u), channel.cells, active, wrap=True)
                values.append(value)
            else:
                values.append(waves[channel.axis, channel.period_px][channel.kind == "cos"])
        return values


class Light(Patterned):
    """A projector's light for the variant in use.

    On a plane perpendicular to the axis the irradiance of white is ``E0 (reference / z)^2`` (pinhole) or ``E0``
    (telecentric), uniform across the plane. Cosine and sine of one fringe come from one `sincos`.
    """

    def __init__(
        self,
        projector: TelecentricProjector | PinholeProjector,
        optics: Optics,
        channels: Sequence[Channel],
    ) -> None:
        self.optics = optics
        strength = projector.irradiance_w_m2
        if isinstance(projector, PinholeProjector):
            strength *= projector.reference_mm**2
        self.strength = dr.opaque(mi.Float, strength)
        super().__init__(projector, channels)
        self.halves = self._halves()

    def connect(self, point: Any, lens_sample: Any) -> tuple[Any, Any, Any, Any]:
        """Light that reaches a world point, without regard to shadows.

        Returns the world point it comes from, the irradiance of white in W/m^2 on a surface facing that point, the
        continuous projector pixel, and whether that pixel exists.
        """
        local = self.optics.to_local(point)
        source = self.optics.light_source(local, lens_sample)
        irradiance, pixel, lit = self.response(local, source)
        return self.optics.to_world(source), irradiance, pixel, lit

    def arrive(
        self, scene: Any, si: Any, draw: Draw, active: Any, weight: Any = 1
    ) -> list[tuple[Any, Any, Any]]:
        """Light that a surface sends back to where the ray came from, per ray that was tried: radiance of white times
        `weight`, 0 in shadow, the pixel that it comes from, and whether there is any.
        """
        pupil = None if self.optics.lens is None else draw(0)
        source, irradiance, pixel, lit = self.connect(si.p, pupil)
        lit &= active
        wo = si.to_local(dr.normalize(source - si.p))
        value = si.bsdf().eval(mi.BSDFContext(), si, wo, lit).x
        lit &= value > 0
        lit &= ~scene.ray_test(si.spawn_ray_to(source), lit)
        return [(dr.select(lit, weight * value * irradiance, 0), pixel, lit)]

    def fellow(self, point: Any) -> Any:
        """Ray of the light half a fringe from that of a world point, in the world; twice is back again."""
        assert self.halves is not None
        at = self.optics.to_local(point)
        if not self.optics.telecentric:
            at /= at.z
        moved = []
        for u, half in zip((at.x, at.y), self.halves, strict=True):
            odd = (mi.Int32(dr.floor(u / half)) & 1) == 1 if half is not None else False
            moved.append(u if half is None else u + dr.select(odd, -half, half))
        start, way = mi.Point3f(0), dr.normalize(mi.Vector3f(*moved, 1))
        if self.optics.telecentric:
            start, way = mi.Point3f(*moved, 0), mi.Vector3f(0, 0, 1)
        return mi.Ray3f(self.optics.to_world(start), self.optics.turn_back(way))

    def half_fringe(self, point: Any) -> Any:
        """Half a fringe's width across the light at a world point, mm."""
        assert self.halves is not None
        width = dr.sqrt(sum(half * half for half in self.halves if half is not None))
        return width if self.optics.telecentric else width * self.optics.to_local(point).z

    def per_lens_area(self, si: Any, way: Any) -> Any:
        """Area across `way` for one of lens coordinates that light a surface point, times a constant."""
        local = self.optics.to_local(si.p)
        to_source = self.optics.to_world(self.optics.light_source(local, None)) - si.p
        area = dr.abs(dr.dot(si.n, way) / dr.dot(si.n, dr.normalize(to_source)))
        return area if self.optics.telecentric else area * local.z**3 / dr.norm(local)

    def _halves(self) -> tuple[Any, Any] | None:
        """Half a finest fringe along both axes, in lens coordinates, None along one without; none of both: no pairs.

        Nor behind a thin lens, through which a pixel lights many points.
        """
        finest: dict[str, float] = {}
        for channel in self.channels:
            if channel.kind in ("cos", "sin"):
                known = finest.get(channel.axis, channel.period_px)
                finest[channel.axis] = min(known, channel.period_px)
        if not finest or self.optics.lens is not None:
            return None
        x, y = (dr.opaque(mi.Float, finest.get(axis, 0.0) / 2) for axis in ("column", "row"))
        focal = self.optics.focal
        return x / focal.x if "column" in finest else None, y / focal.y if "row" in finest else None

    def response(self, local: Any, source: Any) -> tuple[Any, Any, Any]:
        """Irradiance of white, pixel, and whether it exists, for a point and a source in the projector's frame."""
        pixel, lit = self.optics.pixel(local, source)
        cosine = local.z / dr.norm(local - source)
        irradiance = self.strength / cosine
        if not self.optics.telecentric:
            irradiance /= dr.square(local.z)
        return self.uneven(irradiance, pixel), pixel, lit


def _table(channel: Channel) -> Any:
    """The numbers that a channel is read from; None where it is a formula."""
    if channel.kind == "dots":
        seed, share, columns, rows = channel.values
        return mi.Float(dot_table(int(seed), share, int(columns), int(rows)).ravel())
    is_table = channel.kind == "table"
    return mi.Float(np.asarray(channel.values, dtype=np.float32)) if is_table else None


def _dots(table: Any, channel: Channel, pixel: Any, active: Any) -> Any:
    """Value of the dot that a continuous pixel is in."""
    columns, rows = (int(n) for n in channel.values[2:])
    at = [
        dr.clip(mi.Int32(dr.floor(u / channel.period_px)), 0, count - 1)
        for u, count in ((pixel.x, columns), (pixel.y, rows))
    ]
    return dr.gather(mi.Float, table, mi.UInt32(at[1] * columns + at[0]), active)


def _read(table: Any, pixel: Any, cells: int, active: Any, wrap: bool = False) -> Any:
    """A table's value at a continuous pixel: that of its cell, or linear between the centres of several per pixel."""
    last = len(table) - 1

    def at(index: Any) -> Any:
        inside = dr.select(index < 0, last, dr.select(index > last, 0, index)) if wrap else index
        return dr.gather(mi.Float, table, mi.UInt32(dr.clip(inside, 0, last)), active)

    if cells == 1:
        return at(mi.Int32(dr.floor(pixel)))
    place = pixel * cells - 0.5
    left = dr.floor(place)
    return dr.lerp(at(mi.Int32(left)), at(mi.Int32(left) + 1), place - left)
