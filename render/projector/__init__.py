"""A projector's light changed after it was traced."""
