"""From projector coordinates to heights."""
