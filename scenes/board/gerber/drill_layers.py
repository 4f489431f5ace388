"""Drill files of a board: which they are, and the outlines of their holes and slots in mm."""

import re
from functools import lru_cache
from pathlib import Path

import shapely

from scenes.board.gerber.excellon import DrilledOutline, DrillFormat, DrillProgram, plating
from scenes.board.gerber.interpreter import read
from scenes.board.gerber.openings import drawable, flipped
from scenes.board.gerber.tokens import Malformed
from scenes.support.errors import FileError
from scenes.support.paths import is_file, missing

SUFFIXES = {".drl", ".xln", ".exc", ".drd", ".ncd", ".nc", ".cnc", ".drill", ".rou", ".fdr"}

_HEAD = re.compile(r"^\s*M48\s*$", re.MULTILINE)
_GERBER_DRILL = re.compile(r"TF\.FileFunction,(Non)?Plated,")
_SPAN = re.compile(r"TF\.FileFunction,\w+,(\d+),\d+,(Blind|Buried)", re.IGNORECASE)


def drill_files(folder: Path) -> tuple[Path, ...]:
    """Drill files of a folder, by their beginning (M48, or a Gerber attribute) or their suffix."""
    files = sorted(path for path in folder.iterdir() if path.is_file())
    return tuple(path for path in files if path.suffix.lower() in SUFFIXES or _is_drill(path))


def _is_drill(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(8192).decode("latin-1")
    return bool(_HEAD.search(head) or _GERBER_DRILL.search(head))


def read_drills(
    path: Path, mirrored: bool = False, number_format: DrillFormat | None = None
) -> tuple[DrilledOutline, ...]:
    """Read the holes and slots of a drill file, Excellon or Gerber.

    Parameters
    ----------
    path
        The drill file.
    mirrored
        Reverse the sign of x, as for the bottom side seen from below. Blind holes of the other side are left out, as
        are buried ones.
    number_format
        What the file leaves unsaid of its numbers.

    Returns
    -------
    tuple of DrilledOutline
        Outlines in mm, in the file's order.

    Raises
    ------
    FileError
        For a file that is not a whole, valid drill file, or whose numbers are ambiguous.
    """
    if not is_file(path):
        raise FileError(f"drill file '{path}' {missing(path)}: check the path")
    status = path.stat()
    holes = _read(
        path, status.st_size, status.st_mtime_ns, number_format or DrillFormat(), mirrored
    )
    if not mirrored:
        return holes
    return tuple(DrilledOutline(shapely.transform(h.outline, flipped), h.plated) for h in holes)


@lru_cache(maxsize=16)
def _read(
    path: Path, size: int, time_ns: int, number_format: DrillFormat, bottom: bool
) -> tuple[DrilledOutline, ...]:
    text = path.read_bytes().decode("latin-1")
    span = _SPAN.search(text)
    if span and (span[2].lower() == "buried" or (int(span[1]) == 1) == bottom):
        return ()
    with drawable(path):
        gerber_drill = None if _HEAD.search(text) else _GERBER_DRILL.search(text)
        if gerber_drill:
            plated = plating(gerber_drill[0])
            return tuple(
                DrilledOutline(part, plated)
                for item in read(path).objects
                for part in shapely.get_parts(item.shape())
            )
        program = DrillProgram(number_format, plating(path.stem))
        lines = 0
        try:
            for command in text.splitlines():
                lines += 1
                program.obey(command.strip())
            return program.drilled()
        except Malformed as error:
            raise FileError(
                f"'{path}' cannot be read as a drill file: {error} (line {lines}); export it again"
            ) from error
