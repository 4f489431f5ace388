"""EMVA 1288's measurements of a camera, made on the simulated one: what they give back is what was put in.

Everything goes through `render.expose` of a traced flat scene, as a user's pictures do; no formula of the sensor is used
but the standard's own (release 4.0, linear: sections 6.5 to 6.7, 7 and 8).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
from scenes import Scene
from scenes.acquisition.sensor import Emva, SimpleSensor
from scenes.scene import Exposures
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
    chip_seed: int | None = None,
) -> Floats:
    """White frames (time, row, col)."""
    exposures = Exposures(times_ms=tuple(times_ms))
    stack = render.expose(flat, seed=seed, sensor=sensor, exposures=exposures, chip_seed=chip_seed)
    return stack.frames[:, WHITE].astype(np.float64)


def full_ms(flat: render.Transport, sensor: Emva) -> float:
    """Time that fills the well, found as one would: by the ratio of signal to time in a short exposure."""
    dark, half = (shots(flat, sensor, [t], 1).mean() for t in (1e-6, 1e-2))
    return float(1e-2 * sensor.full_well_e * sensor.gain_dn_per_e / (half - dark))


@pytest.mark.parametrize("name", SENSORS)
def test_photon_transfer_recovers_gain_read_noise_and_full_well(
    name: str, flat: render.Transport, record_property: Figure
) -> None:
    """A failure points to shot noise, read noise, gain, quantisation, or the full well. Each within 1 %."""
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
    # The largest variance is below the end of the well by at most shot noise's few per cent and one step of 2.4 %.
    assert 0.9 < signal[top] / gain / sensor.full_well_e < 1.01


@pytest.mark.parametrize("name", SENSORS)
def test_response_is_linear(name: str, flat: render.Transport, record_property: Figure) -> None:
    """A failure points to anything that bends the curve between 5 and 90 % of saturation (section 6.7), or its offset."""
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


def test_dsnu_and_prnu_are_recovered(flat: render.Transport, record_property: Figure) -> None:
    """A failure points to PRNU or DSNU, or noise that is mistaken for them (section 8): each within 1 %, temporal noise subtracted."""
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


def test_dark_signal_grows_with_time_at_the_dark_current(
    flat: render.Transport, record_property: Figure
) -> None:
    """A failure points to the dark current, as mean or as variance (section 7): each within 1 %. The black frame, minutes long."""
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
def test_simple_sensor_is_linear_with_its_noise(
    sigma_dn: float, flat: render.Transport, record_property: Figure
) -> None:
    """A failure points to the simple sensor's responsivity, sigma, rounding or clipping."""
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


def test_row_and_column_offsets_are_recovered(
    flat: render.Transport, record_property: Figure
) -> None:
    """A failure points to DSNU of rows or columns, or to their noise: variances split as release 4.0 does (section 8).

    Row means scatter by the rows' own variance and a 1 / columns of the rest. Fixed offsets are in the mean of many frames,
    those of one frame in its difference to the mean.
    """
    sensor = Emva(
        bits=0,
        dsnu_e=2.0,
        dsnu_row_e=6.0,
        dsnu_column_e=4.0,
        row_noise_e=3.0,
        column_noise_e=5.0,
        dark_current_e_per_s=0.0,
    )
    chip, *seeds = chance.seeds(DARK + 1, "lines")
    dark = np.stack([shots(flat, sensor, [1e-6], s, chip_seed=chip)[0] for s in seeds])
    dark /= sensor.gain_dn_per_e
    mean = dark.mean(axis=0)
    found = {}
    for name, axis, fixed, drawn in (("row", 1, 6.0, 3.0), ("column", 0, 4.0, 5.0)):
        rest = np.hypot(sensor.read_noise_e, sensor.dsnu_e) / np.sqrt(mean.shape[axis])
        lines = mean.mean(axis=axis).std(ddof=1)
        found[f"fixed {name}"] = (
            lines,
            np.sqrt(fixed**2 + drawn**2 / DARK + rest**2),
            mean.shape[1 - axis],
        )
        single = (dark - mean).mean(axis=axis + 1 if axis else 1)
        scatter = np.sqrt((single**2).sum() / ((DARK - 1) * single.shape[1]))
        noise = sensor.read_noise_e / np.sqrt(mean.shape[axis])
        found[f"drawn {name}"] = scatter, np.hypot(drawn, noise), (DARK - 1) * single.shape[1]
    record_property("figure", ", ".join(f"{k} {a / b - 1:+.2%}" for k, (a, b, _) in found.items()))
    z = [(a / b - 1.0) * np.sqrt(2.0 * n) for a, b, n in found.values()]
    # Read noise and DSNU of single pixels leave a thousandth of a line's variance, which these bounds contain.
    assert chance.family(chance.two_sided(z)) > chance.ALPHA


def test_nonlinear_response_is_recovered(flat: render.Transport, record_property: Figure) -> None:
    """A failure points to the curve, or to its place among the stages (section 6.7)."""
    sensor = Emva(bits=0, nonlinearity=(-0.04, 0.015), full_well_e=1e4)
    full = full_ms(flat, sensor)
    share = np.linspace(0.05, 0.95, 12)
    seed = chance.seeds(1, "curve")[0]
    frames = shots(flat, sensor, list(full * share), seed)
    error = frames.std(axis=(1, 2)) / np.sqrt(PIXELS)
    read = (frames.mean(axis=(1, 2)) - sensor.black_level_dn) / sensor.gain_dn_per_e
    # `full_ms` takes the slope of dim light, which the curve leaves alone.
    x = share
    expected = sensor.full_well_e * x * (1.0 - 0.04 * x + 0.015 * x**2)
    z = (read - expected) * sensor.gain_dn_per_e / error
    off = float(np.abs(read / expected - 1.0).max())
    record_property("figure", f"largest deviation {off:.1e}, {np.abs(z).max():.1f} standard errors")
    # The slope of dim light is itself measured, to a thousandth.
    assert off < 2e-3


def test_hot_and_dead_pixels_are_counted(flat: render.Transport, record_property: Figure) -> None:
    """A failure points to the defects' shares, or to the exponential law of the hot pixels' current."""
    share, current, dead = 0.01, 400.0, 0.002
    sensor = Emva(bits=0, hot_pixels=share, hot_current_e_per_s=current, dead_pixels=dead)
    seed, chip = chance.seeds(2, "defects")
    seconds = 10.0
    dark = render.expose(flat, seed, sensor, [1e3 * seconds], chip_seed=chip).frames[0, BLACK]
    above_e = (dark - sensor.mean_dn(0.0, 1e3 * seconds)) / sensor.gain_dn_per_e
    # 60 electrons are 15 standard deviations of read noise and dark current.
    limits_e = np.array([60.0, 2000.0, 8000.0])
    hot = np.array([(above_e > limit).sum() for limit in limits_e])
    expected = PIXELS * share * np.exp(-limits_e / (current * seconds))
    lit = shots(flat, sensor, [0.3 * full_ms(flat, sensor)], seed, chip)[0]
    none = int((lit - sensor.black_level_dn < 60.0 * sensor.gain_dn_per_e).sum())
    counts, means = np.append(hot, none), np.append(expected, PIXELS * dead)
    z = (counts - means) / np.sqrt(means)
    record_property("figure", f"counts off by {', '.join(f'{c / m - 1:+.1%}' for c, m in zip(counts, means, strict=True))}")  # fmt: skip
    assert chance.family(chance.two_sided(z)) > chance.ALPHA


@pytest.mark.parametrize(("bits", "clip"), [(8, 235.0), (12, 4080.0), (16, 65520.0)])
def test_flooded_pixels_read_the_level_at_which_the_converter_clips(
    bits: int, clip: float, flat: render.Transport
) -> None:
    """A failure points to the saturation level below full scale; light below it is not changed."""
    how = {"bits": bits, "full_well_e": 1e6, "gain_dn_per_e": clip / 2e4, "black_level_dn": 8.0}
    whole, clipped = Emva(**how), Emva(**how, clip_dn=clip)
    full = full_ms(flat, whole.model_copy(update={"bits": 0})) * 2e4 / 1e6
    dim, bright = (shots(flat, clipped, [share * full], 7)[0] for share in (0.8, 3.0))
    assert (bright == clip).all()
    assert (shots(flat, whole, [3.0 * full], 7)[0] == 2.0**bits - 1.0).all()
    assert np.array_equal(dim, shots(flat, whole, [0.8 * full], 7)[0])


def test_vignetting_dims_the_image_as_its_polynomial(flat: render.Transport) -> None:
    """A failure points to the camera's relative illumination: even paint shows it pixel by pixel."""
    camera = flat.scene.camera.model_copy(update={"vignetting": (-0.3, 0.05)})
    scene = flat.scene.model_copy(update={"camera": camera})
    seen = render.expose(
        replace(flat, scene=scene), sensor=SimpleSensor(bits=0), exposures=[1.0], noise=False
    ).frames[0, WHITE]
    row, column = np.mgrid[0:ROWS, 0:COLUMNS] + 0.5
    r2 = ((column - COLUMNS / 2) ** 2 + (row - ROWS / 2) ** 2) / ((COLUMNS**2 + ROWS**2) / 4)
    expected = flat.frames()[WHITE] * (1.0 - 0.3 * r2 + 0.05 * r2**2)
    np.testing.assert_allclose(seen, expected, rtol=2 * chance.ROUNDING)
