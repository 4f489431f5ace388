"""Light: a scene becomes linear transport, digital numbers and truth."""

from render.mitsuba_scene import mitsuba_scene
from render.tracer import trace
from render.transport import Transport

__all__ = ["Transport", "mitsuba_scene", "trace"]
