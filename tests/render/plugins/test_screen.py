"""A screen's light against Mitsuba's area light with a bitmap, and against closed forms where Mitsuba has none."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import render
import scenes
from render.plugins.screen_light import screen_shape
from render.plugins.variant import use
from scenes import Pinhole, Screen
from scenes.acquisition.pattern_basis import basis
from scenes.support.errors import RenderError
from tests.render import rigs
from tests.render.oracle import compare

Entries = dict[str, Any]
Floats = NDArray[np.float64]

BOTH = {"axes": ("column", "row"), "periods_px": (24.0,)}


def screen(**more: Any) -> Entries:
    """A screen to the left that a mirror at z = 0 shows to a camera at (80, 0, 200)."""
    return {
        "model": "screen",
        "resolution": (96, 80),
        "size_mm": (192.0, 160.0),
        "pose": {"origin_mm": (-60.0, 0.0, 150.0)},
        **more,
    }


def scene(screen: Entries, objects: list[Entries], depth: int = 3, **patterns: Any) -> scenes.Scene:
    camera = rigs.pinhole(x_mm=80.0)
    return rigs.scene(camera, screen, objects=objects, depth=depth, patterns=BOTH | patterns)


def curved(material: str) -> list[Entries]:
    """A cap on white paint, whose rim it also lights."""
    cap = {"kind": "cap", "radius_mm": 20.0, "height_mm": 2.0, "rings": 24, "segments": 48}
    return [*rigs.plane(), {"label": "cap", "material": material, "smooth": True, "shape": cap}]


def reflectance(cosine: Floats) -> Floats:
    """Fresnel's of the mirror's metal for unpolarised light, by the angle of incidence."""
    index = 1.48 - 5.25j
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    s = np.abs((cosine - index * inside) / (cosine + index * inside)) ** 2
    p = np.abs((index * cosine - inside) / (index * cosine + inside)) ** 2
    return np.asarray((s + p) / 2)


@pytest.mark.slow
@pytest.mark.parametrize("frame", [1, 4])
@pytest.mark.parametrize(
    ("material", "emission"),
    [
        ("mirror", {}),
        ("tin", {"gamma": 2.2, "contrast": 0.9}),
        ("black-ink", {}),
        ("white-paint", {"radiance_w_m2_sr": 30.0}),
    ],
)
def test_light_of_a_screen_equals_path(
    material: str, emission: Entries, frame: int, tmp_path: Path
) -> None:
    compare(scene(screen(**emission), curved(material)), frame, samples=144).require_equal(tmp_path)


@pytest.mark.parametrize("falloff", [0.0, 3.0])
def test_mirrored_radiance_falls_with_the_angle_and_the_place_on_the_screen(falloff: float) -> None:
    """Of a flat mirror: Fresnel's reflectance times the emitted radiance of the pixel that it shows."""
    vignetting = (-0.4,)
    found = scene(screen(falloff=falloff, vignetting=vignetting), rigs.plane("mirror"), depth=1)
    light = render.trace(found, samples=64)
    white = light.total[0, 0]
    truth = render.truth(found, light)
    camera = found.camera.projection()
    _, way = camera.rays(camera.pixel_centres())
    towards = way * [1.0, 1.0, -1.0]
    normal = np.array([60.0, 0.0, -150.0]) / np.hypot(60.0, 150.0)
    u, v = truth.columns_px[0] - 48.0, truth.rows_px[0] - 40.0
    share = 1 + vignetting[0] * (u**2 + v**2) / (48.0**2 + 40.0**2)
    expected = 100.0 * reflectance(-way[..., 2]) * (-towards @ normal) ** falloff * share
    whole = truth.lit_by[0] & ((np.abs(u) < 44) & (np.abs(v) < 36))
    assert whole.mean() > 0.3
    # A pixel averages over 2.5 mm, in which the light's curvature changes the mean by a thousandth.
    np.testing.assert_allclose(white[whole], expected[whole], rtol=2e-3)


def test_mirror_shows_a_screen_up_to_its_foot() -> None:
    """The screen stands on the mirror, where the camera's view ends: rays reach it after less than a millimetre."""
    camera = Pinhole.model_validate(rigs.pinhole(x_mm=80.0)).projection()
    left_mm = camera.points_at(-1.0, np.array([[0.0, 0.0], [0.0, camera.height]]))[:, 0].min()
    pose = {"origin_mm": (left_mm, 0.0, 80.0), "target_mm": (100.0, 0.0, 80.0)}
    found = scene(screen(pose=pose), rigs.plane("mirror"), depth=1)
    white = render.trace(found, samples=16).total[0, 0]
    pixel = camera.pixel_centres()
    assert camera.points_at(0.0, pixel - [0.5, 0.0])[..., 0].min() < left_mm + 1.0 - 0.1
    _, way = camera.rays(pixel)
    # Further right, the screen's top is seen.
    half = np.s_[:, : camera.width // 2]
    np.testing.assert_allclose(white[half], 100.0 * reflectance(-way[..., 2])[half], rtol=2e-3)


@pytest.mark.parametrize(
    ("height_mm", "share"), [(100.0, 0.5), (4.0, 0.255), (-30.0, 0.0), (300.0, 0.0)]
)
def test_screen_in_the_cameras_view_is_refused(height_mm: float, share: float) -> None:
    """Halfway to the plane, where the field is 30 mm wide; among the heights measured, where it is 58.8 mm wide; below the plane, and
    above the camera. It faces the ground far away."""
    pose = {"origin_mm": (0.0, 0.0, height_mm), "target_mm": (0.0, 0.0, -1e3)}
    narrow = screen(size_mm=(15.0, 160.0), pose=pose)
    camera = rigs.pinhole(pose={"origin_mm": (0.0, 0.0, 200.0), "target_mm": (0.0, 0.0, 0.0)})
    found = Screen.model_validate(narrow)
    seen = Pinhole.model_validate(camera).projection()
    # A grid of 33 columns.
    assert found.hidden_share(seen, floor_mm=-1.0) == pytest.approx(share, abs=2 / 33)
    if share:
        with pytest.raises(ValueError, match=r"hides .* of the camera's view"):
            rigs.scene(camera, narrow, objects=rigs.plane("mirror"), patterns=BOTH)


@pytest.mark.parametrize(
    ("height_mm", "target_mm"), [(-100.0, 0.0), (200.0, 400.0), (-100.0, -400.0)]
)
def test_no_mirror_shows_a_screen_behind_it_or_from_the_back(
    height_mm: float, target_mm: float
) -> None:
    pose = {"origin_mm": (-60.0, 0.0, height_mm), "target_mm": (-60.0, 0.0, target_mm)}
    light = render.trace(scene(screen(pose=pose), rigs.plane("mirror"), depth=1), samples=4)
    assert light.total.max() == 0.0


def test_mixed_rigs_and_impossible_screens_are_refused() -> None:
    one, projector = screen(), rigs.pinhole_projector()
    camera, mirror = rigs.pinhole(x_mm=80.0), rigs.plane("mirror")
    far = screen(pose={"origin_mm": (-80.0, 0.0, 200.0)})
    for devices, said in (
        ((one, projector), "are mixed"),
        ((one, far, one), "one or two"),
        ((one, one), "0 mm apart"),
    ):
        with pytest.raises(ValueError, match=said):
            rigs.scene(camera, *devices, objects=mirror, patterns=BOTH)
    with pytest.raises(ValueError, match="no row fringes"):
        rigs.scene(camera, one, objects=mirror)
    with pytest.raises(RenderError, match="no counterpart"):
        render.mitsuba_scene(scene(screen(falloff=1.0), mirror))


@pytest.mark.parametrize("frame", [0, 4])
def test_mitsubas_screen_shows_the_frame(frame: int) -> None:
    """A viewer sees column 0 at the left, where the bitmap ends."""
    use()
    shown = Screen.model_validate(screen())
    patterns = scene(screen(), rigs.plane("mirror")).patterns
    of = patterns.frames()[frame]
    entry = screen_shape(shown, basis(patterns, shown, shown.resolution), frame)
    bitmap = np.array(entry["emitter"]["radiance"]["data"])[..., 0]
    light = bitmap[0, ::-1] if of.axis == "column" else bitmap[:, 0]
    pixels = shown.resolution[0 if of.axis == "column" else 1]
    at = (np.arange(light.size) + 0.5) / light.size * pixels
    # float32 of 100 W/(m2 sr).
    np.testing.assert_allclose(light, 100.0 * shown.emit(patterns.commanded(of, at)), atol=1e-5)
