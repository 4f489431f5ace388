"""The base of every validated, immutable part of a scene."""

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from scenes.support.errors import ImpossibleError
from scenes.support.validation_words import first_lines, mistakes


class Frozen(BaseModel):
    """Immutable; unknown keys, NaN and infinity are refused: `ImpossibleError`."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            model = type(self)
            found = mistakes(error, model, values, prefix=model.__name__)
            raise ImpossibleError(first_lines([m.message for m in found])) from None

    # So that validating a whole tree bypasses this method, and each part keeps its place in the tree's own errors.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]
