"""Phase error of clipped fringes over all phases: the effect of saturation on a decoder, exactly.

A fringe ``I = A + B cos(phi + 2 pi k / N)`` of contrast ``c = B / A`` whose peak ``A + B`` is `ratio` times saturation is
clipped there. The clipped wave is even, with Fourier coefficients c_m; N samples fold those with ``m = 1 mod N`` onto the
fringe, so the least-squares phase errs by ``arg(1 + sum_q (c_(1+qN) / c_1) exp(j q N phi))``: a ripple of N periods.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import decode
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError, ScoreError

Floats = NDArray[np.float64]
PhaseDecoder = Callable[[Stack], Any]
"""Gives a `decode.Reconstruction` of the stack; or its wrapped phases in rad (row, col), NaN where rejected; or a pair of
phases and a boolean mask (row, col) of those to trust."""

RATIOS = (1.1, 1.25, 1.5, 2.0)
STEPS = (3, 4, 5, 6, 8, 12)
# Saturation in DN. Samples stay float32, so its size is a unit, not a precision.
SATURATION_DN = 255.0
# Amplitudes fall as 1/m^2 and enter squared: the rest is below 1e-6 of the sum.
HARMONICS = 100
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class SaturationBias:
    """Phase error of a decoder; all tables have axes (ratio, step), `error_rad` (ratio, step, phase).

    Statistics are over the phases that the decoder accepts, NaN where it accepts none.
    """

    ratios: tuple[float, ...]
    """Peak over saturation of the longest exposure."""
    steps: tuple[int, ...]
    contrast: float
    noise: float
    phase_rad: Floats
    """True phases, (phase,)."""
    error_rad: Floats
    """Measured minus true, in [-pi, pi), the mean over repeats."""
    rms_rad: Floats
    """Root mean square error over phases."""
    bias_rad: Floats
    """Mean error over phases; that of a ripple is 0, so look at the RMS."""
    max_rad: Floats
    """Largest absolute error."""
    rejected_fraction: Floats
    """Share of the phases that the decoder does not accept."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON, without the errors of single phases; None where no phase is accepted."""
        tables = ("rms_rad", "bias_rad", "max_rad", "rejected_fraction")
        return {
            "ratios": list(self.ratios),
            "steps": list(self.steps),
            "contrast": self.contrast,
            "noise": self.noise,
            **{
                name: [[None if np.isnan(v) else float(v) for v in row] for row in values]
                for name, values in ((name, getattr(self, name)) for name in tables)
            },
        }


def saturation_bias(
    decoder: str | PhaseDecoder | None = None,
    ratios: Sequence[float] = RATIOS,
    steps: Sequence[int] = STEPS,
    contrast: float = 1.0,
    noise: float = 0.0,
    *,
    relative: Sequence[float] = (1.0,),
    phases: int = 7200,
    repeats: int = 32,
    seed: int = 0,
) -> SaturationBias:
    """Phase error of a decoder on clipped fringes, by peak/saturation ratio and number of steps.

    Parameters
    ----------
    decoder
        None for plain N-step least squares that ignores saturation (in float64); the name of one of decode's fusion rules,
        which reject saturated samples; or a callable, see `PhaseDecoder`.
    ratios
        Peak of the fringe over saturation, for the longest exposure.
    steps
        Numbers of phase steps N, from 3 up.
    contrast
        Modulation over mean, in (0, 1].
    noise
        Standard deviation of a sample over the saturation level.
    relative
        Exposures taken, relative to each other. Rules that merge exposures need several.
    phases
        Number of phases sampled in a period.
    repeats
        Noise draws of every phase, if there is noise.
    seed
        Seed of the noise.

    Returns
    -------
    SaturationBias
        Tables with axes (ratio, step).

    Raises
    ------
    ScoreError
        For impossible parameters or a decoder whose answer has another shape or type.

    Notes
    -----
    More exposure is not always more error: at ``ratio = 1 + contrast`` the fringe is clipped at its mean, and for even N the
    error vanishes exactly, because half a cosine plus half its absolute value remains, which repeats after N/2 steps.

    Examples
    --------
    >>> table = saturation_bias(ratios=[1.5, 2.0], steps=[4])
    >>> table.rms_rad.round(4).tolist()
    [[0.0847], [0.0]]
    """
    _check(ratios, steps, contrast, noise, relative, phases, repeats, seed)
    times = tuple(float(r) / max(relative) for r in relative)
    true: Floats = np.linspace(-np.pi, np.pi, phases, endpoint=False) + np.pi / phases
    rows = repeats if noise else 1
    shape = (len(ratios), len(steps))
    error = np.full((*shape, phases), np.nan)
    tables = {
        name: np.full(shape, np.nan) for name in ("rms_rad", "bias_rad", "max_rad", "rejected")
    }
    for i, ratio in enumerate(ratios):
        for j, count in enumerate(steps):
            samples = clipped_samples(true, float(ratio), count, contrast, times)
            samples = np.repeat(samples[:, :, None, :], rows, axis=2)
            if noise:
                rng = np.random.default_rng([seed, i, j])
                samples = np.minimum(samples + noise * rng.standard_normal(samples.shape), 1.0)
            phase = _plain(samples) if decoder is None else _decoded(decoder, samples, times, noise)
            off = np.where(np.isfinite(phase), (phase - true + np.pi) % TURN - np.pi, np.nan)
            good = off[np.isfinite(off)]
            tables["rejected"][i, j] = 1.0 - good.size / off.size
            if good.size:
                seen = np.isfinite(off).any(axis=0)
                error[i, j, seen] = np.nanmean(off[:, seen], axis=0)
                tables["rms_rad"][i, j] = np.sqrt(np.mean(good**2))
                tables["bias_rad"][i, j] = good.mean()
                tables["max_rad"][i, j] = np.abs(good).max()
    return SaturationBias(
        tuple(float(r) for r in ratios),
        tuple(steps),
        contrast,
        noise,
        true,
        error,
        tables["rms_rad"],
        tables["bias_rad"],
        tables["max_rad"],
        tables["rejected"],
    )


def clipped_samples(
    phase_rad: Floats, ratio: float, steps: int, contrast: float, relative: Sequence[float] = (1.0,)
) -> Floats:
    """Samples (exposure, step, phase) of clipped fringes in units of saturation, at most 1; `ratio` is the peak at
    relative exposure 1.
    """
    shift = np.arange(steps)[:, None] * (TURN / steps)
    fringe = (1.0 + contrast * np.cos(phase_rad + shift)) * (ratio / (1.0 + contrast))
    clipped: Floats = np.minimum(np.multiply.outer(np.asarray(relative), fringe), 1.0)
    return clipped


def clipped_harmonic(order: int, ratio: float, contrast: float = 1.0) -> float:
    """Fourier coefficient c_m of the clipped fringe ``sum_m c_m exp(j m phi)``, in units of saturation; `ratio`: peak
    over saturation.

    With ``A - 1 = -B cos(a)`` the wave exceeds saturation for ``|phi| < a`` by ``B (cos(phi) - cos(a))``, whose
    integrals against ``cos(m phi)`` are elementary.
    """
    mean = ratio / (1.0 + contrast)
    amplitude = contrast * mean
    ideal = {0: mean, 1: amplitude / 2, -1: amplitude / 2}.get(order, 0.0)
    if ratio <= 1.0:
        return ideal
    edge = float(np.arccos(np.clip((1.0 - mean) / amplitude, -1.0, 1.0)))

    def integral(m: int) -> float:
        """Integral of cos(m phi) from 0 to the edge."""
        return edge if m == 0 else float(np.sin(m * edge)) / m

    excess = (integral(order - 1) + integral(order + 1)) / 2 - np.cos(edge) * integral(order)
    return float(ideal - amplitude * excess / np.pi)


def theory_rms_rad(ratio: float, steps: int, contrast: float = 1.0) -> float:
    """RMS over phase of the N-step phase error in rad, to first order in the folded harmonics.

    ``arg(1 + z) ~ Im z`` leaves ``sum_q (c_(qN+1) - c_(qN-1)) / c_1 sin(q N phi)``, whose mean square is half the sum
    of the squares. Off by no more than z itself, relatively; 0, exactly, at ``ratio = 1 + contrast`` and even N.
    """
    ripple = [
        clipped_harmonic(q * steps + 1, ratio, contrast)
        - clipped_harmonic(q * steps - 1, ratio, contrast)
        for q in range(1, HARMONICS)
    ]
    return float(np.sqrt(np.sum(np.square(ripple)) / 2) / clipped_harmonic(1, ratio, contrast))


def _plain(samples: Floats) -> Floats:
    """Phase (row, phase) of samples (1 or more exposures, step, row, phase): the longest exposure's, clipped or not."""
    longest = samples[np.argmax(samples.sum(axis=(1, 2, 3)))]
    turn = np.exp(-1j * TURN * np.arange(len(longest)) / len(longest))
    phase: Floats = np.angle(np.tensordot(turn, longest, axes=1))
    return phase


def _decoded(
    decoder: str | PhaseDecoder, samples: Floats, times: Sequence[float], noise: float
) -> Floats:
    """Phase (row, phase) by a decoder, NaN where it rejects."""
    patterns = PhaseShift(steps=samples.shape[1], periods_px=(16.0,)).frames()
    sensor = SimpleSensor(bits=8, sigma_dn=noise * SATURATION_DN)
    stack = Stack((samples * SATURATION_DN).astype(np.float32), patterns, tuple(times), sensor)
    if isinstance(decoder, str):
        try:
            # One period has no order to find: the row scan is cheapest, and orders are ignored.
            answer: Any = decode.reconstruct(
                stack, fusion=decoder, height="phase", unwrap="row-scan"
            )
        except DecodeError as error:
            if decoder not in decode.rules():
                raise
            if "no pixel could be decoded" not in str(error):
                raise
            return np.full(samples.shape[2:], np.nan)
    else:
        answer = decoder(stack)
    return _phases(answer, samples.shape[2:])


def _phases(answer: Any, shape: tuple[int, ...]) -> Floats:
    if isinstance(answer, decode.Reconstruction):
        answer = answer.wrapped_rad, answer.valid
    phase, valid = answer if isinstance(answer, tuple) else (answer, None)
    try:
        found = np.array(phase, dtype=np.float64)
        trusted = np.ones(found.shape, np.bool_) if valid is None else np.asarray(valid, np.bool_)
    except (TypeError, ValueError) as error:
        raise ScoreError(
            f"the decoder's answer is no array ({error}): return a Reconstruction, phases in rad, or phases and a mask"
        ) from error
    if found.shape != shape or trusted.shape != shape:
        raise ScoreError(
            f"the decoder's answer has shape {found.shape}, mask {trusted.shape}: expected one phase for each of the "
            f"{shape} pixels of the stack"
        )
    found[~trusted] = np.nan
    return found


def _check(
    ratios: Sequence[float],
    steps: Sequence[int],
    contrast: float,
    noise: float,
    relative: Sequence[float],
    phases: int,
    repeats: int,
    seed: int,
) -> None:
    rules = (
        (len(ratios) > 0 and all(r > 0 for r in ratios), "ratios", ratios, "at least one, above 0"),
        (len(steps) > 0 and all(n >= 3 for n in steps), "steps", steps, "at least one, from 3 up"),
        (0 < contrast <= 1, "contrast", contrast, "above 0, at most 1"),
        (noise >= 0, "noise", noise, "0 or more"),
        (len(relative) > 0 and all(r > 0 for r in relative), "relative", relative, "above 0"),
        (phases >= 8, "phases", phases, "8 or more"),
        (repeats >= 1, "repeats", repeats, "1 or more"),
        (seed >= 0, "seed", seed, "0 or more"),
    )
    for good, name, value, allowed in rules:
        if not good:
            raise ScoreError(f"{name} = {value}: needs {allowed}")
