"""The base of every validated, immutable part of a scene."""

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from scenes.errors import ImpossibleError, nearest


class Frozen(BaseModel):
    """Immutable; unknown keys, NaN and infinity are refused: `ImpossibleError`."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ImpossibleError("\n".join(_lines(error, type(self)))) from None

    # What validates a whole tree then goes past this method, and keeps each part's place in its own errors.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


def in_words(error: Exception) -> str:
    """What an error says: of a validation one line a mistake, without pydantic's own; which key is missing."""
    if isinstance(error, ValidationError):
        return "\n".join(_lines(error))
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)


def _lines(
    error: ValidationError, model: type[BaseModel] | None = None, most: int = 10
) -> Iterator[str]:
    """Where, what is wrong, the value."""
    name = [model.__name__] if model else []
    for detail in error.errors()[:most]:
        place = ".".join([*name, *map(str, detail["loc"])])
        if detail["type"] == "extra_forbidden":
            unknown = str(detail["loc"][-1])
            known = (
                nearest(unknown, model.model_fields) if model and len(detail["loc"]) == 1 else ""
            )
            yield f"{place} does not exist" + (f": {known}" if known else "")
        elif detail["type"] == "missing":
            yield f"{place} is missing: it is required"
        else:
            message = detail["msg"].removeprefix("Value error, ")
            value = detail["input"]
            shown = "" if isinstance(value, (dict, BaseModel)) else f" (got {value!r})"
            yield f"{place}: {message}{shown}" if place else f"{message}{shown}"
    if error.error_count() > most:
        yield f"and {error.error_count() - most} more errors"
