"""Meshes have no cracks between their triangles."""

import numpy as np

import render
import scenes


def test_rays_on_triangle_edges_hit_the_mesh() -> None:
    # The apex is on a pixel's corner, so pixel centres are exactly on the spokes at 45 degrees.
    centre = np.array([-3.0, 1.5])
    overrides = {"objects.1.position_mm": [*centre, 0.0], "sampling.samples": 1}
    truth = render.truth(scenes.load("chapter", overrides))
    r = np.hypot(*np.moveaxis(truth.xyz_mm[..., :2] - centre, -1, 0))
    # Chords of 256 segments are inside the rim by less than 0.001 of its radius.
    assert (truth.height_mm[r < 9.99] > 0.0).all()
    assert (truth.region("cap") == (r < 10.0))[np.abs(r - 10.0) > 0.01].all()
