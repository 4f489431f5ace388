"""How light changes as the scene moves up and down: the slope that vibration is made with."""

from dataclasses import replace

import numpy as np

from render.pathtracer.one_pass import trace
from render.plugins.shared_surfaces import Surfaces
from render.transport import Transport
from scenes.rig.devices import Extrinsics, Pose
from scenes.scene import Scene

# Displacement to both sides for the difference, at least: enough to stand out of the noise of light, and small against
# a fringe (a phase of 0.2 rad at 0.3 mm of height per fringe, of which the difference misses 0.7 %).
STEP_MM = 0.01


def height_slope(
    transport: Transport, surfaces: Surfaces | None = None, footprint: float = 1.0
) -> Transport:
    """Change of a transport per mm that the scene rises: a central difference of two more traces.

    Parameters
    ----------
    transport
        Light of the scene at its place.
    surfaces
        Those of `render.surfaces`, to build the meshes only once.
    footprint
        As the transport was traced with.

    Returns
    -------
    Transport
        `total`, `direct` and `ambient` in W/(m^2 sr) per mm, to give to `render.expose`.

    Notes
    -----
    Light from a scene displaced by z is ``L + z dL/dz``: exact while z is small against a fringe's height and a pixel. All
    displaced frames together cost two traces, whatever their number; a trace each would cost as many as there are frames.
    """
    step_mm = max(STEP_MM, transport.scene.vibration_um * 1e-3)
    low, high = (
        trace(
            _raised(transport.scene, z),
            transport.seed,
            transport.samples,
            transport.depth,
            footprint,
            surfaces=surfaces,
        )
        for z in (-step_mm, step_mm)
    )
    scale = np.float32(0.5 / step_mm)
    return replace(
        transport,
        total=(high.total - low.total) * scale,
        direct=(high.direct - low.direct) * scale,
        ambient=(high.ambient - low.ambient) * scale,
    )


def _raised(scene: Scene, z_mm: float) -> Scene:
    """The scene with its objects higher by z: the devices are lowered instead, so that surfaces stay."""
    camera = scene.camera.model_copy(update={"pose": _lowered(scene.camera.pose, z_mm)})
    projectors = [p.model_copy(update={"pose": _lowered(p.pose, z_mm)}) for p in scene.projectors]
    return scene.model_copy(update={"camera": camera, "projectors": tuple(projectors)})


def _lowered(pose: Pose, z_mm: float) -> Pose:
    rotation, translation = pose.matrix()
    moved = translation + rotation[:, 2] * z_mm
    return Extrinsics(R=tuple(map(tuple, rotation)), t_mm=tuple(moved))
