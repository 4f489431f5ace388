"""Low-discrepancy random numbers that are unbiased, seeded, and need no state.

Pairs of Owen-scrambled Sobol points (Sobol 1967; Owen 1995), the scrambling by a hash of bit-reversed digits (Laine
and Karras 2011; Burley 2020, JCGT 9(4); constants by Vegdahl 2021). Every pair of dimensions of every pixel has its
own scrambling and its own order of points, so pairs are independent of each other and each is stratified over a
pixel's samples.
"""

from functools import cache
from typing import Any

from scipy.stats import qmc

from render.plugins.variant import dr, mi

# A lane has fewer places than two to this power.
INDEX_BITS = 24
# Apart from the pairs of `point`.
JOINT = 0x2545F491


def stream(seed: int, pixel: Any) -> Any:
    """Key of a pixel's random numbers (UInt32) from the seed and the pixel's index."""
    return _hash(_hash(dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)) ^ pixel)


def block(key: Any, number: Any) -> Any:
    """Key of one of a pixel's independent blocks of samples, by its number (UInt32)."""
    return _hash(key ^ _hash(number + mi.UInt32(0x7F4A7C15)))


def point(key: Any, dimension: Any, index: Any) -> Any:
    """Sample `index` (UInt32) of a stream's pair of dimensions number `dimension`: a Point2f in [0, 1)."""
    key = _hash(key + dimension * mi.UInt32(0x9E3779B9))
    # The points' order is itself scrambled, else all pairs would walk the square in step.
    index = dr.brev(_laine_karras(dr.brev(index), key))
    x = _scrambled(index, _hash(key ^ 0xA511E9B3))
    y = _scrambled(_sobol(index), _hash(key ^ 0x63D83595))
    return mi.Point2f(x, y)


def pixel_point(key: Any, index: Any) -> Any:
    """Place of sample `index` in its pixel, a Point2f in [0, 1): pairs lie opposite about the centre.

    What varies linearly across a pixel then averages to its value at the centre, which random places do not do. The next
    pair is half a pixel off, so that one is as near to the pixel's border as the other to its centre: the contrast of a
    fringe falls with the square of that distance, and is 16 times less noisy than with one pair. Each place alone is
    uniform, so edges inside a pixel are weighed without bias.
    """
    place = point(key, mi.UInt32(0), index >> 2) + 0.5 * mi.Float((index >> 1) & 1)
    place = dr.select(place < 1.0, place, place - 1.0)
    return _mirrored(place, index)


def joint_point(key: Any, pair: int, index: Any) -> Any:
    """Sample `index` of a pair of dimensions of one sequence whose pairs are all stratified together: a Point2f in [0, 1).

    Behind a lens out of focus, a fringe's phase varies with the place in the pixel and in the pupil alike. If each were stratified
    alone, their combinations would be random. Samples come in pairs opposite about the centre in all dimensions at once: what is
    linear in them, as a phase nearly is, cancels.
    """
    found = []
    for dimension in (2 * pair, 2 * pair + 1):
        own = _hash(key + mi.UInt32(JOINT * (dimension + 1) % 2**32))
        found.append(_scrambled(_generated(dimension, index >> 1), own))
    return _mirrored(mi.Point2f(*found), index)


def _mirrored(place: Any, index: Any) -> Any:
    """Every other place through the centre of the square."""
    # 1 - x, kept below 1.
    return dr.select((index & 1) == 1, dr.minimum(1 - place, ONE_BELOW), place)


def _generated(dimension: int, index: Any) -> Any:
    """A Sobol dimension's number `index`, bit-reversed; of dimension 1 and 32 bits, `_sobol` is the faster one."""
    found = mi.UInt32(0)
    for bit, number in enumerate(_direction_numbers(dimension)):
        found ^= dr.select((index >> bit) & 1 == 1, mi.UInt32(number), 0)
    return found


@cache
def _direction_numbers(dimension: int) -> tuple[int, ...]:
    """What each bit of an index adds to a dimension of Sobol's sequence (Joe and Kuo 2008), bit-reversed."""
    numbers = []
    for bit in range(INDEX_BITS):
        sequence = qmc.Sobol(dimension + 1, scramble=False, bits=32)
        # In the order of Gray's code, points number 2^bit - 1 and 2^bit differ by that of the bit.
        if bit:
            sequence.fast_forward(2**bit - 1)
        pair = [int(sequence.random()[0, dimension] * 2.0**32) for _ in range(2)]
        numbers.append(int(f"{pair[0] ^ pair[1]:032b}"[::-1], 2))
    return tuple(numbers)


ONE_BELOW = 1 - 2.0**-24


def _sobol(index: Any) -> Any:
    """Second Sobol dimension, bit-reversed: Pascal's triangle modulo 2 applied to the index's bits."""
    for shift, mask in (
        (16, 0xFFFFFFFF),
        (8, 0xFF00FF00),
        (4, 0xF0F0F0F0),
        (2, 0xCCCCCCCC),
        (1, 0xAAAAAAAA),
    ):
        index = index ^ ((index & mi.UInt32(mask)) >> shift)
    return index


def _laine_karras(x: Any, key: Any) -> Any:
    """Owen scrambling of bit-reversed digits: each bit is flipped by a hash of the bits below it."""
    x = x ^ (x * mi.UInt32(0x3D20ADEA))
    x = x + key
    x = x * ((key >> 16) | 1)
    x = x ^ (x * mi.UInt32(0x05526C56))
    return x ^ (x * mi.UInt32(0x53A22864))


def _hash(x: Any) -> Any:
    """Well-mixed 32 bits (Ellis's lowbias32)."""
    x = (x ^ (x >> 16)) * mi.UInt32(0x7FEB352D)
    x = (x ^ (x >> 15)) * mi.UInt32(0x846CA68B)
    return x ^ (x >> 16)


def _scrambled(x: Any, key: Any) -> Any:
    """Bit-reversed digits as a number in [0, 1), Owen-scrambled."""
    return mi.Float(dr.brev(_laine_karras(x, key)) >> 8) * 2.0**-24
