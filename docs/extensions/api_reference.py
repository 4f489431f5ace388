"""API pages: ``<!-- api: ROOM -->`` in a page becomes everything in that room's ``__all__``, from its docstrings."""

import importlib
import inspect
import re
from types import ModuleType
from typing import Any

from pydantic import BaseModel
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

ROOMS = ("scenes", "render", "decode", "evaluation", "fringebench")
PLACEHOLDER = re.compile(r"^<!-- api: (\w+) -->$", re.MULTILINE)
# Headings of a page, in this order; a large room's classes have one for each of its folders, after "Classes".
HEADINGS = ("Functions", "Classes", "Errors and warnings", "Other names")
LARGE = 30
# Annotated[TYPE, FieldInfo(...)]
CONSTRAINED = re.compile(r"~?(?:\w+\.)*Annotated\[([^()]+?), ~?(?:\w+\.)*FieldInfo\([^()]*\)\]")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("source-read", _fill)
    app.connect("missing-reference", _resolve)
    app.connect("autodoc-process-signature", _shorten)
    app.connect("autodoc-skip-member", _skip)
    return {"parallel_read_safe": True}


def _fill(app: Sphinx, docname: str, source: list[str]) -> None:
    source[0] = PLACEHOLDER.sub(lambda match: _page(match[1]), source[0])


def _page(room: str) -> str:
    """Markdown of a room: a table of its names, then each in full."""
    module = importlib.import_module(room)
    groups: dict[str, list[str]] = {}
    elsewhere = []
    for name in sorted(module.__all__, key=str.lower):
        thing = getattr(module, name)
        home = _home(thing)
        if home and home != f"{room}.{name}":
            elsewhere.append((name, home, thing))
        elif not (inspect.ismodule(thing) and name in ROOMS):
            groups.setdefault(_heading(module, thing), []).append(name)
    parts = [f"```{{eval-rst}}\n.. py:module:: {room}\n```\n"]
    for heading in sorted(groups, key=lambda text: (HEADINGS.index(text.partition(":")[0]), text)):
        names = groups[heading]
        parts += [f"## {heading}\n", _table(room, names), *(_entry(module, n) for n in names)]
    if elsewhere:
        parts += ["## The rooms' names\n", _links(elsewhere)]
    return "\n".join(parts)


def _home(thing: Any) -> str:
    """Public name of a function or class where it is documented: its own room's, else the front door's."""
    for room in ROOMS:
        module = importlib.import_module(room)
        for name in module.__all__:
            if getattr(module, name) is thing:
                return f"{room}.{name}"
    return ""


def _heading(module: ModuleType, thing: Any) -> str:
    if not inspect.isclass(thing):
        return "Functions" if inspect.isroutine(thing) else "Other names"
    if issubclass(thing, Exception):
        return "Errors and warnings"
    folder = thing.__module__.split(".")[1]
    if len(module.__all__) > LARGE and hasattr(getattr(module, folder, None), "__path__"):
        return f"Classes: {folder}"
    return "Classes"


def _table(room: str, names: list[str]) -> str:
    lines = "\n".join(f"   {name}" for name in names)
    return f"```{{eval-rst}}\n.. currentmodule:: {room}\n\n.. autosummary::\n   :nosignatures:\n\n{lines}\n```\n"


def _entry(module: ModuleType, name: str) -> str:
    thing = getattr(module, name)
    if inspect.ismodule(thing):
        about = " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())
        return f"```{{eval-rst}}\n.. py:data:: {name}\n   :no-typesetting:\n\n``{name}`` (module): {about}\n```\n"
    if inspect.isclass(thing):
        directive = "autoexception" if issubclass(thing, Exception) else "autoclass"
        options = "\n   :members:"
    else:
        directive, options = "autofunction" if inspect.isroutine(thing) else "autodata", ""
    return f"```{{eval-rst}}\n.. {directive}:: {module.__name__}.{name}{options}\n```\n"


def _links(elsewhere: list[tuple[str, str, Any]]) -> str:
    lines = ["| name | is |", "|---|---|"]
    lines += [f"| `{name}` | {{py:obj}}`{home}` |" for name, home, _ in elsewhere]
    return "\n".join([*lines, ""])


def _resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref, child: Any) -> Any:
    """A class named by the module that defines it is linked under its public name."""
    if node.get("refdomain") != "py":
        return None
    public = _public_names().get(node["reftarget"])
    if public is None:
        return None
    return env.get_domain("py").resolve_xref(
        env, node["refdoc"], app.builder, "obj", public, node, child
    )


def _public_names() -> dict[str, str]:
    found: dict[str, str] = {}
    for room in ROOMS:
        module = importlib.import_module(room)
        for name in module.__all__:
            thing = getattr(module, name)
            if hasattr(thing, "__qualname__"):
                found.setdefault(f"{thing.__module__}.{thing.__qualname__}", f"{room}.{name}")
    return found


def _shorten(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, signature: str, returns: str
) -> tuple[str, str] | None:
    """A model's signature lists its fields, which follow anyway; elsewhere pydantic's constraints are left out."""
    if inspect.isclass(thing) and issubclass(thing, BaseModel):
        return "", ""
    if not signature:
        return None
    return CONSTRAINED.sub(r"\1", signature), CONSTRAINED.sub(r"\1", returns or "")


def _skip(app: Sphinx, what: str, name: str, thing: Any, skip: bool, options: Any) -> bool | None:
    """What pydantic adds to every model says nothing about this one."""
    return True if name.startswith("model_") or hasattr(BaseModel, name) else None
