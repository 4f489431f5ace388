"""A scene's surfaces, built once and used by several calls: meshes, and Mitsuba's scene of them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from render.plugins.scene_translation import geometry
from render.plugins.variant import mi, use
from scenes.scene import Scene
from scenes.scene_meshes import Part, parts
from scenes.support.errors import RenderError

# Keys of a scene on which its surfaces depend.
KEYS = ("objects", "board", "materials")


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Surfaces for `trace` and `truth` of every scene with these objects, board and materials."""

    made_of: Scene
    parts: tuple[Part, ...]

    @property
    def ids(self) -> list[int]:
        """Of each part, its label's id in label maps."""
        return [self.made_of.labels.index(part.label) + 1 for part in self.parts]

    @cached_property
    def mi_scene(self) -> Any:
        """Mitsuba's scene, built when first traced."""
        use()
        return mi.load_dict(geometry(self.parts))


def surfaces(scene: Scene) -> Surfaces:
    """Build the scene's meshes, to reuse them in several calls: they take most of the time of a small image.

    Raises `MeshError` if a mesh is unusable.

    Examples
    --------
    >>> import scenes, render
    >>> scene = scenes.load("step", {"camera.resolution": [64, 48]})
    >>> shared = render.surfaces(scene)
    >>> light = render.trace(scene, samples=4, surfaces=shared)
    >>> truth = render.truth(scene, light, surfaces=shared)
    """
    return Surfaces(scene, parts(scene))


def shared(scene: Scene, given: Surfaces | None) -> Surfaces:
    """The given surfaces, or new ones; `RenderError` if they are of another scene."""
    if given is None:
        return surfaces(scene)
    for key in KEYS:
        if getattr(given.made_of, key) != getattr(scene, key):
            raise RenderError(
                f"surfaces of another scene, '{given.made_of.name}': its {key} are not those of '{scene.name}'; "
                "give render.surfaces of this scene, or none"
            )
    return given
