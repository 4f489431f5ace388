"""Fusion that adds up the light of every exposure in which no step is saturated, or phases of sets of steps."""

from dataclasses import dataclass, replace

from decode.device import Lanes
from decode.fusion.interface import MERGED, FusionRule, Samples, stronger
from decode.phase.n_step import Phasor, variance_rad2
from scenes.support.errors import DecodeError


@dataclass(frozen=True)
class PhasorSum(FusionRule):
    """``phi = arg sum_k m_k Z_k``: the phasors of the unsaturated exposures, added.

    Equal to the phase of the frames averaged. Weights of one suit noise that is the light's own (shot noise grows with
    exposure as the phasor does); read noise of short exposures counts too much.
    ``sigma_phi^2 = (2/N) sum_k m_k sigma_k^2 / |sum_k m_k B_k|^2``. Phasor and offset come in DN of all merged exposures
    together.
    """

    def fuse(self, samples: Samples) -> Phasor:
        """The sum over the usable exposures; the shortest exposure alone where all are saturated."""
        return _summed(samples)[0]


@dataclass(frozen=True)
class RadianceMerge(FusionRule):
    """``E_n = sum_k m_k (I_nk - d) / sum_k m_k t_k``, then the N-step phase of the ``E_n`` (Debevec & Malik 1997;
    Robertson et al. 2003).

    The mask ``m_k`` is common to all steps, else the noise would depend on the step. It divides all steps by one number,
    so this is the phase of `PhasorSum` exactly; only the scale differs: DN of the longest exposure merged.
    """

    def fuse(self, samples: Samples) -> Phasor:
        """The merged radiance's phasor; the shortest exposure alone where all are saturated."""
        total, time_ms, longest_ms = _summed(samples)
        scale = longest_ms / time_ms
        black = samples.black_level_dn
        return Phasor(
            cosine=total.cosine * scale,
            sine=total.sine * scale,
            offset=(total.offset - black) * scale + black,
            variance_rad2=total.variance_rad2,
            usable=total.usable,
            exposure=total.exposure,
        )


@dataclass(frozen=True)
class MeanOfSets(FusionRule):
    """The mean of two phases: of the first half of the steps, and of the second (Wan et al. 2023).

    The second set is shifted by pi / N, so the ripple of N periods that clipping leaves in its phase has the opposite sign.
    For angles less than half a turn apart, the mean is the direction of the sum of the two unit phasors.
    """

    def fuse(self, samples: Samples) -> Phasor:
        """Each half's `PhasorSum`, then their mean; in DN of both sets."""
        dr = samples.device.dr
        fringes, half = samples.fringes, len(samples.fringes.frames) // 2
        if half < 3 or 2 * half != len(fringes.frames):
            raise DecodeError(
                f"the mean of two sets needs an even number of steps, 6 or more: the {fringes.axis} fringes of "
                f"{fringes.period_px:g} px have {len(fringes.frames)}"
            )
        one, two = (
            PhasorSum().fuse(
                replace(
                    samples,
                    fringes=replace(
                        fringes, frames=fringes.frames[part], shifts_rad=fringes.shifts_rad[part]
                    ),
                    dn=tuple(steps[part] for steps in samples.dn),
                )
            )
            for part in (slice(half), slice(half, None))
        )
        lengths = [dr.rsqrt(p.cosine * p.cosine + p.sine * p.sine) for p in (one, two)]
        cosine = one.cosine * lengths[0] + two.cosine * lengths[1]
        sine = one.sine * lengths[0] + two.sine * lengths[1]
        both = (dr.rcp(lengths[0]) + dr.rcp(lengths[1])) * 0.5
        scale = both * dr.rsqrt(cosine * cosine + sine * sine)
        return Phasor(
            cosine=cosine * scale,
            sine=sine * scale,
            offset=(one.offset + two.offset) * 0.5,
            variance_rad2=(one.variance_rad2 + two.variance_rad2) * 0.25,
            usable=one.usable & two.usable,
            exposure=one.exposure,
        )


@dataclass(frozen=True)
class MaxModulationOfRepeats(FusionRule):
    """`MaxModulation` of exposure times: pictures of one time are added first, as `PhasorSum` does."""

    def fuse(self, samples: Samples) -> Phasor:
        """Among the times with an unsaturated picture, the one with the largest modulation."""
        return samples.best(
            (_of_time(samples, time_ms) for time_ms in sorted(set(samples.exposure_ms))), stronger
        )


def _of_time(samples: Samples, time_ms: float) -> Phasor:
    """`PhasorSum` of the pictures of one exposure time."""
    same = [k for k, other in enumerate(samples.exposure_ms) if other == time_ms]
    return PhasorSum().fuse(
        replace(
            samples,
            dn=tuple(samples.dn[k] for k in same),
            exposure_ms=(time_ms,) * len(same),
            noise=tuple(samples.noise[k] for k in same),
        )
    )


def _summed(samples: Samples) -> tuple[Phasor, Lanes, Lanes]:
    """Sum of the usable exposures' phasors, their times' sum, and the longest of them in ms."""
    dr, types = samples.device.dr, samples.device.types
    masks = [samples.unsaturated(k) for k in range(len(samples.exposure_ms))]
    usable = masks[0]
    for mask in masks[1:]:
        usable = usable | mask
    shortest = samples.by_time[0]
    masks[shortest] = masks[shortest] | ~usable
    cosine = sine = level = variance = time_ms = longest_ms = types.Float(0.0)
    for k, mask in enumerate(masks):
        phasor = samples.phasor(k)
        above = phasor.offset - samples.black_level_dn
        cosine = cosine + dr.select(mask, phasor.cosine, 0.0)
        sine = sine + dr.select(mask, phasor.sine, 0.0)
        level = level + dr.select(mask, above, 0.0)
        variance = variance + dr.select(mask, samples.variance_dn2(k, phasor.offset), 0.0)
        time_ms = time_ms + dr.select(mask, samples.exposure_ms[k], 0.0)
        longest_ms = dr.maximum(longest_ms, dr.select(mask, samples.exposure_ms[k], 0.0))
    total = Phasor(
        cosine=cosine,
        sine=sine,
        offset=level + samples.black_level_dn,
        # The slope is the sensor's gain, the same for every exposure.
        variance_rad2=variance_rad2(samples.fringes, cosine, sine, variance, samples.noise[0][1]),
        usable=usable,
        exposure=types.UInt32(MERGED),
    )
    return total, time_ms, longest_ms
