"""A scene with distributions becomes the concrete scene of one sample."""

import zlib
from typing import Any

import numpy as np

from scenes.scene import Scene
from scenes.scene_files import dumps, parse
from scenes.support.errors import SceneError

BOARD = 0
RANDOMISE = 1
# Tables that do not change the light in front of the sensor.
AFTER_THE_LIGHT = ("sensor.", "exposures.")


def realise(scene: Scene, index: int, seed: int = 0, light_index: int | None = None) -> Scene:
    """Draw one sample of a scene with distributions.

    Every key of `randomise` is drawn and set, and the board gets a seed of its own, from which its layers, paste and
    defects are drawn whenever it is built. The result is an ordinary scene: it holds the drawn values, survives TOML
    unchanged and gives the same meshes. Each key has its own random stream, so that adding one changes no other.

    Parameters
    ----------
    scene
        The scene with its `randomise` table.
    index
        Number of the sample, from 0.
    seed
        Seed of the data set, from 0. Scene, index and seed determine the result.
    light_index
        Number of another sample from which everything but `sensor` and `exposures` is drawn: the same light, exposed again.

    Raises
    ------
    SceneError
        `index` or `seed` is below 0, a key is unknown, or a drawn value is invalid.

    Examples
    --------
    >>> import scenes
    >>> spi = scenes.load("spi")
    >>> scenes.realise(spi, 3, seed=7) == scenes.realise(spi, 3, seed=7)
    True
    """
    light = index if light_index is None else light_index
    if index < 0 or seed < 0 or light < 0:
        raise SceneError(f"index {index}, seed {seed}: both count from 0")
    overrides: dict[str, Any] = {}
    for key, distribution in scene.randomise.items():
        stream = (RANDOMISE, zlib.crc32(key.encode()))
        drawn_for = index if key.startswith(AFTER_THE_LIGHT) else light
        overrides[key] = distribution.draw(_generator(seed, drawn_for, *stream))
    if scene.board is not None:
        overrides["board.seed"] = int(_generator(seed, light, BOARD).integers(2**63))
        transfer = scene.board.paste.transfer
        if transfer.wipe_every:  # The samples are the prints of one run.
            overrides["board.paste.transfer.print_number"] = transfer.print_number + light
    concrete = scene.model_copy(update={"randomise": {}})
    return parse(dumps(concrete), overrides, where=f"{scene.name}, sample {index} of seed {seed}")


def _generator(seed: int, index: int, *stream: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence((seed, index), spawn_key=stream))
