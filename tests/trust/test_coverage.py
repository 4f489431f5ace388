"""Predicted standard deviations compared with repeated exposures: 68, 95 and 99.7 % of errors are within 1, 2, 3 sigma.

Light is traced once, so that its own noise, alike in all repeats, is no part of the errors: they are measured against the
phase and height that the same light gives without noise, rounding and clipping. Noise is drawn for each pixel by itself
(test_seeds.py), so pixels times repeats are independent trials, and their count is binomial.

Allowed on top of that: 1 % of sigma, which `decode` states for the light of these scenes, and the relative square of
the phase's sigma, to which order the arctangent bends and a sigma made of noisy modulations is itself noisy.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import decode
import render
import scenes
from decode.fusion.choosing import AutoExposureRule
from decode.fusion.interface import FusionRule
from evaluation.theory.cramer_rao import FringeLight
from scenes.acquisition.patterns import PhaseShift
from scenes.files.stack import Stack
from tests.trust import chance

pytestmark = pytest.mark.trust

Floats = NDArray[np.float64]
# Options with which all of a scene is decoded: at the dim one's noise of 1/7 rad pixels count as dark and orders as unsure.
SCENES: dict[str, dict[str, Any]] = {
    "bench": {},
    "solder": {},
    "spi": {},
    "defocus": {},
    "chapter": {},
    "chapter-dim": {"min_modulation_dn": 5.0, "max_order_residual": 0.5},
}
# With one exposure all rules are the same formula, except in how they treat clipping.
ONE_EXPOSURE = ("defocus", "chapter", "chapter-dim")
CASES = [
    (name, rule)
    for name in SCENES
    for rule in (("single", "censored-ml") if name in ONE_EXPOSURE else decode.rules())
]
# So small, the scenes have up to 13 % of clipped pixels at the exposure that measures most of them; by default 1 % may be.
RULES: dict[str, FusionRule] = {"auto-exposure": AutoExposureRule(clipped_fraction=0.2)}
REPEATS = 48
STATED = 0.01
SIGMAS = (1, 2, 3)
# Thirds of the pixels by sigma: a sigma that is right on average may be wrong in dim pixels.
PARTS = 3


@dataclass(frozen=True)
class Repeated:
    """A scene exposed again and again."""

    stacks: list[Stack]
    phase_rad: Floats
    height_mm: Floats
    period_px: float


@cache
def repeated(name: str) -> Repeated:
    scene = scenes.load(name, {"camera.resolution": [80, 60]})
    transport = render.trace(scene, seed=chance.seeds(1, "light", name)[0], samples=16)
    assert isinstance(scene.patterns, PhaseShift)
    period = min(scene.patterns.periods_px)
    seen = render.through_lens(transport).frames()
    light = FringeLight.of(seen, scene.patterns.frames(), "column", period)
    endless = {"bits": 0} | ({"full_well_e": 1e15} if scene.sensor.kind == "emva1288" else {})
    sensor = scene.sensor.model_copy(update=endless)
    ideal = render.expose(transport, sensor=sensor, exposures=[100.0], noise=False)
    return Repeated(
        [render.expose(transport, seed=s) for s in chance.seeds(REPEATS, "exposures", name)],
        light.phase_rad,
        decode.reconstruct(ideal, fusion="single").height_mm.astype(np.float64),
        period,
    )


def covered(errors: Floats, slack: float) -> tuple[list[float], float]:
    """Shares of errors (in sigma) within 1, 2, 3, and the family p-value that they are those of a normal law."""
    shares, p = [], []
    for k in SIGMAS:
        inside = int((np.abs(errors) < k).sum())
        low, high = (2.0 * stats.norm.cdf(k * (1.0 + s)) - 1.0 for s in (-slack, slack))
        shares.append(inside / errors.size)
        p.append(chance.binomial_p(inside, errors.size, low, high))
    return shares, chance.family(p)


@pytest.mark.parametrize(("name", "rule"), CASES)
def test_predicted_sigma_is_the_scatter(
    name: str, rule: str, record_property: Callable[[str, str], None]
) -> None:
    """A failure points to the sensor's noise model, a fusion rule's error propagation, or a height model's slope."""
    found, fusion = repeated(name), RULES.get(rule, rule)
    phase, sigma, height = [], [], []
    valid = np.ones(found.phase_rad.shape, bool)
    for stack in found.stacks:
        rec = decode.reconstruct(stack, fusion=fusion, **SCENES[name])
        # Linear heights of one px per rad: their sigma is the phase's.
        turn = 2.0 * np.pi / found.period_px
        flat = decode.reconstruct(
            stack,
            fusion=fusion,
            height="linear",
            c_px_per_mm=1.0 / turn,
            height_range_mm=(-1e6, 1e6),
            **SCENES[name],
        )
        # A pixel that noise rejects in some repeats is a biased sample: only pixels that are always valid count.
        valid &= rec.valid
        sigma.append(flat.sigma_mm)
        phase.append(np.angle(np.exp(1j * (rec.wrapped_rad - found.phase_rad))) / flat.sigma_mm)
        height.append((rec.height_mm - found.height_mm) / rec.sigma_mm)
    assert valid.sum() > 500
    z_phase, z_height = (np.array(z, np.float64)[:, valid] for z in (phase, height))
    level = np.array(sigma, np.float64)[:, valid].mean(axis=0)
    slack = STATED + float(np.mean(level**2))
    shares, p = covered(z_phase, slack)
    heights, p_height = covered(z_height, slack)
    record_property(
        "figure",
        f"{valid.sum()} pixels x {REPEATS}, phase {', '.join(f'{s:.4f}' for s in shares)}; "
        f"height {', '.join(f'{s:.4f}' for s in heights)}; RMS {np.sqrt(np.mean(z_phase**2)):.4f} sigma",
    )
    limit = chance.ALPHA / len(CASES)
    assert p > limit
    assert p_height > limit
    for part in np.array_split(np.argsort(level), PARTS):
        assert covered(z_phase[:, part], STATED + float(np.mean(level[part] ** 2)))[1] > limit


def test_sigma_three_per_cent_too_small_is_detected() -> None:
    """Checks that the test detects a planted fault."""
    errors = chance.generator("teeth").standard_normal(1000 * REPEATS)
    assert covered(errors, STATED)[1] > chance.ALPHA
    assert covered(errors * 1.03, STATED)[1] < chance.ALPHA
