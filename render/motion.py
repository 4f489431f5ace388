"""Light of a scene that moves between pictures: its slope along z, for vibration, and a trace each along x and y."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from render.pathtracer.one_pass import trace
from render.plugins.shared_surfaces import Surfaces
from render.plugins.shared_surfaces import surfaces as make_surfaces
from render.transport import Transport
from scenes.rig.devices import Extrinsics, Pose, Vector
from scenes.scene import Scene

# Displacement to both sides for the difference, at least: enough to exceed the noise of light, and small against
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
            _displaced(transport.scene, (0.0, 0.0, z)),
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


def conveyed(
    transport: Transport,
    projectors: Sequence[int],
    surfaces: Surfaces | None = None,
    footprint: float = 1.0,
) -> Iterator[Transport]:
    """Light of each picture of a scene on a conveyor (`conveyor_um`), which is at its place in the middle of them.

    Parameters
    ----------
    transport
        Light of the scene at its place.
    projectors
        Which of them lights each picture, in the order taken: pattern by pattern, and of each all exposures.
    surfaces, footprint
        As of `height_slope`.

    Yields
    ------
    Transport
        Light of that projector alone, with as many samples as `transport`; that of the others is 0.

    Notes
    -----
    Exact, as everything in the scene takes part, with its shadows and interreflections, but for motion within an exposure.
    It costs a trace per picture.

    Examples
    --------
    >>> import scenes, render
    >>> scene = scenes.load("step", {"camera.resolution": [32, 24], "conveyor_um": [50.0, 0.0]})
    >>> light = render.trace(scene, samples=2)
    >>> moved = list(render.conveyed(light, [0, 0, 0]))
    >>> [bool((picture.total == light.total).all()) for picture in moved]
    [False, True, False]
    """
    scene = transport.scene
    surfaces = surfaces or make_surfaces(scene)
    for i, projector in enumerate(projectors):
        x, y = (step * 1e-3 * (i - (len(projectors) - 1) / 2.0) for step in scene.conveyor_um)
        alone = scene.model_copy(update={"projectors": (scene.projectors[projector],)})
        one = trace(
            _displaced(alone, (x, y, 0.0)),
            transport.seed,
            transport.samples,
            transport.depth,
            footprint,
            surfaces=surfaces,
        )
        total, direct = np.zeros_like(transport.total), np.zeros_like(transport.direct)
        total[projector, : one.total.shape[1]] = one.total[0]
        direct[projector, : one.total.shape[1]] = one.direct[0]
        yield replace(transport, total=total, direct=direct, ambient=one.ambient, label=one.label)


def _displaced(scene: Scene, by_mm: Vector) -> Scene:
    """The scene with its objects displaced: the devices move the other way instead, so that surfaces stay."""
    camera = scene.camera.model_copy(update={"pose": _opposite(scene.camera.pose, by_mm)})
    projectors = [p.model_copy(update={"pose": _opposite(p.pose, by_mm)}) for p in scene.projectors]
    return scene.model_copy(update={"camera": camera, "projectors": tuple(projectors)})


def _opposite(pose: Pose, by_mm: Vector) -> Pose:
    rotation, translation = pose.matrix()
    moved = translation + rotation @ np.asarray(by_mm)
    return Extrinsics(R=tuple(map(tuple, rotation)), t_mm=tuple(moved))
