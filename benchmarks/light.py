"""Scenes and renders that benchmarks of light share."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import render
import scenes
from render.plugins.camera_sensor import camera_plugin
from render.plugins.variant import mi


def scene(
    name: str = "bench", size: tuple[int, int] = (640, 480), samples: int = 64, depth: int = 3
) -> scenes.Scene:
    """A shipped scene at some size."""
    return scenes.load(
        name,
        {"camera.resolution": list(size), "sampling.samples": samples, "sampling.depth": depth},
    )


class Path:
    """Mitsuba's `path` on a scene: one render a frame, each scene built beforehand.

    `depth` counts surface vertices, `max_depth` of `path` the segments too: 3 are its 4.
    """

    def __init__(self, scene: scenes.Scene, sampler: str, frames: int = 1) -> None:
        self._scenes = [render.mitsuba_scene(scene, frame) for frame in range(frames)]
        samples = scene.sampling.samples
        self._sensor = mi.load_dict(
            camera_plugin(scene.camera, samples)
            | {"sampler": {"type": sampler, "sample_count": samples}}
        )

    def render(self, frame: int, samples: int, seed: int) -> NDArray[np.float32]:
        """Radiance (row, col)."""
        image = mi.render(self._scenes[frame], sensor=self._sensor, spp=samples, seed=seed)
        return np.asarray(np.array(image)[..., 0], np.float32)

    def one_frame(self, samples: int, draw: Callable[[], int]) -> Callable[[], Any]:
        """A render of the first frame, each time with another seed."""
        return lambda: self.render(0, samples, draw())


def seeds(seed: int) -> Callable[[], int]:
    """Draws seeds: Mitsuba's random numbers of neighbouring ones are correlated."""
    rng = np.random.default_rng(seed)
    return lambda: int(rng.integers(2**31))


def tracing(scene: scenes.Scene, draw: Callable[[], int]) -> Callable[[], Any]:
    """One pass for all frames, tessellation and building of the scene included."""
    return lambda: render.trace(scene, seed=draw())
