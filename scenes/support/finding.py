"""What a check of a capture or of a stack says."""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "warning", "wrong", "unknown"]


@dataclass(frozen=True)
class Finding:
    """What one check found."""

    name: str
    verdict: Verdict
    message: str
    value: float | None = None
    """The figure the verdict rests on."""


def graded(value: float, warning: float, wrong: float) -> Verdict:
    """ok up to `warning`, warning up to `wrong`, wrong beyond and for NaN."""
    if not value <= wrong:
        return "wrong"
    return "warning" if value > warning else "ok"
