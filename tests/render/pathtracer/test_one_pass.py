"""The tracer's promises apart from physics: phase, repeatability, tiles, labels, errors, files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import render
import scenes
from render.fringe_phasor import finest_fringes
from render.pathtracer import one_pass
from scenes import Scene
from scenes.support.errors import FileError, RenderError
from tests.render import rigs


def flat(**camera: Any) -> Scene:
    """A plane, with camera pixels as large as the projector's: 16 px a fringe in both."""
    return rigs.scene(
        rigs.pinhole((320, 240), **camera),
        rigs.pinhole_projector(resolution=(384, 288)),
        objects=rigs.plane(),
    )


def phase_error_rad(scene: Scene, samples: int) -> NDArray[np.float64]:
    """Phase of direct light less the phase at the pixels' centres, where the projector shines."""
    _, cosine, sine = render.trace(scene, samples=samples, depth=1).direct[0]
    origin, direction = scene.camera.projection().rays(scene.camera.projection().pixel_centres())
    points = origin - direction * (origin[..., 2:] / direction[..., 2:])
    projector = scene.projectors[0].projection()
    pixels, _ = projector.project(points)
    inside = ((pixels > 1) & (pixels < (projector.width - 1, projector.height - 1))).all(axis=-1)
    assert inside.mean() > 0.9
    expected = 2 * np.pi * pixels[..., 0] / 16.0
    error: NDArray[np.float64] = np.angle(np.exp(1j * (np.arctan2(sine, cosine) - expected)))
    return error[inside]


@pytest.mark.parametrize("samples", [4, 16])
def test_direct_light_has_the_phase_of_the_pixel_centre(samples: int) -> None:
    error = np.abs(phase_error_rad(flat(), samples))
    print(f"{samples} samples: median {np.median(error):.1e}, 95 % {np.quantile(error, 0.95):.1e}")
    assert np.median(error) <= 1e-4
    assert np.quantile(error, 0.95) <= 2e-4


def test_same_seed_gives_the_same_bits_however_the_image_is_tiled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = rigs.scene(
        rigs.pinhole((48, 36), lens={"aperture_mm": 5.0, "focus_mm": 190.0}),
        rigs.pinhole_projector(),
        ambient=1.0,
    )
    once = render.trace(scene, seed=3, samples=8)
    monkeypatch.setattr(one_pass, "TILE_NUMBERS", 48 * 7 * 5)
    again = render.trace(scene, seed=3, samples=8)
    other = render.trace(scene, seed=4, samples=8)

    for name in ("total", "direct", "ambient", "label"):
        np.testing.assert_array_equal(getattr(once, name), getattr(again, name))
    assert (once.total != other.total).mean() > 0.5


def test_indirect_light_of_one_seed_is_independent_of_its_neighbours() -> None:
    scene = rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.groove())
    light = np.stack([render.trace(scene, seed=i, samples=16).total[0, 0] for i in range(40)])
    spread = light - light.mean(axis=0)
    # How well a seed learns where to look sets the size of its noise in all pixels; its signs are what must be free.
    spread /= spread.std(axis=(1, 2), keepdims=True)
    spread /= spread.std(axis=0)
    # Correlations between pixels over 40 seeds scatter by 1/sqrt(39); their mean square shows a common cause.
    pixels = spread.reshape(40, -1)
    between = (pixels.T @ pixels / 40)[np.triu_indices(pixels.shape[1], 1)]
    assert np.mean(between**2) == pytest.approx(1 / 39, rel=0.05)


def test_labels_follow_the_objects_in_the_order_of_the_scene() -> None:
    transport = render.trace(
        rigs.scene(rigs.pinhole((60, 45)), rigs.pinhole_projector()), samples=1
    )
    assert transport.labels == ("base", "cap", "step", "ink", "solder")
    assert set(np.unique(transport.label)) == {1, 2, 3, 4, 5}
    # One pixel a millimetre, row 0 at y = +22: the cap's middle is at x = -12, y = 6.
    assert transport.label[16, 18] == 2
    assert transport.label[36, 30] == 4


def test_direct_light_does_not_depend_on_depth() -> None:
    scene = rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.groove())
    shallow = render.trace(scene, samples=8, depth=1)
    deep = render.trace(scene, samples=8, depth=4)
    np.testing.assert_array_equal(shallow.total, shallow.direct)
    np.testing.assert_allclose(deep.direct, shallow.direct, rtol=1e-6)
    assert (deep.total[0, 0] >= deep.direct[0, 0]).all()
    assert deep.total[0, 0].mean() > 1.1 * deep.direct[0, 0].mean()


def test_projector_whose_plane_holds_the_origin_leaves_no_nan_where_rays_meet_nothing() -> None:
    # A ray that meets nothing leaves zeros behind: the world's origin, here at depth 0 of the projector.
    projector = rigs.pinhole_projector()
    projector["pose"] = {
        "origin_mm": (0.0, 0.0, 60.0),
        "target_mm": (50.0, 0.0, 60.0),
        "up": (0, 0, 1),
    }
    scene = rigs.scene(rigs.pinhole(field_mm=300.0), projector)
    transport = render.trace(scene, samples=4)
    assert (transport.label == 0).any()
    assert np.isfinite(transport.total).all()


@pytest.mark.parametrize("wrong", [{"samples": 0}, {"depth": 0}, {"samples": -3}])
def test_impossible_samples_or_depth_are_named(wrong: dict[str, Any]) -> None:
    with pytest.raises(RenderError, match=rf"{next(iter(wrong))} = "):
        render.trace(rigs.scene(rigs.pinhole(), rigs.pinhole_projector()), **wrong)


def test_frames_and_projectors_a_scene_lacks_are_named() -> None:
    scene = rigs.scene(rigs.pinhole(), rigs.pinhole_projector())
    with pytest.raises(RenderError, match="frame 3 does not exist"):
        render.mitsuba_scene(scene, frame=3)
    with pytest.raises(RenderError, match="projector 1 does not exist"):
        render.mitsuba_scene(scene, projector=1)
    with pytest.raises(RenderError, match="projector -1 does not exist"):
        render.trace(scene, samples=1).frames(-1)


def test_transport_file_comes_back_whole(tmp_path: Path) -> None:
    # The second projector's tables are fewer than the first's sinusoids of two axes.
    scene = rigs.scene(
        rigs.pinhole(),
        rigs.pinhole_projector(),
        rigs.telecentric_projector(bits=1),
        patterns={"axes": ("column", "row")},
    )
    written = render.trace(scene, seed=5, samples=2, depth=2)
    written.write(tmp_path / "transport.exr")
    back = render.Transport.read(tmp_path / "transport.exr")

    for name in ("total", "direct", "ambient", "label"):
        np.testing.assert_array_equal(getattr(written, name), getattr(back, name))
    for p in range(2):
        np.testing.assert_array_equal(written.frames(p), back.frames(p))
    assert (back.scene, back.labels, back.seed, back.samples, back.depth) == (
        scene,
        scene.labels,
        5,
        2,
        2,
    )
    with pytest.raises(FileError, match="does not exist"):
        render.Transport.read(tmp_path / "nothing.exr")


def test_direct_light_out_of_focus_has_a_tenth_of_the_noise_of_independent_samples() -> None:
    """64 of the shipped scene's pixels in the middle; in focus the fringe has the modulation of a pinhole."""
    crop = {"resolution": (8, 8), "calibrated_at": (8, 8), "cx_px": 4.0, "cy_px": 4.0}
    settings = {f"camera.{key}": value for key, value in crop.items()}
    samples = 64

    def fringe(lens: Any, seed: int) -> NDArray[np.complex128]:
        scene = scenes.load("defocus", settings | {"projectors.0.lens": lens})
        light = render.trace(scene, samples=samples, depth=1, seed=seed)
        finest = finest_fringes(scene.patterns, light.bases)[0]
        cosine, sine = finest.phasor(light.direct[0], 0)
        return np.asarray(cosine + 1j * sine, np.complex128)

    wide = {"aperture_mm": 24.0, "focus_mm": 280.0}
    one, two = (fringe(wide, seed) for seed in (1, 2))
    sharp = np.abs(fringe(None, 1)).mean()
    noise = np.sqrt(np.mean(np.angle(one * two.conj()) ** 2) / 2.0)
    # A sample's phasor is as long as in focus and turned at random: half of its square lies across the mean.
    independent = sharp / np.sqrt(2.0 * samples) / np.abs(one).mean()
    assert np.abs(one).mean() < 0.7 * sharp
    assert noise < 0.1 * independent
