"""Light on the chip: traced light behind the camera's lens, at a moment."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from render.blur.image_borders import fringe_terms
from render.blur.point_spread import binned, blurred, spread_kernel
from render.transport import Transport
from render.unsteady_light import STEADY, Moment
from scenes.acquisition.sensor import Sensor, without_blur
from scenes.rig.devices import EVEN

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Image:
    """Light on the chip, behind the lens, in W/(m^2 sr)."""

    light: NDArray[np.float32]
    """(projector, channel, row, col)"""
    ambient: NDArray[np.float32]
    """(row, col)"""
    label: NDArray[np.uint16]
    """(row, col)"""
    slope: "Image | None" = None
    """Its change per mm that the scene rises, where the scene moves."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        rows, columns = self.ambient.shape
        return rows, columns

    @classmethod
    def of(
        cls, transport: Transport, sensor: Sensor, subpixels: int = 1, direct_only: bool = False
    ) -> "Image":
        """A transport's light, all of it or the direct part, blurred by the sensor's lens and averaged over its pixels."""
        light = transport.direct if direct_only else transport.total
        ambient, label = transport.ambient, transport.label
        camera = transport.scene.camera
        if not camera.even:
            rows, columns = label.shape
            column, row = np.arange(columns) + 0.5, np.arange(rows)[:, None] + 0.5
            gain = camera.relative_illumination(column, row).astype(np.float32)
            light, ambient = light * gain, ambient * gain
        kernel = spread_kernel(sensor, subpixels)
        if kernel is not None:
            patterns = transport.scene.patterns
            terms = [fringe_terms(b, patterns) for b in transport.bases]
            light = blurred(light, kernel, terms, subpixels)
            ambient = blurred(ambient, kernel)
        if subpixels > 1:
            light, ambient = binned(light, subpixels), binned(ambient, subpixels)
            label = label[subpixels // 2 :: subpixels, subpixels // 2 :: subpixels]
        return cls(light, ambient, label)

    def radiance(
        self,
        projector: int,
        weights: Floats,
        pixels: slice | NDArray[np.intp],
        moment: Moment = STEADY,
    ) -> Floats:
        """Radiance (pixel,) of one frame at some pixels in row order, with ambient light, at that moment."""
        channels = self.light[projector].reshape(self.light.shape[1], -1)
        radiance = self.ambient.reshape(-1)[pixels].astype(np.float64) * moment.ambient
        for channel in np.flatnonzero(weights):
            radiance += (moment.source * weights[channel]) * channels[channel, pixels]
        if self.slope and moment.z_mm:
            radiance += moment.z_mm * self.slope.radiance(
                projector, weights, pixels, replace(moment, z_mm=0.0)
            )
        return radiance


def through_lens(transport: Transport) -> Transport:
    """Light as it arrives on the chip: what a perfect decoder would see of a scene.

    Parameters
    ----------
    transport
        Light before the lens.

    Returns
    -------
    Transport
        The same light behind the lens of the scene's camera and sensor: vignetted and blurred. Its scene has neither any
        more, so that `render.expose` takes the same pictures of it. The noise of its paths is not stated.

    Examples
    --------
    >>> import scenes, render
    >>> light = render.trace(scenes.load("step", {"camera.resolution": [32, 24]}), samples=2)
    >>> render.through_lens(light).scene.sensor.psf
    'none'
    """
    scene = transport.scene
    total, direct = (Image.of(transport, scene.sensor, direct_only=d) for d in (False, True))
    camera = scene.camera.model_copy(update=EVEN)
    return replace(
        transport,
        total=total.light,
        direct=direct.light,
        ambient=total.ambient,
        noise_rad=None,
        amplitude_noise=None,
        noise_correlation=None,
        scene=scene.model_copy(update={"sensor": without_blur(scene.sensor), "camera": camera}),
    )
