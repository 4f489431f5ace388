"""A scene's surfaces, made once for all who look at them: meshes, and Mitsuba's scene of them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from render.mitsuba_scene import geometry
from render.variant import mi, use
from scenes.errors import RenderError
from scenes.meshes import Part, parts
from scenes.scene import Scene

# What of a scene its surfaces depend on.
KEYS = ("objects", "board", "materials")


@dataclass(frozen=True, eq=False)
class Surfaces:
    """For `trace` and `truth` of every scene with these objects, board and materials, whatever else differs."""

    made_of: Scene
    parts: tuple[Part, ...]

    @cached_property
    def mi_scene(self) -> Any:
        """Mitsuba's scene, made when first traced."""
        use()
        return mi.load_dict(geometry(self.parts))


def surfaces(scene: Scene) -> Surfaces:
    """Make the scene's meshes: most of the time that a small image takes, so do it once to trace, judge and trace again.

    Raises `MeshError` if one is unusable.

    >>> import scenes, render
    >>> scene = scenes.load("step", {"camera.resolution": [64, 48]})
    >>> shared = render.surfaces(scene)
    >>> light = render.trace(scene, samples=4, surfaces=shared)
    >>> truth = render.truth(scene, light, surfaces=shared)
    """
    return Surfaces(scene, parts(scene))


def shared(scene: Scene, given: Surfaces | None) -> Surfaces:
    """The surfaces given, or new ones; `RenderError` for those of another scene."""
    if given is None:
        return surfaces(scene)
    for key in KEYS:
        if getattr(given.made_of, key) != getattr(scene, key):
            raise RenderError(
                f"surfaces of another scene, '{given.made_of.name}': its {key} are not those of '{scene.name}'; "
                "give render.surfaces of this scene, or none"
            )
    return given
