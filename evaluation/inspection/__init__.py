"""Solder paste inspection: pads measured, judged, and the gauge studied."""
