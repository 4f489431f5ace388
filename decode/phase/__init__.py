"""Wrapped phase and modulation from phase-shifted samples, and gamma."""

from decode.phase.n_step import variance_rad2, wrap

__all__ = ["variance_rad2", "wrap"]
