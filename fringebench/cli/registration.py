"""Commands whose parameters are explained by the docstring, and named by their example."""

import inspect
import re
from collections.abc import Callable
from copy import copy
from typing import Annotated, Any, TypeVar, get_args, get_origin

import typer

Function = TypeVar("Function", bound=Callable[..., Any])
HELP = re.compile(r"^(\w+): (.+)$", re.MULTILINE)


def command(app: typer.Typer, example: str) -> Callable[[Function], Function]:
    """Make a function the command that the example shows; lines ``name: help`` of its docstring are its parameters' help.

    A parameter without a default is an argument, `output` is ``-o``, a bool is a flag; others are options of their name.
    """

    def registered(function: Function) -> Function:
        text = inspect.getdoc(function) or ""
        explained = dict(HELP.findall(text))
        for name, parameter in inspect.signature(function).parameters.items():
            hint = parameter.annotation
            kind, *given = get_args(hint) if get_origin(hint) is Annotated else (hint,)
            info = copy(given[0]) if given else _usual(name, kind, parameter.default)
            info.help = explained.pop(name, info.help)
            function.__annotations__[name] = Annotated[kind, info]
        assert not explained, f"the docstring of {function.__name__} has {explained}"
        name = example.split()[1]
        add = app.command(name, help=HELP.sub("", text).strip(), epilog=f"Example: {example}")
        return add(function)

    return registered


def _usual(name: str, kind: Any, default: Any) -> Any:
    if name == "output":
        return typer.Option("-o", "--output")
    if kind is bool:
        return typer.Option(f"--{name.replace('_', '-')}")
    return typer.Argument() if default is inspect.Parameter.empty else typer.Option()
