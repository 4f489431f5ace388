"""The camera as a Mitsuba sensor, so that Mitsuba's own integrators use the same camera as the tracer."""

import functools
from typing import Any

from pydantic import TypeAdapter

from render.plugins.lens import optics
from render.plugins.variant import mi
from scenes.rig.projectors import Camera

PLUGIN = "fringe_camera"


def camera_plugin(camera: Camera, samples: int) -> dict[str, Any]:
    """Mitsuba's dictionary entry of a camera; its film averages radiance over each pixel's square, in float32."""
    register(mi.variant())
    width, height = camera.resolution
    return {
        "type": PLUGIN,
        "device": camera.model_dump_json(),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "luminance",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": samples},
    }


@functools.cache
def register(variant: str) -> None:
    """Register the plugin with Mitsuba, once per variant, as its classes differ between variants."""

    class FringeCamera(mi.Sensor):  # type: ignore[misc]
        """Radiance along rays through `device`'s pixels (JSON of a `scenes` camera), averaged over its pupil."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            device = TypeAdapter(Camera).validate_json(props["device"])
            self.optics = optics(device)
            self.resolution = mi.ScalarVector2f(device.resolution)
            self.m_needs_sample_3 = device.lens is not None

        def sample_ray(
            self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True
        ) -> tuple[Any, Any]:
            origin, direction = self.optics.ray(position * self.resolution, aperture)
            ray = mi.Ray3f(origin, direction, time)
            return ray, mi.Color1f(1)

        def sample_ray_differential(
            self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True
        ) -> tuple[Any, Any]:
            # No material here has a texture: differentials would only cost two more undistortions.
            ray, weight = self.sample_ray(time, wavelength, position, aperture, active)
            return mi.RayDifferential3f(ray), weight

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

        def traverse(self, callback: Any) -> None:
            super().traverse(callback)

        def to_string(self) -> str:
            return "FringeCamera[]"

    mi.register_sensor(PLUGIN, FringeCamera)
