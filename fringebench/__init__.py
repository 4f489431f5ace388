"""The front door: the four rooms under one name.

>>> import fringebench as fb
>>> fb.load("step").name
'step'
"""

import importlib
from typing import Any

_ROOMS = ("scenes", "render", "decode", "evaluation")
_VERBS = {
    "load": "scenes",
    "meshes": "scenes",
    "Scene": "scenes",
    "Stack": "scenes",
    "Truth": "scenes",
    "trace": "render",
    "expose": "render",
    "truth": "render",
    "mitsuba_scene": "render",
    "Transport": "render",
    "reconstruct": "decode",
    "Reconstruction": "decode",
    "score": "evaluation",
    "Score": "evaluation",
    "Dataset": "fringebench.datasets.reader",
}

__all__ = [*_ROOMS, *_VERBS]  # noqa: PLE0604  names resolved by __getattr__


def __getattr__(name: str) -> Any:
    """Rooms load when first used: asking for help should not wait for a renderer."""
    if name in _ROOMS:
        return importlib.import_module(name)
    if name in _VERBS:
        return getattr(importlib.import_module(_VERBS[name]), name)
    raise AttributeError(f"module 'fringebench' has no attribute '{name}'")


def __dir__() -> list[str]:
    """For completion in a shell or an editor."""
    return sorted({*globals(), *__all__})
