"""Our own decoder with one fault each, as a team might ship it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import decode
from scenes import Stack

Image = NDArray[np.floating]
Heights = tuple[Image, NDArray[np.bool_], Image]


def parts(rec: decode.Reconstruction) -> Heights:
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
    height, _, sigma = parts(decode.reconstruct(stack, min_modulation_dn=0.0))
    return height, np.isfinite(height), sigma


def shifted_mask(stack: Stack) -> Heights:
    """A mask off by three columns."""
    height, valid, sigma = parts(decode.reconstruct(stack))
    return height, np.roll(valid, 3, axis=1), sigma


def swapped_steps(stack: Stack) -> decode.Reconstruction:
    """Reads the second and the last step of every fringe in each other's place."""
    order = np.arange(len(stack.patterns)).reshape(-1, stack.patterns[0].steps)
    order[:, [1, -1]] = order[:, [-1, 1]]
    return decode.reconstruct(replace(stack, frames=stack.frames[:, order.ravel()]))


def one_percent_high(stack: Stack) -> Heights:
    height, valid, sigma = parts(decode.reconstruct(stack))
    return 1.01 * height, valid, sigma


def boastful(stack: Stack) -> Heights:
    """Claims a tenth of its noise."""
    height, valid, sigma = parts(decode.reconstruct(stack))
    return height, valid, 0.1 * sigma


def wrong_orders(stack: Stack) -> Heights:
    """One fringe order off in 1 % of the pixels."""
    height, valid, sigma = parts(decode.reconstruct(stack))
    rng = np.random.default_rng(int(stack.frames.sum()))
    assert stack.calibration is not None
    low, high = stack.calibration.height_range_mm
    jump = np.where(rng.random(height.shape) < 0.01, high - low, 0.0)
    return height + jump, valid, sigma


def without_sigma(stack: Stack) -> Image:
    rec = decode.reconstruct(stack)
    return np.where(rec.valid, rec.height_mm, np.nan)


def raises(stack: Stack) -> Heights:
    raise RuntimeError("lens cap on")


def of_another_size(stack: Stack) -> Image:
    return np.zeros((3, 3))


not_callable = 5
