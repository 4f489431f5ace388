"""A projector's light changed after it was traced: other patterns, and masks of its pixels."""
