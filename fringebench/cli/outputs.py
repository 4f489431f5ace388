"""Output files are checked before the work: writable, different from each other, and no input among them."""

from collections.abc import Iterable, Mapping
from pathlib import Path


def check_outputs(
    outputs: Mapping[str, str | Path | None], inputs: Iterable[str | Path] = ()
) -> None:
    """Raise `FileError` unless every output file can be written without destroying an input or another output.

    `outputs` is option -> path, None where the option was not given.
    """
    from scenes.support.atomic_file import require_writable
    from scenes.support.errors import FileError

    given = {option: Path(path) for option, path in outputs.items() if path is not None}
    for option, path in given.items():
        for source in inputs:
            if _same(path, Path(source), existing=True):
                raise FileError(
                    f"{option} '{path}' is also an input and would be overwritten: choose another name"
                )
    seen: list[tuple[str, Path]] = []
    for option, path in given.items():
        for other, earlier in seen:
            if _same(path, earlier):
                raise FileError(
                    f"{other} and {option} are both '{path}': give them different names"
                )
        seen.append((option, path))
    require_writable(*given.values())


def _same(one: Path, other: Path, existing: bool = False) -> bool:
    """Whether two paths lead to one file, links followed; of an input, only if it exists."""
    try:
        if existing and not other.exists():  # the name of a shipped scene
            return False
        return one.resolve() == other.resolve() or (one.exists() and one.samefile(other))
    except (OSError, RuntimeError, ValueError):  # too long, a loop of links, a null byte
        return False
