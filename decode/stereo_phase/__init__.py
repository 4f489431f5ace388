"""Stereo by phase: heights from two cameras that see the same fringes."""

from decode.stereo_phase.two_cameras import stereo

__all__ = ["stereo"]
