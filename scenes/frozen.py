"""The base of every validated, immutable part of a scene."""

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
            raise ImpossibleError(_told(type(self), error)) from None

    # What validates a whole tree then goes past this method, and keeps each part's place in its own errors.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


def _told(model: type[BaseModel], error: ValidationError) -> str:
    """One line an error: where, what is wrong, the value."""
    lines = []
    for detail in error.errors():
        place = ".".join([model.__name__, *map(str, detail["loc"])])
        if detail["type"] == "extra_forbidden":
            unknown = str(detail["loc"][-1])
            known = nearest(unknown, model.model_fields) if len(detail["loc"]) == 1 else ""
            lines.append(f"{place} does not exist" + (f": {known}" if known else ""))
        elif detail["type"] == "missing":
            lines.append(f"{place} is missing: it is required")
        else:
            message = detail["msg"].removeprefix("Value error, ")
            value = detail["input"]
            shown = "" if isinstance(value, (dict, BaseModel)) else f" (got {value!r})"
            lines.append(f"{place}: {message}{shown}")
    return "\n".join(lines)
