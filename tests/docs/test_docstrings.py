"""Public functions and classes that take or return arrays document them: numpydoc sections, read by numpydoc's parser."""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from tests.commands import ROOMS

# Annotations that are arrays, and the types that hold the arrays of a capture.
ARRAYS = re.compile(r"\b(?:ndarray|NDArray|ArrayLike|Stack|Transport|Truth|Reconstruction)\b")
MIN_FRACTION = 0.9


@dataclass(frozen=True)
class Public:
    """A public name, and what of its docstring is missing."""

    name: str
    missing: tuple[str, ...]


def _faces() -> Iterator[str]:
    """The rooms, and the folders inside them."""
    for room in ROOMS:
        yield room
        package = importlib.import_module(room)
        for found in pkgutil.walk_packages(package.__path__, f"{room}."):
            if found.ispkg:
                yield found.name


def _public() -> Iterator[Public]:
    seen: set[int] = set()
    for face in _faces():
        module = importlib.import_module(face)
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if id(thing) in seen or getattr(thing, "__module__", "").split(".")[0] not in ROOMS:
                continue
            seen.add(id(thing))
            if inspect.isclass(thing):
                yield from _class(f"{face}.{name}", thing)
            elif inspect.isfunction(thing):
                yield from _function(f"{face}.{name}", thing)


def _function(name: str, thing: Any) -> Iterator[Public]:
    signature = inspect.signature(thing)
    takes = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
    gives = signature.return_annotation
    if not any(_is_array(p.annotation) for p in takes) and not _is_array(gives):
        return
    missing = []
    sections = _sections(thing)
    if takes and "Parameters" not in sections:
        missing.append("Parameters")
    if gives not in (None, inspect.Signature.empty) and not {"Returns", "Yields"} & sections:
        missing.append("Returns")
    yield Public(name, tuple(missing))


def _class(name: str, thing: type) -> Iterator[Public]:
    """A class counts if it has array fields: it documents them in a section, or each below its definition."""
    from sphinx.pycode import ModuleAnalyzer

    fields = [
        f for f, kind in inspect.get_annotations(thing).items() if _is_array(kind) and f[0] != "_"
    ]
    if fields:
        documented = {
            attribute
            for owner, attribute in ModuleAnalyzer.for_module(thing.__module__).find_attr_docs()
            if owner == thing.__qualname__
        }
        whole = bool({"Parameters", "Attributes"} & _sections(thing))
        missing = [] if whole else [f for f in fields if f not in documented]
        yield Public(name, tuple(missing))
    for method, member in vars(thing).items():
        inner = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if inspect.isfunction(inner) and not method.startswith("_"):
            # A method that implements one of a base class is documented there.
            documented_by_base = any(
                _sections(getattr(base, method, None)) for base in thing.__bases__
            )
            if not documented_by_base:
                yield from _function(f"{name}.{method}", inner)


def _is_array(annotation: Any) -> bool:
    return bool(ARRAYS.search(str(annotation)))


def _sections(thing: Any) -> set[str]:
    from numpydoc.docscrape import NumpyDocString

    document = NumpyDocString(inspect.getdoc(thing) or "")
    return {
        section
        for section in ("Parameters", "Returns", "Yields", "Attributes")
        if document[section]
    }


def test_arrays_of_public_functions_and_classes_are_documented() -> None:
    pytest.importorskip(
        "numpydoc", reason="numpydoc is not installed (pip install fringebench[docs])"
    )
    pytest.importorskip("sphinx", reason="Sphinx is not installed (pip install fringebench[docs])")
    found = list(_public())
    lacking = [f"{public.name}: {', '.join(public.missing)}" for public in found if public.missing]
    fraction = 1 - len(lacking) / len(found)
    assert fraction >= MIN_FRACTION, f"{fraction:.0%} of {len(found)}:\n" + "\n".join(lacking)
