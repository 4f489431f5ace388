"""What a board has besides its printed pads: holes."""
