"""Comparisons of images find a planted fault and save the images that show it."""

from pathlib import Path

import numpy as np
import pytest

from render.plugins.variant import mi, use
from tests.render.oracle import Comparison, require_same


def test_failed_comparison_saves_image_reference_and_z_map(tmp_path: Path) -> None:
    use()
    rng = np.random.default_rng(0)
    ours, oracle = rng.normal(10.0, 0.1, (2, 24, 12, 16))
    Comparison(ours, oracle).require_equal(tmp_path)
    assert not list(tmp_path.iterdir())

    # 1.0 is 35 standard errors of the difference of two means of 24.
    ours[:, 3, 5] += 1.0
    with pytest.raises(pytest.fail.Exception, match=f"see .* in {tmp_path}"):
        Comparison(ours, oracle).require_equal(tmp_path)
    saved = {p.stem: np.squeeze(np.array(mi.Bitmap(str(p)))) for p in tmp_path.iterdir()}
    assert saved.keys() == {"image", "reference", "z"}
    assert np.argmax(saved["z"]) == 3 * 16 + 5
    np.testing.assert_allclose(saved["image"], ours.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(saved["reference"], oracle.mean(axis=0), rtol=1e-6)


def test_image_that_differs_is_saved_with_its_reference_and_the_difference(tmp_path: Path) -> None:
    use()
    reference = np.arange(12).reshape(3, 4)
    image, everywhere = reference.copy(), np.ones((3, 4), bool)
    require_same(image, reference, everywhere, tmp_path)
    image[1, 2] = 7
    require_same(image, reference, reference != 6, tmp_path)
    assert not list(tmp_path.iterdir())
    with pytest.raises(pytest.fail.Exception, match=f"1 pixels differ; see .* in {tmp_path}"):
        require_same(image, reference, everywhere, tmp_path)
    saved = {p.stem: np.squeeze(np.array(mi.Bitmap(str(p)))) for p in tmp_path.iterdir()}
    np.testing.assert_array_equal(saved["image"], image)
    np.testing.assert_array_equal(saved["reference"], reference)
    np.testing.assert_array_equal(saved["difference"], image != reference)
