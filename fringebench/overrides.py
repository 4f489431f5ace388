"""``--set key=value`` on the command line: values are TOML, bare words are text."""

from collections.abc import Iterable
from typing import Any

from scenes.errors import SceneError
from scenes.foreign_text import parse_toml
from scenes.load import dumps, parse
from scenes.scene import Scene

# Tables of a scene that come after its light.
EXPOSED = ("sensor", "exposures", "patterns")


def parse_overrides(
    settings: Iterable[str], phase_error_rad: float | None = None
) -> dict[str, Any]:
    """Dotted key -> value of each ``key=value``; `SceneError` for one without a key or an equals sign.

    `phase_error_rad` is the value of ``--phase-error``, which goes before a setting of its key.

    >>> parse_overrides(["camera.resolution=[320, 240]", "sensor.kind=simple"])
    {'camera.resolution': [320, 240], 'sensor.kind': 'simple'}
    """
    overrides = dict(_one(setting) for setting in settings)
    if phase_error_rad is not None:
        overrides["sampling.phase_error_rad"] = phase_error_rad
    return overrides


def exposed_otherwise(scene: Scene, settings: Iterable[str]) -> Scene:
    """The scene of traced light with ``key=value`` settings of its sensor, exposures or patterns.

    Raises `SceneError` for a key that another trace would have to follow.
    """
    overrides = parse_overrides(settings)
    for key in overrides:
        if key.partition(".")[0] not in EXPOSED:
            raise SceneError(
                f"--set '{key}': traced light can be exposed with other {', '.join(EXPOSED)} only; for another scene trace "
                "again, with fringebench render"
            )
    return parse(dumps(scene), overrides, where=scene.name) if overrides else scene


def _one(setting: str) -> tuple[str, Any]:
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
