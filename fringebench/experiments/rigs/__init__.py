"""Experiments on a rig: made from data, calibrated, and accepted."""
