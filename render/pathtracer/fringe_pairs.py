"""Every lit vertex of indirect light brings the one that its projector lights half a fringe further.

Light that a surface gets from others covers many fringes, whose phases all but cancel. Single paths have one phase each, and
that was nearly all of the noise. Let T move a projector's pixel by half a fringe: from even halves on, from odd ones back, so
that ``T(T(u)) = u``. A pixel lights one point, so T pairs lit points, and it keeps the measure of pixels. A path that met one
point of a pair has thereby found the pair, with the sum of both densities q per pixel, and

    (f(u) + f(T u)) / (q(u) + q(T u))

may take the place of ``f(u) / q(u)``: the mean over both ways to find it, as unbiased as each (antithetic variates:
Hammersley and Morton 1956). A density per solid angle becomes one per pixel by cos / r^2 at the vertex and the pixel's area
there. A point whose fellow is dark or out of sight stays alone. How much cancels depends on how alike both are: light from
nearby changes within half a fringe.
"""

from collections.abc import Callable
from typing import Any

from render.plugins.projector_light import Light
from render.plugins.variant import dr, mi

Leave = Callable[[Any, Any], tuple[Any, Any]]
"""From a direction and a mask: the part of light that a path carries from there, and the direction's density."""
Lit = tuple[Any, Any, Any]
"""Radiance, projector pixel, and whether there is any."""


def paired(
    scene: Any, light: Light, leave: Leave, ray: Any, density: Any, si: Any, found: Lit
) -> list[Lit]:
    """Light of the vertex `si` that `ray` met, lit as `found` says, and of its fellow, both as parts of the pair.

    `density` is what `leave` has for the ray; 0 for a mirror's one direction, in which no fellow can be.
    """
    radiance, pixel, lit = found
    both = lit & (density > 0)
    beam = light.fellow(si.p)
    other = scene.ray_intersect(beam, mi.RayFlags.All, False, both)
    way = other.p - ray.o
    distance = dr.norm(way)
    both &= other.is_valid() & (distance > 0)
    way = dr.select(both, way / distance, ray.d)
    carried, likely = leave(way, both)
    other.wi = other.to_local(-way)
    back = other.bsdf().eval(mi.BSDFContext(), other, other.to_local(-beam.d), both).x
    _, irradiance, further, exists = light.connect(other.p, None)
    both &= exists & (carried > 0) & (likely > 0) & (back > 0)
    # From the fellow to where the path's ray began, just off both surfaces: neither shades itself.
    both &= ~scene.ray_test(other.spawn_ray_to(ray.o), both)
    own = density * light.per_lens_area(si, ray.d) / dr.square(si.t)
    area = light.per_lens_area(other, way) / dr.square(distance)
    whole = dr.fma(likely, area, own)
    both &= dr.isfinite(whole) & (whole > 0)
    share = dr.select(both, own / whole, 1)
    # Never divided by the fellow's own density, which may be too small for that.
    more = dr.select(both, carried * back * irradiance * area / whole, 0)
    return [(radiance * share, pixel, lit), (more, further, both)]
