"""Damage to files: truncation, flipped bits, spans lost, doubled or exchanged, absurd numbers."""

import random
import re

# Values that often break programs, as text and as four bytes.
ABSURD = (
    "0", "-1", "1e308", "1e999", "-1e-320", "nan", "NaN", "inf", "-inf", "2147483648", "18446744073709551616",
    "9" * 5000, "1e-30", '""', "[]", "{}", "null", "true", '"../../x"', "[" * 3000, "1_0", "0x7f", "1979-05-27",
)  # fmt: skip
WORDS = (
    b"\0\0\0\0",
    b"\xff\xff\xff\x7f",
    b"\xff\xff\xff\xff",
    b"\0\0\xc0\x7f",
    b"\0\0\x80\x7f",
    b"\1\0\0\0",
    b"\0\xca\x9a\x3b",
)
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
KINDS = ("cut", "flip", "lose", "double", "exchange", "word", "number", "byte", "text")


def damaged(whole: bytes, kind: str, rng: random.Random) -> bytes:
    """The file after one kind of damage."""
    if not whole:
        return whole
    at = rng.randrange(len(whole))
    length = min(int(rng.paretovariate(0.7)), len(whole) - at)
    before, span, after = whole[:at], whole[at : at + length], whole[at + length :]
    numbers = list(NUMBER.finditer(whole)) if kind == "number" else []
    match kind:
        case "cut":
            span = after = b""
        case "flip":
            span, after = bytes([whole[at] ^ (1 << rng.randrange(8))]), whole[at + 1 :]
        case "byte":
            span, after = bytes([rng.randrange(256)]), whole[at + 1 :]
        case "lose":
            span = b""
        case "double":
            span *= rng.choice((2, 3, 50))
        case "exchange":
            other = rng.randrange(len(after) + 1)
            span, after = (
                after[other : other + length],
                after[:other] + span + after[other + length :],
            )
        case "word":
            span, after = rng.choice(WORDS), whole[at + 4 :]
        case "text":
            span, after = rng.choice(ABSURD).encode(), whole[at:]
        case "number" if numbers:
            found = rng.choice(numbers)
            before, after = whole[: found.start()], whole[found.end() :]
            span = rng.choice(ABSURD).encode()
    return before + span + after


def damage_with_seed(whole: bytes, seed: int) -> bytes:
    """The file after one to three kinds of damage, drawn with the seed."""
    rng = random.Random(seed)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        whole = damaged(whole, rng.choice(KINDS), rng)
    return whole
