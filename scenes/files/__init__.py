"""Files that rooms exchange: EXR stacks and truth maps, and captures of real images."""
