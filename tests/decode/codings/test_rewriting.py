"""Codings against indirect light: each finds the projector column, says how well, and is not misled by smooth indirect light."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import decode
from decode.codings.rewriting import _parity
from scenes.acquisition.patterns import GrayBits, ModulatedPhaseShift, PhaseShift, UnevenSteps
from scenes.acquisition.sensor import Emva, Sensor, SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

WIDTH = 1024
FINE = 16.0
# Beats with 16 px of 1024 and 128 px.
EMBEDDED = (FINE, 1.0 / (1.0 / FINE - 1.0 / 1024.0), 1.0 / (1.0 / FINE - 1.0 / 128.0))
CODINGS: dict[str, Any] = {
    "micro": UnevenSteps(periods_px=(14.57, 16.09, 16.24, 16.47, 16.6), steps=(3, 1, 1, 1, 1)),
    "embedded": UnevenSteps(periods_px=EMBEDDED, steps=(3, 2, 2)),
    "modulated": ModulatedPhaseShift(periods_px=(128.0, 1024.0), carrier_px=FINE),
    "xor": PhaseShift(periods_px=(FINE,), gray=GrayBits(bits=8, cell_px=4.0, xor=True)),
}
# 10 DN of noise on a modulation of 400 DN, constant or the light's own.
SENSORS: dict[str, Sensor] = {
    "constant": SimpleSensor(sigma_dn=10.0, bits=12),
    "shot": Emva(gain_dn_per_e=0.2, read_noise_e=2.0, black_level_dn=64.0, full_well_e=18000.0),
}


def columns(rows: int = 40) -> NDArray[np.float64]:
    return np.random.default_rng(1).uniform(30.0, WIDTH - 30.0, (rows, 50))


def taken(
    patterns: Any,
    u: NDArray[np.float64],
    sensor: Sensor,
    seed: int | None = 0,
    indirect_px: float = 0.0,
    scale: float = 800.0,
) -> Stack:
    """Frames of light 100 + `scale` x pattern(u), and as much indirect light of a Gaussian around another column."""
    rng = np.random.default_rng(seed)
    frames = []
    spread = np.linspace(-2.5, 2.5, 101) * indirect_px
    weight = np.exp(-0.5 * (spread / max(indirect_px, 1e-9)) ** 2)
    for f in patterns.frames():
        light = patterns.commanded(f, u)
        if indirect_px:
            around = patterns.commanded(f, WIDTH - u[..., None] + spread)
            light = light + (around @ weight) / weight.sum()
        dn = 100.0 + scale * light
        noise = np.sqrt(sensor.variance_dn2(dn, 1.0)) * rng.standard_normal(u.shape)
        frames.append(dn + (0.0 if seed is None else noise))
    top = sensor.full_scale_dn
    counts = np.clip(np.rint(frames), 0, top).astype(np.uint16)
    return Stack(counts[None], patterns.frames(), (1.0,), sensor, projector_resolution=(WIDTH, 768))


def off(stack: Stack, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], decode.Reconstruction]:
    rec = decode.reconstruct(stack, height="phase")
    assert rec.column_px is not None
    return np.where(rec.valid, rec.column_px - u, np.nan), rec


@pytest.mark.parametrize("name", CODINGS)
def test_coding_finds_the_column_without_noise(name: str) -> None:
    """Whole digital numbers of 400 DN modulation leave 0.29 DN of rounding: 1e-3 rad, and 5 of them 0.013 px."""
    error, rec = off(taken(CODINGS[name], columns(), SENSORS["constant"], None), columns())
    assert rec.valid.mean() > 0.99
    assert np.nanmax(np.abs(error)) < 0.02


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("name", CODINGS)
def test_predicted_sigma_of_a_coding_is_its_scatter(name: str, sensor: str) -> None:
    u = columns(80)
    linear = {"c_px_per_mm": 1.0, "height_range_mm": (-1e4, 1e4)}
    stack = taken(CODINGS[name], u, SENSORS[sensor])
    rec = decode.reconstruct(stack, anchor=None, height="linear", **linear)  # type: ignore[arg-type]
    assert rec.column_px is not None
    error = np.where(rec.valid, rec.column_px - u, np.nan)
    # A wrong order is no noise.
    good = np.abs(error) < 4.0
    assert good.sum() > 0.98 * rec.valid.sum() > 0.9 * u.size
    ratio = np.sqrt(np.mean((error[good] / rec.sigma_mm[good]) ** 2))
    # Its own scatter over some 4000 pixels: sqrt(1 / 8000) = 1.1 %.
    assert abs(ratio - 1.0) < 0.05


def test_smooth_indirect_light_misleads_coarse_fringes_alone() -> None:
    """Indirect light spread over 40 px has no 16-px fringe left, and all of a 1024-px fringe."""
    plain = PhaseShift(periods_px=(FINE, 128.0, 1024.0))
    u, sensor = columns(), SENSORS["constant"]
    shares = {}
    for name, patterns in {"plain": plain, **CODINGS}.items():
        error, _ = off(taken(patterns, u, sensor, 0, indirect_px=40.0), u)
        shares[name] = np.mean(np.abs(error) < 1.0)
    assert shares.pop("plain") < 0.7
    assert min(shares.values()) > 0.97, shares


@pytest.mark.parametrize("name", ["micro", "embedded", "modulated"])
def test_saturated_sample_of_a_coding_rejects_its_pixel(name: str) -> None:
    stack = taken(CODINGS[name], columns(), SENSORS["constant"], None, scale=4200.0)
    clipped = (stack.frames[0] >= stack.saturation_dn).any(axis=0)
    assert 0.1 < clipped.mean() < 0.9
    rec = decode.reconstruct(stack, height="phase")
    assert (rec.reason[clipped] == decode.Reason.SATURATED).all()
    assert rec.valid[~clipped].all()


def test_xor_code_without_its_last_bit_is_refused() -> None:
    stack = taken(CODINGS["xor"], columns(), SENSORS["constant"], None)
    short = Stack(
        stack.frames[:, :-2],
        stack.patterns[:-2],
        (1.0,),
        stack.sensor,
        projector_resolution=(WIDTH, 768),
    )
    with pytest.raises(DecodeError, match="last bit"):
        decode.reconstruct(short, height="phase")


def test_parity_of_a_code_has_its_brightness_and_follows_from_its_cells() -> None:
    """Two such frames make a second code the last bit of the first; Gray codes of neighbours differ in one bit."""
    u, cell_px = columns(), 32.0
    gray = PhaseShift(periods_px=(64.0,), gray=GrayBits(bits=5, cell_px=cell_px))
    stack = taken(gray, u, SENSORS["constant"], None)
    code = [i for i, f in enumerate(stack.patterns) if f.kind == "gray"]
    odd, even = (frame.astype(np.float64) for frame in _parity(stack, code))
    samples = stack.frames[:, code].astype(np.float64)
    low, high = samples.min(axis=1), samples.max(axis=1)
    # Rounded to whole digital numbers.
    np.testing.assert_allclose(odd + even, low + high, atol=1.0)
    assert (np.minimum(odd, even) >= low - 0.5).all() and (
        np.maximum(odd, even) <= high + 0.5
    ).all()
    np.testing.assert_array_equal(odd > even, [np.floor(u / cell_px) % 2 == 1])


def test_search_needs_the_projectors_size() -> None:
    stack = taken(CODINGS["micro"], columns(), SENSORS["constant"])
    blind = Stack(stack.frames, stack.patterns, (1.0,), stack.sensor)
    with pytest.raises(DecodeError, match="projector_resolution"):
        decode.reconstruct(blind, height="phase")
