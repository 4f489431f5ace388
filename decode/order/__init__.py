"""Which period of the fringe each wrapped phase belongs to."""
