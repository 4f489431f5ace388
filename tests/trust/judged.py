"""Repeated estimates of a scene's frames by the fast pass and by Mitsuba's `path`, and tests of their difference."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

import render
from render.plugins.variant import mi
from scenes import Scene
from tests.render.oracle import Comparison
from tests.trust import chance

# Every repeat is a mean over so many paths, every frame is repeated so often. The variance of a pixel is measured from the
# repeats, so the products of these decide the power, and the first how near to normal a repeat is.
SAMPLES, REPEATS, FRAMES = 512, 24, 3


@dataclass(frozen=True)
class Judged:
    """One scene; `ours` and `oracle` are radiances (repeat, frame, row, col)."""

    scene: Scene
    projector: int
    frames: tuple[int, ...]
    ours: NDArray[np.float64]
    oracle: NDArray[np.float64]

    @classmethod
    def of(
        cls, name: str, scene: Scene, samples: int = SAMPLES, judge: Scene | None = None
    ) -> Self:
        """Some frames of one projector, drawn at random, each judged by renders of its own.

        With another scene for `judge`, only the fast pass's direct light is compared.
        """
        rng = chance.generator("frames", name)
        projector = int(rng.integers(len(scene.projectors)))
        count = len(scene.patterns.frames())
        frames = tuple(sorted(int(f) for f in rng.choice(count, min(FRAMES, count), replace=False)))
        judges = [render.mitsuba_scene(judge or scene, frame, projector) for frame in frames]
        oracle = [
            [
                np.array(mi.render(one, spp=samples, seed=seed))[..., 0]
                for seed in chance.seeds(REPEATS, "path", name, frame)
            ]
            for one, frame in zip(judges, frames, strict=True)
        ]
        seeds = chance.seeds(REPEATS, "ours", name)
        direct_only = judge is not None
        ours = _traced(scene, seeds, samples, projector, frames, direct_only=direct_only)
        return cls(scene, projector, frames, ours, np.swapaxes(oracle, 0, 1).astype(np.float64))

    def traced_as(
        self, scene: Scene, name: str, samples: int = SAMPLES, depth: int | None = None
    ) -> Self:
        """The same reference, compared with other light: for example that of a faulty scene."""
        seeds = chance.seeds(REPEATS, "ours", name)
        return replace(
            self, ours=_traced(scene, seeds, samples, self.projector, self.frames, depth)
        )

    def scaled(self, factor: float) -> Self:
        """Our radiance times a factor."""
        return replace(self, ours=self.ours * factor)

    def halves(self) -> Self:
        """The reference compared with itself: its even repeats with its odd ones."""
        return replace(self, ours=self.oracle[::2], oracle=self.oracle[1::2])

    def pixel_p_values(self) -> NDArray[np.float64]:
        """Of Welch's test in every pixel of every frame, (frame, row, col)."""
        return np.stack(
            [
                Comparison(self.ours[:, f], self.oracle[:, f]).pixel_p_values()
                for f in range(len(self.frames))
            ]
        )

    def deviations(self) -> NDArray[np.float64]:
        """Normal deviates of the differences, (frame, row, col)."""
        return chance.deviates(
            self.pixel_p_values(), self.ours.mean(axis=0) - self.oracle.mean(axis=0)
        )

    def save(self, folder: Path) -> None:
        """Image, reference and z map of each frame as EXR, in a folder per frame."""
        for f, frame in enumerate(self.frames):
            into = folder / f"frame-{frame}"
            into.mkdir()
            Comparison(self.ours[:, f], self.oracle[:, f]).save(into)

    def frame_p_values(self) -> list[float]:
        """Of the mean over the image, frame by frame."""
        return [
            Comparison(self.ours[:, f], self.oracle[:, f]).mean_bias()[2]
            for f in range(len(self.frames))
        ]

    def bias(self) -> tuple[float, float, float]:
        """Of the mean over pixels and frames: relative bias, its standard error, p-value."""
        shape = (REPEATS, 1, -1)
        return Comparison(self.ours.reshape(shape), self.oracle.reshape(shape)).mean_bias()


def _traced(
    scene: Scene,
    seeds: list[int],
    samples: int,
    projector: int,
    frames: tuple[int, ...],
    depth: int | None = None,
    direct_only: bool = False,
) -> NDArray[np.float64]:
    traced = (render.trace(scene, seed=seed, samples=samples, depth=depth) for seed in seeds)
    light = [one.frames(projector, direct_only=direct_only)[list(frames)] for one in traced]
    return np.stack(light).astype(np.float64)
