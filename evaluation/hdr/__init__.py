"""Strategies for scenes of high dynamic range, compared."""
