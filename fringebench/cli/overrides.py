"""``--set key=value`` (values are TOML, bare words are text) and ``--name PART=NAME`` on the command line."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenes import Scene

# Tables of a scene that do not change its light transport.
EXPOSED = ("sensor", "exposures", "patterns")


def parse_overrides(
    settings: Iterable[str], phase_error_rad: float | None = None, render_noise: float | None = None
) -> dict[str, Any]:
    """Dotted key -> value of each ``key=value``; `SceneError` for one without a key or an equals sign.

    `phase_error_rad` is the value of ``--phase-error``, `render_noise` that of ``--render-noise``; each takes precedence over
    a setting of its key, and over the other's key in the scene. Raises `SceneError` if both are given.

    >>> parse_overrides(["camera.resolution=[320, 240]", "sensor.kind=simple"])
    {'camera.resolution': [320, 240], 'sensor.kind': 'simple'}
    """
    overrides = dict(_one(setting) for setting in settings)
    limits = {"phase_error_rad": phase_error_rad, "render_noise": render_noise}
    if None not in limits.values():
        from scenes.support.errors import SceneError

        raise SceneError(
            f"--phase-error {phase_error_rad:g} and --render-noise {render_noise:g}: give one of the two"
        )
    overrides |= {f"sampling.{key}": value for key, value in limits.items() if value is not None}
    return overrides


def part_names(given: Iterable[str]) -> dict[str, str]:
    """Part -> name of each ``PART=NAME``; `FileError` for another form.

    >>> part_names(["first_matrix=cam_K"])
    {'first_matrix': 'cam_K'}
    """
    from scenes.support.errors import FileError

    names = {}
    for text in given:
        part, equals, name = text.partition("=")
        if not equals or not part or not name:
            raise FileError(f"--name '{text}': write PART=NAME, such as first_matrix=cam_K")
        names[part] = name
    return names


def override_exposed(scene: "Scene", settings: Iterable[str]) -> "Scene":
    """The scene of traced light with ``key=value`` settings of its sensor, exposures or patterns.

    Raises `SceneError` for a key that would need a new trace.
    """
    from scenes.scene_files import dumps, parse
    from scenes.support.errors import SceneError

    overrides = parse_overrides(settings)
    for key in overrides:
        if key.partition(".")[0] not in EXPOSED:
            raise SceneError(
                f"--set '{key}': traced light can only be exposed with other {', '.join(EXPOSED)}; to change the scene, "
                "trace again with fringebench render"
            )
    return parse(dumps(scene), overrides, where=scene.name) if overrides else scene


def _one(setting: str) -> tuple[str, Any]:
    from scenes.support.errors import SceneError
    from scenes.support.safe_parse import parse_toml

    key, equals, text = setting.partition("=")
    key = key.strip()
    if not equals or not key or "" in key.split("."):
        raise SceneError(
            f"--set '{setting}': write key=value with a dotted key, e.g. --set camera.resolution=[320,240]"
        )
    try:
        return key, parse_toml(f"value = {text}")["value"]
    except ValueError:
        return key, text.strip()
