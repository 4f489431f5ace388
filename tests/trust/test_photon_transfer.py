"""EMVA 1288's measurements of a camera, made on the simulated one: what they give back is what was put in.

Everything goes through `render.expose` of a traced flat scene, as a user's pictures do; no formula of the sensor is used
but the standard's own (release 4.0, linear: sections 6.5 to 6.7, 7 and 8).
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
from scenes import Scene
from scenes.scene import Exposures
from scenes.sensor import Emva, SimpleSensor
from tests.render import rigs
from tests.trust import chance

pytestmark = pytest.mark.trust

Floats = NDArray[np.float64]
Figure = Callable[[str, str], None]
# 1 / sqrt(2 n) of a variance's square root: 0.2 % for one frame, so that a twentieth of a per cent is left for 24 levels.
COLUMNS, ROWS = 480, 320
PIXELS = COLUMNS * ROWS
WHITE, BLACK = 1, 2
DARK = 16
SENSORS = {
    "default": Emva(),
    "8 bits": Emva(bits=8, gain_dn_per_e=0.02, read_noise_e=35.0, black_level_dn=8.0),
    "scientific": Emva(
        bits=16, gain_dn_per_e=2.0, read_noise_e=1.5, full_well_e=30000.0, black_level_dn=100.0
    ),
    "10 bits": Emva(
        bits=10, gain_dn_per_e=0.09, read_noise_e=8.0, full_well_e=9000.0, black_level_dn=40.0
    ),
}


@pytest.fixture(scope="module")
def flat() -> render.Transport:
    """Paint lit by parallel light, seen by parallel rays: the same radiance in every pixel. Frames: a bit, white, black."""
    scene = rigs.scene(
        rigs.telecentric((COLUMNS, ROWS)),
        rigs.telecentric_projector(),
        objects=rigs.plane(),
        depth=1,
    )
    code = {"kind": "gray-code", "bits": (1,), "cell_px": 64.0, "inverted": False, "flat": True}
    scene = Scene.model_validate(scene.model_dump(mode="json") | {"patterns": code})
    transport = render.trace(scene, samples=4)
    white = transport.frames()[WHITE].astype(np.float64)
    # Pixels differ by float32 rounding alone; a photon's worth of it would pass for noise.
    assert np.ptp(white) < 1e-5 * white.mean()
    return transport


def shots(
    flat: render.Transport,
    sensor: Emva | SimpleSensor,
    times_ms: list[float],
    seed: int,
    **how: int,
) -> Floats:
    """White frames (time, row, col)."""
    exposures = Exposures(times_ms=tuple(times_ms))
    stack = render.expose(flat, seed=seed, sensor=sensor, exposures=exposures, **how)
    return stack.frames[:, WHITE].astype(np.float64)


def full_ms(flat: render.Transport, sensor: Emva) -> float:
    """Time that fills the well, found as one would: by the ratio of signal to time in a short exposure."""
    dark, half = (shots(flat, sensor, [t], 1).mean() for t in (1e-6, 1e-2))
    return float(1e-2 * sensor.full_well_e * sensor.gain_dn_per_e / (half - dark))


@pytest.mark.parametrize("name", SENSORS)
def test_photon_transfer_does_not_give_back_gain_read_noise_and_full_well(
    name: str, flat: render.Transport, record_property: Figure
) -> None:
    """Wrong: shot noise, read noise, gain, quantisation, or where the well ends. Each within 1 %."""
    sensor = SENSORS[name]
    full = full_ms(flat, sensor)
    rng = chance.generator("photon transfer", name)
    seed_a, seed_b = (int(s) for s in rng.integers(0, 2**31, 2))
    times = list(full * np.linspace(0.02, 1.15, 48))
    a, b = shots(flat, sensor, times, seed_a), shots(flat, sensor, times, seed_b)
    # Many dark frames: all other variances are counted from theirs.
    dark = np.stack([shots(flat, sensor, [1e-6], int(s))[0] for s in rng.integers(0, 2**31, DARK)])
    dark_mean, dark_variance = dark.mean(), dark.var(axis=0, ddof=1).mean()
    signal = (a.mean(axis=(1, 2)) + b.mean(axis=(1, 2))) / 2 - dark_mean
    variance = np.var(a - b, axis=(1, 2)) / 2

    # Saturation is where the variance is largest (section 6.6); gain from 0 to 70 % of it (section 6.5).
    top = int(np.argmax(variance))
    low = signal < 0.7 * signal[top]
    weight = 1.0 / variance[low] ** 2
    excess = variance[low] - dark_variance
    gain = float((weight * signal[low] * excess).sum() / (weight * signal[low] ** 2).sum())
    # Rounding is 1/12 DN^2 of the dark variance (eq. 8).
    read = float(np.sqrt(dark_variance - 1.0 / 12.0) / gain)
    flood = shots(flat, sensor, [3.0 * full], seed_a)[0]
    well = float((flood.mean() - dark_mean) / gain)
    record_property(
        "figure",
        f"gain {gain / sensor.gain_dn_per_e - 1:+.2%}, read noise {read / sensor.read_noise_e - 1:+.2%}, "
        f"full well {well / sensor.full_well_e - 1:+.2%}, variance ends at {signal[top] / gain / sensor.full_well_e:.3f} wells",
    )
    assert gain == pytest.approx(sensor.gain_dn_per_e, rel=0.01)
    assert read == pytest.approx(sensor.read_noise_e, rel=0.01)
    assert well == pytest.approx(sensor.full_well_e, rel=0.01)
    # The largest variance lies within shot noise's few per cent, and one step of 2.4 %, below the end of the well.
    assert 0.9 < signal[top] / gain / sensor.full_well_e < 1.01


@pytest.mark.parametrize("name", SENSORS)
def test_response_is_not_linear(name: str, flat: render.Transport, record_property: Figure) -> None:
    """Wrong: anything that bends the curve between 5 and 90 % of saturation (section 6.7), or its offset."""
    sensor = SENSORS[name]
    full = full_ms(flat, sensor)
    times = full * np.linspace(0.05, 0.9, 20)
    frames = shots(flat, sensor, list(times), int(chance.generator("linear", name).integers(2**31)))
    mean, error = frames.mean(axis=(1, 2)), frames.std(axis=(1, 2)) / np.sqrt(PIXELS)
    weight = 1.0 / error
    line = np.polyfit(times, mean, 1, w=weight)
    rest = mean - np.polyval(line, times)
    worst = float(np.max(np.abs(rest) / (mean - sensor.black_level_dn)))
    chi2 = float(((rest / error) ** 2).sum())
    record_property("figure", f"linearity error {worst:.1e}, chi-square {chi2:.1f} of 18")
    # Read noise of 0.7 DN and more leaves e^(-2 pi^2 0.49) = 6e-5 DN of rounding's staircase, below the means' errors.
    assert stats.chi2.sf(chi2, 18) > chance.ALPHA / len(SENSORS)
    assert abs(line[1] - sensor.black_level_dn) < 5.0 * error[0] + 1e-4


def test_unlike_pixels_are_not_as_unlike_as_said(
    flat: render.Transport, record_property: Figure
) -> None:
    """Wrong: PRNU or DSNU, or noise that is taken for them (section 8): each within 1 %, temporal noise taken off."""
    sensor = Emva(bits=16, gain_dn_per_e=2.0, full_well_e=30000.0, prnu=0.012, dsnu_e=6.0)
    half = 0.5 * full_ms(flat, sensor)
    rng = chance.generator("unlike")
    count = 24
    levels = {}
    for what, time in (("dark", 1e-6), ("half", half)):
        frames = np.stack(
            [
                shots(flat, sensor, [time], int(rng.integers(2**31)), chip_seed=5)[0]
                for _ in range(count)
            ]
        )
        temporal = frames.var(axis=0, ddof=1).mean()
        levels[what] = frames.mean(), frames.mean(axis=0).var() - temporal / count
    (dark, dark_var), (bright, bright_var) = levels["dark"], levels["half"]
    dsnu = float(np.sqrt(dark_var) / sensor.gain_dn_per_e)
    prnu = float(np.sqrt(bright_var - dark_var) / (bright - dark))
    record_property(
        "figure", f"DSNU {dsnu / sensor.dsnu_e - 1:+.2%}, PRNU {prnu / sensor.prnu - 1:+.2%}"
    )
    assert dsnu == pytest.approx(sensor.dsnu_e, rel=0.01)
    assert prnu == pytest.approx(sensor.prnu, rel=0.01)


def test_dark_current_does_not_grow_with_time(
    flat: render.Transport, record_property: Figure
) -> None:
    """Wrong: the dark current, as mean or as variance (section 7): each within 1 %. The black frame, minutes long."""
    sensor = Emva(bits=16, gain_dn_per_e=1.0, dark_current_e_per_s=50.0, read_noise_e=2.0)
    times_ms = np.array([1.0, 30e3, 60e3, 120e3])
    rng = chance.generator("dark current")
    a, b = (
        render.expose(flat, seed=int(rng.integers(2**31)), sensor=sensor, exposures=list(times_ms))
        .frames[:, BLACK]
        .astype(np.float64)
        for _ in range(2)
    )
    mean = (a.mean(axis=(1, 2)) + b.mean(axis=(1, 2))) / 2
    variance = np.var(a - b, axis=(1, 2)) / 2
    by_mean = np.polyfit(times_ms / 1e3, mean, 1)[0]
    by_variance = np.polyfit(times_ms / 1e3, variance, 1, w=1 / variance)[0]
    record_property(
        "figure",
        f"by the mean {by_mean / 50 - 1:+.2%}, by the variance {by_variance / 50 - 1:+.2%}",
    )
    assert by_mean == pytest.approx(50.0, rel=0.01)
    assert by_variance == pytest.approx(50.0, rel=0.01)


@pytest.mark.parametrize("sigma_dn", [0.8, 3.0, 12.0])
def test_the_simple_sensor_is_not_a_line_with_noise(
    sigma_dn: float, flat: render.Transport, record_property: Figure
) -> None:
    """Wrong: its responsivity, its sigma, its rounding, or where it clips."""
    sensor = SimpleSensor(sigma_dn=sigma_dn, black_level_dn=60.0)
    radiance = float(flat.frames()[WHITE].mean(dtype=np.float64))
    times = np.linspace(5.0, 130.0, 12) / radiance
    seed_a, seed_b = chance.seeds(2, "simple", sigma_dn)
    a, b = shots(flat, sensor, list(times), seed_a), shots(flat, sensor, list(times), seed_b)
    mean, variance = (a + b).mean(axis=(1, 2)) / 2, np.var(a - b, axis=(1, 2)) / 2
    error = np.sqrt(variance / (2 * PIXELS))
    z = (mean - 60.0 - radiance * times) / error
    # Sheppard: rounding adds 1/12 DN^2 while the noise spans its steps.
    expected = sigma_dn**2 + 1.0 / 12.0
    z_variance = (variance / expected - 1.0) / np.sqrt(2.0 / PIXELS)
    record_property(
        "figure",
        f"largest of 12 means {np.abs(z).max():.1f}, of 12 variances {np.abs(z_variance).max():.1f} standard errors",
    )
    assert chance.family(chance.two_sided(np.concatenate([z, z_variance]))) > chance.ALPHA / 3
    assert (shots(flat, sensor, [400.0 / radiance], seed_a) == 255.0).all()
