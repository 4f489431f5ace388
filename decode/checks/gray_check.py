"""Whether Gray code frames show the bits that the patterns state: pairs, order, range."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from decode.order.gray_cells import GraySet
from decode.phase.gamma import CLEAR
from scenes.files.stack import Stack
from scenes.support.finding import Finding

# A frame and its inverse add up to white and black, and the remainder varies little; another bit's inverse varies half as
# much only if the frames are not where the patterns state.
UNPAIRED = 2.0
# As a share of the brightest contrast: less is light that came by way of another surface.
DIRECT = 0.25
# Exchanging two bits of a correct Gray code makes it rougher; noise alone does not make a wrong one smoother by a fifth.
SMOOTHER = 0.8
# Camera pixels between those compared.
GAP = 4
# Share of the pixels in which a bit must be clear to be judged.
CLEARLY = 0.8
OUTSIDE = 0.05
# Part of the contrast by which a code's frame may exceed white, as interreflection of whole frames does not.
BEYOND = 0.25
MOST_LINES = 96


def gray_code(stack: Stack, gray: GraySet, resolution: tuple[int, int] | None) -> Iterator[Finding]:
    """Findings about one axis' Gray code: pairs of frame and inverse, order of bits, and range in the projector's
    (columns, rows).
    """
    name = f"{gray.axis} Gray code"
    look = _GraySamples.at(stack, gray)
    if look.good.mean() < 1e-3:
        yield Finding(name, "wrong", "no pixel shows the code: bright and dark do not differ")
        return
    if look.sums is not None:
        yield _pairs(look.sums, f"{name}, inverses")
    yield _smoothness(look, f"{name}, order")
    if resolution is not None:
        size = resolution[0 if gray.axis == "column" else 1]
        alone = not any(f.kind == "fringe" and f.axis == gray.axis for f in stack.patterns)
        doubt = gray.ambiguity(size) or (
            _cells_in_doubt(gray, size, max(resolution)) if alone else ""
        )
        if doubt:
            yield Finding(f"{name}, uniqueness", "wrong", doubt)
        share = float(
            (
                _codes(look.bits[:, look.good], gray.plain) * gray.cell_px + gray.origin_px >= size
            ).mean()
        )
        yield Finding(
            f"{name}, range",
            "wrong" if share > OUTSIDE else "ok",
            f"{share:.2%} of the codes are beyond the projector's {size} px"
            + (
                ": an exchanged inverse, a wrong number of bits, or another projector"
                if share > OUTSIDE
                else ""
            ),
            share,
        )


def _cells_in_doubt(gray: GraySet, size_px: int, longest_px: int) -> str:
    """Why no projector shows cells of that width, or needs the code's first bit; of a code alone, whose images say neither."""
    cells, width = 2**gray.bits, gray.cell_px
    if not (float(width).is_integer() or np.isclose(cells * width, size_px)):
        return (
            f"cells of {width:g} px are neither a whole number of pixels wide nor {cells} parts of the projector's {size_px} "
            "px: correct cell_px"
        )
    # The same number of bits is often shown along both sides.
    needed = (longest_px - gray.origin_px) / width
    spare = int(np.log2(cells / needed)) if 0.0 < needed < cells else 0
    if not spare:
        return ""
    return (
        f"{gray.bits} bits of cells of {width:g} px number {cells * width:g} px, so the first bit would be dark in all of the "
        f"projector's {longest_px:g} px: set cell_px = {width / 2**spare:g} if narrower cells were shown, or bits = "
        f"{gray.bits - spare} and skip what never changes"
    )


def flats(stack: Stack, gray: GraySet) -> Iterator[Finding]:
    """Whether white is the brightest frame and black the darkest; nothing without both."""
    if gray.white is None or gray.black is None:
        return
    exposure = int(np.argmin(stack.exposure_ms))
    frames = stack.frames[exposure]
    white, black = (frames[k].astype(np.float64) for k in (gray.white, gray.black))
    brighter = float(white.mean() - black.mean())
    if brighter <= 0.0:
        said = f"white is {brighter:.1f} DN brighter than black on average: exchange them"
        yield Finding("white and black", "wrong", said, brighter)
        return
    shown = frames[[k for k in (*gray.direct, *gray.inverse) if k is not None]]
    contrast = white - black
    sigma = np.sqrt(stack.sensor.variance_dn2(white, stack.exposure_ms[exposure]))
    margin = np.maximum(CLEAR * sigma, BEYOND * np.abs(contrast))
    beyond = (shown.max(axis=0) > white + margin) | (shown.min(axis=0) < black - margin)
    share = float(beyond.mean())
    said = f"white is {brighter:.1f} DN brighter than black on average"
    if share > OUTSIDE:
        said += f", but in {share:.0%} of the pixels a frame of the code is brighter than white or darker than black: correct the frames' order"
    yield Finding("white and black", "wrong" if share > OUTSIDE else "ok", said, brighter)


@dataclass(frozen=True)
class _GraySamples:
    """A Gray code on some lines of the image, along its axis."""

    bits: NDArray[np.bool_]
    """(bit, line, pixel), most significant first."""
    clear: NDArray[np.bool_]
    """Where a bit is beyond noise; same axes."""
    good: NDArray[np.bool_]
    """(line, pixel): where bright and dark differ at all."""
    plain: bool
    """Plain binary instead of Gray code."""
    sums: NDArray[np.float64] | None
    """(bit, bit): variance over the good pixels of a frame plus an inverse, in units of each pixel's range; None
    without inverses."""

    @classmethod
    def at(cls, stack: Stack, gray: GraySet) -> "_GraySamples":
        """Evenly spread lines of the longest exposure."""
        frames = stack.frames[int(np.argmax(stack.exposure_ms))]
        frames = frames if gray.axis == "column" else frames.swapaxes(1, 2)
        frames = frames[:, :: max(1, frames.shape[1] // MOST_LINES)].astype(np.float32)
        shown = [k for k in (*gray.direct, *gray.inverse) if k is not None]
        low, high = frames[shown].min(axis=0), frames[shown].max(axis=0)
        threshold = 0.5 * (low + high)
        if gray.white is not None and gray.black is not None:
            threshold = 0.5 * (frames[gray.white] + frames[gray.black])
        signals = []
        for direct, inverse in zip(gray.direct, gray.inverse, strict=True):
            one = threshold if direct is None else frames[direct]
            other = threshold if inverse is None else frames[inverse]
            signals.append(one - other)
        sigma = np.sqrt(stack.sensor.variance_dn2(high, max(stack.exposure_ms)))
        signal, contrast = np.stack(signals), high - low
        # Light that came by way of another surface is weaker, and blurs fine bits until they say nothing.
        direct_light = contrast > DIRECT * np.percentile(contrast, 99.0)
        good = (contrast > CLEAR * sigma) & direct_light
        sums = None
        if None not in gray.direct and None not in gray.inverse and good.any():
            shown = [k for k in (*gray.direct, *gray.inverse) if k is not None]
            levels = (frames[shown][:, good] - low[good]) / contrast[good]
            spread = np.cov(levels)
            half, own = gray.bits, np.diag(spread)
            sums = own[:half, None] + own[None, half:] + 2.0 * spread[:half, half:]
        return cls(signal > 0.0, np.abs(signal) > CLEAR * sigma, good, gray.plain, sums)


def _pairs(sums: NDArray[np.float64], name: str) -> Finding:
    """Each frame belongs to the inverse with which its sum has the smallest variance."""
    # Noise-free frames and their inverses add up to a constant.
    ratios = np.diag(sums) / np.maximum(sums.min(axis=1), 1e-12)
    bit = int(ratios.argmax())
    if ratios[bit] > UNPAIRED:
        said = (
            f"the frame of bit {bit} fits the inverse of bit {int(sums[bit].argmin())} {ratios[bit]:.1f} times better "
            "than its own: their frames are not where the manifest says"
        )
        return Finding(name, "wrong", said, float(ratios[bit]))
    return Finding(name, "ok", "every frame fits its own inverse best", float(ratios[bit]))


def _codes(bits: NDArray[np.bool_], plain: bool) -> NDArray[np.int32]:
    """Cell number (...) of Gray bits (bit, ...)."""
    code = np.zeros(bits.shape[1:], np.int32)
    parity = np.zeros(bits.shape[1:], np.bool_)
    for bit in bits:
        parity = bit if plain else parity ^ bit
        code += code
        code += parity
    return code


def _smoothness(look: _GraySamples, name: str) -> Finding:
    """Neighbouring pixels see neighbouring cells: no exchange or inversion of bits may make the code smoother."""
    # Bits hidden by blur carry no order, and their noise would hide the others.
    share = look.clear[:, look.good].mean(axis=1) > CLEARLY
    count = len(share) if share.all() else int(np.argmin(share))
    if count < 2:
        return Finding(name, "unknown", "fewer than two bits are clear of noise and blur")
    bits = look.bits[:count]
    # A pixel across an edge is not clear, so the pixels compared are on either side of it.
    clear = look.good & look.clear[:count].all(axis=0)
    pair = clear[:, GAP:] & clear[:, :-GAP]
    pair &= (bits[:, :, GAP:] != bits[:, :, :-GAP]).any(axis=0)
    sides = bits[:, :, GAP:][:, pair], bits[:, :, :-GAP][:, pair]
    if not pair.any():
        return Finding(name, "unknown", "no two neighbouring pixels see different cells")

    def rough(order: list[int], flipped: int | None = None) -> float:
        right, left = (side[order] for side in sides)
        if flipped is not None:
            right[flipped] ^= True
            left[flipped] ^= True
        return float(
            np.log2(1.0 + np.abs(_codes(right, look.plain) - _codes(left, look.plain))).mean()
        )

    stated = list(range(count))
    stated_roughness = rough(stated)
    others: list[tuple[float, str]] = []
    for i, j in combinations(stated, 2):
        order = stated.copy()
        order[i], order[j] = j, i
        others.append((rough(order), f"with bits {i} and {j} exchanged"))
    others.append((rough(stated[::-1]), "with the bits in reverse order"))
    # The first bit inverted only mirrors the code: see its range.
    others += [(rough(stated, i), f"with bit {i} inverted") for i in stated[1:]]
    best = min(others)
    said = f"neighbouring cells differ by {2**stated_roughness - 1:.2f}, {best[1]} by {2 ** best[0] - 1:.2f}"
    if best[0] < SMOOTHER * stated_roughness:
        return Finding(
            name, "wrong", f"{said}: correct the frames' order", stated_roughness / best[0]
        )
    return Finding(name, "ok", said, stated_roughness / best[0])
