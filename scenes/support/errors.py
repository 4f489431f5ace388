"""The project's one tree of errors.

Policy: bad input (a file, a key, a rig, a mesh, a full disk) raises a `FringebenchError` whose message says what is
wrong, the value, what is allowed and what to do. The command line prints it and exits with status 2. Any other exception
is a bug of the project and keeps its traceback.
"""

import difflib
from collections.abc import Iterable


class FringebenchError(Exception):
    """Base class of all errors that a user's input can cause; the message says what to change."""


class FringebenchWarning(UserWarning):
    """Work that was done with a worse result than requested."""


class SceneError(FringebenchError):
    """An invalid scene: unknown name or key, a value out of range, an impossible rig."""


class ImpossibleError(SceneError, ValueError):
    """A part of a scene made in Python with invalid values; also a `ValueError`, as pydantic's own error is."""


class MeshError(SceneError):
    """A mesh that cannot be rendered: no faces, NaN vertices, an unreadable file."""


class FileError(FringebenchError):
    """A file that is missing, truncated, foreign, of another version, or cannot be written."""


class BackendError(FringebenchError):
    """No usable LLVM or CUDA on this machine."""


class TooLargeError(FringebenchError):
    """A request that this machine's memory cannot hold."""


class RenderError(FringebenchError):
    """A request that light transport or the sensor model cannot fulfil."""


class DecodeError(FringebenchError):
    """A stack that cannot be decoded, or whose reconstruction would be empty."""


class OutsideDecoderError(FringebenchError):
    """An external decoder that cannot be found or run, or whose output is no height map."""


class ScoreError(FringebenchError):
    """A reconstruction and a truth that cannot be compared."""


class DatasetError(FringebenchError):
    """A data set that cannot be made, continued or read."""


def nearest(word: str, known: Iterable[str]) -> str:
    """A hint that names the nearest valid word, or all of them if none is near.

    >>> nearest("camrea", ["camera", "sensor"])
    "did you mean 'camera'?"
    """
    options = sorted(set(known))
    match = difflib.get_close_matches(word, options, n=1, cutoff=0.6)
    if match:
        return f"did you mean '{match[0]}'?"
    return "known: " + ", ".join(options)
