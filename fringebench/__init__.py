"""The front door: the rooms, the nouns and the verbs of fringebench under one name.

>>> import fringebench as fb
>>> fb.load("step").name
'step'
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import decode
    import evaluation
    import render
    import scenes
    from decode import Reconstruction, reconstruct
    from evaluation import Score, score
    from fringebench.datasets.reader import Dataset
    from fringebench.verbs import accept, budget, compare, dataset, methods, regress, run
    from render import Transport, expose, mitsuba_scene, trace, truth
    from scenes import Scene, Stack, Truth, load, meshes

    __version__: str

__all__ = [
    "Dataset", "Reconstruction", "Scene", "Score", "Stack", "Transport", "Truth", "__version__",
    "accept", "budget", "compare", "dataset", "decode", "evaluation", "expose", "load", "meshes",
    "methods", "mitsuba_scene", "reconstruct", "regress", "render", "run", "scenes", "score", "trace", "truth",
]  # fmt: skip

_ROOMS = ("scenes", "render", "decode", "evaluation")
_HOMES = {
    "scenes": ("load", "meshes", "Scene", "Stack", "Truth"),
    "render": ("trace", "expose", "truth", "mitsuba_scene", "Transport"),
    "decode": ("reconstruct", "Reconstruction"),
    "evaluation": ("score", "Score"),
    "fringebench.verbs": ("run", "compare", "regress", "budget", "dataset", "accept", "methods"),
    "fringebench.datasets.reader": ("Dataset",),
}


def __getattr__(name: str) -> Any:
    """Load a room when it is first used: asking for help must not wait for a renderer."""
    if name in _ROOMS:
        return importlib.import_module(name)
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("fringebench")
    for home, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(home), name)
    raise AttributeError(f"module 'fringebench' has no attribute '{name}'")


def __dir__() -> list[str]:
    """Names for completion in a shell or an editor."""
    return sorted({*globals(), *__all__})
