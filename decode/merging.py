"""Fusion that adds up the light of every exposure in which no step is saturated."""

from dataclasses import dataclass

from decode.device import Lanes
from decode.fusion import MERGED, FusionRule, Samples
from decode.phase import Phasor, variance_rad2


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
        # the slope is the sensor's gain, the same for every exposure
        variance_rad2=variance_rad2(samples.fringes, cosine, sine, variance, samples.noise[0][1]),
        usable=usable,
        exposure=types.UInt32(MERGED),
    )
    return total, time_ms, longest_ms
