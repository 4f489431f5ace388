"""The one place that chooses Mitsuba's variant. Import `mi` and `dr` from here, never directly.

Dr.Jit looks for LLVM once, when it is first imported, so `scenes.support.backend` must choose one before that. Importing
`render` does so, because a user's own ``import mitsuba`` may follow, and an old system LLVM would abort the process. On a
machine without any LLVM the import succeeds, and the first use says what is missing.
"""

import contextlib
import functools
import importlib
from typing import Any

from scenes.support import backend
from scenes.support.errors import BackendError


class _Later:
    """A module that is imported when first used, after the backend is chosen."""

    def __init__(self, name: str) -> None:
        self._name = name

    @functools.cached_property
    def _module(self) -> Any:
        _chosen()
        return importlib.import_module(self._name)

    def __getattr__(self, attribute: str) -> Any:
        return getattr(self._module, attribute)


mi: Any = _Later("mitsuba")
dr: Any = _Later("drjit")


def use() -> None:
    """Make the machine's variant Mitsuba's current one, in the whole process."""
    variant = _chosen().variant
    if mi.variant() != variant:
        mi.set_variant(variant)


@functools.cache
def _chosen() -> backend.Backend:
    return backend.select()


with contextlib.suppress(BackendError):
    _chosen()
