"""Our own decoder with one fault each, as a team might ship it."""

from dataclasses import replace

import numpy as np

import decode
from scenes import Stack

Heights = tuple[np.ndarray, np.ndarray, np.ndarray]


def _parts(rec: decode.Reconstruction) -> Heights:
    return rec.height_mm, rec.valid, rec.sigma_mm


def honest(stack: Stack) -> decode.Reconstruction:
    return decode.reconstruct(stack)


def ignores_saturation(stack: Stack) -> decode.Reconstruction:
    return decode.reconstruct(stack, saturation="ignore")


def saturation_a_little_too_high(stack: Stack) -> decode.Reconstruction:
    """Takes 2 % over what the camera can give for saturation's level: all clipped samples count."""
    sensor = stack.sensor.model_copy(update={"bits": stack.sensor.bits + 1})
    if hasattr(sensor, "full_well_e"):
        sensor = sensor.model_copy(update={"full_well_e": 1.02 * sensor.full_well_e})
    return decode.reconstruct(replace(stack, sensor=sensor))


def trusts_everything(stack: Stack) -> Heights:
    """A mask that rejects nothing."""
    height, _, sigma = _parts(decode.reconstruct(stack, min_modulation_dn=0.0))
    return height, np.isfinite(height), sigma


def shifted_mask(stack: Stack) -> Heights:
    """A mask off by three columns."""
    height, valid, sigma = _parts(decode.reconstruct(stack))
    return height, np.roll(valid, 3, axis=1), sigma


def swapped_steps(stack: Stack) -> decode.Reconstruction:
    """Reads the second and the last step of every fringe in each other's place."""
    order = np.arange(len(stack.patterns)).reshape(-1, stack.patterns[0].steps)
    order[:, [1, -1]] = order[:, [-1, 1]]
    return decode.reconstruct(replace(stack, frames=stack.frames[:, order.ravel()]))


def one_percent_high(stack: Stack) -> Heights:
    height, valid, sigma = _parts(decode.reconstruct(stack))
    return 1.01 * height, valid, sigma


def boastful(stack: Stack) -> Heights:
    """Claims a tenth of its noise."""
    height, valid, sigma = _parts(decode.reconstruct(stack))
    return height, valid, 0.1 * sigma


def without_sigma(stack: Stack) -> np.ndarray:
    rec = decode.reconstruct(stack)
    return np.where(rec.valid, rec.height_mm, np.nan)


def raises(stack: Stack) -> Heights:
    raise RuntimeError("lens cap on")


def of_another_size(stack: Stack) -> np.ndarray:
    return np.zeros((3, 3))


not_callable = 5
