"""Geometry of cameras and projectors, calibrations, and OpenCV's calibration files."""
