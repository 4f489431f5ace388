"""Messages that name arguments of Python functions name the options of the command instead."""

import re
from collections.abc import Iterable, Mapping


def with_options(message: str, options: Mapping[str, str]) -> str:
    """A message with the options of a command in place of the keywords of a function; `options` is name -> option.

    >>> with_options("give c_px_per_mm, or height='phase'", {"c_px_per_mm": "--c-px-per-mm", "height": "--height"})
    'give --c-px-per-mm, or --height phase'
    """
    for name, option in options.items():
        message = re.sub(rf"\b{name}='([^']*)'", rf"{option} \1", message)
        # A name of one word may be an ordinary word.
        if "_" in name:
            message = re.sub(rf"(?<![-.\w]){name}\b(?!\.)", option, message)
    return message


def options_of(parameters: Iterable[object]) -> dict[str, str]:
    """Name -> long option of each parameter of a command that has one."""
    found = {}
    for parameter in parameters:
        name, words = getattr(parameter, "name", None), getattr(parameter, "opts", ())
        long = [word for word in words if word.startswith("--")]
        if name and long:
            found[name] = long[0]
    return found
