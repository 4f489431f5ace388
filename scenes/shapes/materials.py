"""Surfaces: how much light they return, and how. Optical constants carry their source.

Complex indices are at 589 nm, the wavelength of an amber LED and the one line at which tin, copper and gold are all
tabulated. SAC305 solder is 96.5 % tin; its index is taken as tin's.
"""

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat

from scenes.support.errors import SceneError, nearest
from scenes.support.frozen import Frozen

Reflectance = Annotated[float, Field(ge=0.0, le=1.0)]
Roughness = Annotated[float, Field(gt=0.0, le=1.0)]
# Typical peaks of red, green and blue LEDs, to which a material's `rgb` belongs.
RGB_NM = (630.0, 525.0, 465.0)
Rgb = tuple[Reflectance, Reflectance, Reflectance]
Index = tuple[PositiveFloat, NonNegativeFloat]


class Diffuse(Frozen):
    """A Lambertian surface."""

    kind: Literal["diffuse"] = "diffuse"
    reflectance: Reflectance
    rgb: Rgb | None = None
    """Reflectance at 630, 525 and 465 nm, for colour pictures; absent: the same at each."""


class Printed(Frozen):
    """A Lambertian surface printed with a random pattern of square grains: a texture that stereo can match.

    Grains are squares of the world's x, y plane, printed along z: vertical walls get stripes.
    """

    kind: Literal["printed"] = "printed"
    dark: Reflectance = 0.2
    """Albedo of half of the grains."""
    bright: Reflectance = 0.8
    """Albedo of the others."""
    grain_mm: Annotated[float, Field(ge=1e-4, le=1e4)] = 0.2
    """Side of a grain; 2 to 3 camera pixels match best."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Other seeds give other grains."""


class Glossy(Frozen):
    """A diffuse body under a dielectric skin: ink, solder mask, paint."""

    kind: Literal["glossy"] = "glossy"
    reflectance: Reflectance
    """Diffuse albedo of the body."""
    rgb: Rgb | None = None
    """Albedo at 630, 525 and 465 nm, for colour pictures; absent: the same at each."""
    ior: Annotated[float, Field(gt=1.0, le=3.0)] = 1.5
    """Refractive index of the skin."""
    roughness: Roughness = 0.1
    """GGX roughness of the skin."""


class Conductor(Frozen):
    """A metal: rough GGX microfacets, or a perfect mirror with roughness 0."""

    kind: Literal["conductor"] = "conductor"
    eta: PositiveFloat
    """Real part of the complex refractive index."""
    k: NonNegativeFloat
    """Imaginary part (extinction)."""
    rgb: tuple[Index, Index, Index] | None = None
    """eta and k at 630, 525 and 465 nm, for colour pictures; absent: the same at each."""
    roughness: Annotated[float, Field(ge=0.0, le=1.0)] = 0.2
    """GGX roughness; 0 is a mirror."""


class Dielectric(Frozen):
    """A clear body with a rough skin, such as resin, wax or flux: light enters, scatters inside and leaves
    elsewhere. Fringes bleed, and no height is measured at the skin.

    The object must be closed, or rest on something, and its triangles wound to face outwards. Light that entered has met
    at least three surfaces when it comes back: give `sampling.depth` 6 or more. Absorption is not modelled, and scattering
    happens at surfaces only: a milky body is a clear one around or over a white one.
    """

    kind: Literal["dielectric"] = "dielectric"
    ior: Annotated[float, Field(gt=1.0, le=3.0)] = 1.5
    """Refractive index."""
    roughness: Annotated[float, Field(ge=0.1, le=1.0)] = 0.4
    """GGX roughness of the skin. Through a smoother one no path finds a projector, which is a point."""


Material = Annotated[
    Diffuse | Printed | Glossy | Conductor | Dielectric, Field(discriminator="kind")
]

# Tin: n = 1.48, k = 5.25 at 589.3 nm (Drude; CRC Handbook of Chemistry and Physics, optical constants of metals:
# reflectance 0.82). Refractiveindex.info has no visible data for tin (Golovashkin and Motulevich 1964 starts at 730 nm).
# Copper, gold: P. B. Johnson and R. W. Christy, Phys. Rev. B 6, 4370 (1972), interpolated between 2.01 and 2.14 eV.
# Roughness: reflowed solder is smooth, finely ground metal and plated finishes scatter more; assumed, not measured. Paste whose
# grains are not resolved returns as much light upwards as traced packings of grains of types 3 to 5 in flux do, for light at 27 and 45
# degrees, within 10 % (`tests/render/plugins/test_paste_look.py`).
# Inks and masks: epoxy skin, n = 1.55; body albedos, and those of laminate, are typical of their colour, assumed, not measured.
# Colours: copper's and gold's indices are Johnson and Christy's table again, linear in photon energy between its rows. Tin and
# solder are taken as neutral: their reflectance hardly changes over the visible.
# Flux: rosin (abietic acid), n = 1.545; wet, so nearly smooth. It is clear and brown; here it is an opaque body under a
# skin, because below the grains are more grains, which return little.
LIBRARY: dict[str, Material] = {
    "white-paint": Diffuse(reflectance=0.8),
    "grey-paint": Diffuse(reflectance=0.5),
    "black-ink": Glossy(reflectance=0.04, ior=1.55, roughness=0.25),
    "solder-mask-green": Glossy(reflectance=0.12, rgb=(0.04, 0.16, 0.05), ior=1.55, roughness=0.15),
    "solder-mask-blue": Glossy(reflectance=0.05, rgb=(0.03, 0.08, 0.25), ior=1.55, roughness=0.15),
    "solder-mask-black": Glossy(reflectance=0.04, ior=1.55, roughness=0.15),
    "solder-mask-white": Glossy(reflectance=0.75, ior=1.55, roughness=0.15),
    "laminate": Diffuse(reflectance=0.35, rgb=(0.38, 0.33, 0.2)),
    "flux": Glossy(reflectance=0.15, ior=1.545, roughness=0.1),
    "resin": Dielectric(ior=1.5, roughness=0.4),
    "mirror": Conductor(eta=1.48, k=5.25, roughness=0.0),
    "solder-paste": Conductor(eta=1.48, k=5.25, roughness=0.75),
    "solder": Conductor(eta=1.48, k=5.25, roughness=0.25),
    "tin": Conductor(eta=1.48, k=5.25, roughness=0.15),
    "copper": Conductor(
        eta=0.59, k=2.84, rgb=((0.27, 3.38), (1.15, 2.60), (1.25, 2.46)), roughness=0.3
    ),
    "gold": Conductor(
        eta=0.27, k=2.95, rgb=((0.19, 3.41), (0.59, 2.14), (1.33, 1.87)), roughness=0.25
    ),
}


def in_colour(of: Material, number: int) -> Material:
    """A material as red (0), green (1) or blue (2) light sees it.

    >>> in_colour(LIBRARY["copper"], 2).eta
    1.25
    """
    match of:
        case Diffuse() | Glossy() if of.rgb is not None:
            return of.model_copy(update={"reflectance": of.rgb[number]})
        case Conductor() if of.rgb is not None:
            eta, k = of.rgb[number]
            return of.model_copy(update={"eta": eta, "k": k})
    return of


def material(name: str, own: dict[str, Material]) -> Material:
    """The material of that name: the scene's own first, then the library's; `SceneError` if neither has it."""
    known = LIBRARY | own
    if name not in known:
        raise SceneError(f"unknown material '{name}': {nearest(name, known)}")
    return known[name]
