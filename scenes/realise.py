"""A scene with distributions becomes the concrete scene of one sample."""

import zlib
from typing import Any

import numpy as np

from scenes.errors import SceneError
from scenes.load import dumps, parse
from scenes.scene import Scene

BOARD = 0
RANDOMISE = 1


def realise(scene: Scene, index: int, seed: int = 0) -> Scene:
    """Sample `index` of the data set of that scene and seed; nothing else decides it.

    Every key of `randomise` is drawn and set, and the board gets a seed of its own, from which its layers, paste and
    defects are drawn whenever it is built. The result is a scene like any other: it holds what was drawn, goes through
    TOML unchanged and gives the same meshes. Each key has random numbers of its own, so that adding one changes no other.

    Raises `SceneError` for an `index` or `seed` below 0, an unknown key, or a drawn value that the scene cannot have.

    >>> import scenes
    >>> spi = scenes.load("spi")
    >>> scenes.realise(spi, 3, seed=7) == scenes.realise(spi, 3, seed=7)
    True
    """
    if index < 0 or seed < 0:
        raise SceneError(f"index {index}, seed {seed}: both count from 0")
    overrides: dict[str, Any] = {}
    for key, distribution in scene.randomise.items():
        stream = (RANDOMISE, zlib.crc32(key.encode()))
        overrides[key] = distribution.draw(_generator(seed, index, *stream))
    if scene.board is not None:
        overrides["board.seed"] = int(_generator(seed, index, BOARD).integers(2**63))
    concrete = scene.model_copy(update={"randomise": {}})
    return parse(dumps(concrete), overrides, where=f"{scene.name}, sample {index} of seed {seed}")


def _generator(seed: int, index: int, *stream: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence((seed, index), spawn_key=stream))
