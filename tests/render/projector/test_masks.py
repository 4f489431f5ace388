"""Masked light: of a Gray code's bit as a mask, compared with that bit's own light, which was traced."""

import numpy as np
import pytest
from scipy import ndimage

import render
import scenes
from render.projector.masks import _blurred, _levels, masked
from scenes.acquisition.patterns import GrayBits, PhaseShift
from scenes.support.errors import RenderError


@pytest.mark.slow
def test_stripes_as_a_mask_are_the_stripes_that_were_traced() -> None:
    """On a groove, whose indirect light of one half comes from the other."""
    settings = {"camera.resolution": [80, 60], "sampling.samples": 64, "sensor.psf": "none"}
    scene = scenes.load("interreflection", settings)
    assert isinstance(scene.patterns, PhaseShift)
    shown = scene.patterns.model_copy(update={"gray": GrayBits(bits=7, cell_px=8.0)})
    scene = scene.model_copy(update={"patterns": shown})
    light = render.trace(scene)
    truth = render.truth(scene, light)
    columns, rows = scene.projectors[0].resolution
    fine = [i for i, f in enumerate(scene.frames) if f.kind == "fringe" and f.period_px == 16.0]

    def white(one: render.Transport, direct_only: bool) -> np.ndarray:
        """Twice the mean of all steps, whose mean level is 1/2."""
        return np.asarray(2.0 * one.frames(direct_only=direct_only)[fine].mean(axis=0))

    bright, near = white(light, False), white(light, True)
    errors = []
    for i, frame in enumerate(scene.frames):
        # Stripes of 512 px and 256 px; finer ones are narrower than a camera pixel and the origin of indirect light.
        if frame.kind != "gray" or frame.inverted or frame.step > 1:
            continue
        bit = frame.commanded(np.arange(0.5, columns))
        found = masked(light, truth, [np.broadcast_to(bit, (rows, columns))])
        direct = light.frames(direct_only=True)[i]
        off = white(found, True) - direct
        # At most two edges among some 60 lit columns: in their pixels up to half of the light is on the wrong side.
        assert np.sqrt(np.mean(off**2)) < 0.5 * np.sqrt(2 / 60) * np.sqrt(np.mean(near**2))
        scattered = light.frames()[i] - direct
        off = white(found, False) - white(found, True) - scattered
        scale = np.sqrt(np.mean((bright - near) ** 2))
        errors.append(np.sqrt(np.mean(off**2)) / scale)
        # Without its origin, each pixel's own level or the mean level would be taken for it.
        own = np.where(near > 0.0, white(found, True) / np.maximum(near, 1e-12), bit.mean())
        for guess in (own, bit.mean()):
            wrong = (bright - near) * guess - scattered
            assert errors[-1] < 0.5 * np.sqrt(np.mean(wrong**2)) / scale
    assert len(errors) == 2
    assert max(errors) < 0.2


def test_blur_is_gaussian_and_mirrored_at_the_borders() -> None:
    """A Gaussian of 1.5 px has 1.5e-5 of its mean left at the sampling limit: so far may a filter of its samples be off."""
    mask = np.random.default_rng(0).uniform(size=(12, 20))
    found = _blurred(mask, np.array([0.0, 1.5, 2.5]))
    np.testing.assert_allclose(found[0], mask)
    for blurred, width in zip(found[1:], (1.5, 2.5), strict=True):
        expected = ndimage.gaussian_filter(mask, width, mode="reflect", truncate=9.0)
        np.testing.assert_allclose(blurred, expected, atol=1.5e-5)


def test_level_between_mask_pixels_is_linear_from_centre_to_centre() -> None:
    """Pixel k spans from k to k + 1; beyond the outermost centres the level stays."""
    row, column = np.mgrid[:6, :8].astype(np.float64)
    at = np.random.default_rng(0).uniform(0.5, 5.5, (2, 50))
    found = _levels((10.0 * row + column)[None], at, np.zeros(50))
    np.testing.assert_allclose(found, 10.0 * (at[0] - 0.5) + at[1] - 0.5, rtol=1e-6)


def test_masks_of_another_size_are_refused() -> None:
    light = render.trace(scenes.load("step", {"camera.resolution": [16, 12]}), samples=1)
    with pytest.raises(RenderError, match="rows, columns"):
        masked(light, render.truth(light.scene), [np.ones((3, 4))])
