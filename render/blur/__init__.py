"""The camera's blur: its kernel, and what it brings in from beyond the borders of the image."""
