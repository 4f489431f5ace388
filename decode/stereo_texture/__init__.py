"""Stereo by texture: heights from two pictures of one surface, printed or lit with dots."""
