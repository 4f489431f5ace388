"""Mirroring surfaces, measured by the image of a screen that they show: slopes, and heights from them."""

from decode.deflectometry.choices import require_projectors
from decode.deflectometry.mirror import decode_mirror

__all__ = ["decode_mirror", "require_projectors"]
