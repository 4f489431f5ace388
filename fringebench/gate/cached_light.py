"""Light and truth of the cases, kept between runs in a folder, by what they were made of."""

import hashlib
import os
from functools import lru_cache
from pathlib import Path

import render
import scenes
from scenes.support.errors import FileError, FringebenchError

VARIABLE = "FRINGEBENCH_CACHE"
Light = tuple[render.Transport, scenes.Truth]


def chosen_folder(folder: str | Path | None) -> Path | None:
    """The folder given, else that of ``FRINGEBENCH_CACHE``; None: nothing is kept."""
    named = folder or os.environ.get(VARIABLE)
    return Path(named) if named else None


def light_of(scene: scenes.Scene, folder: Path | None) -> Light:
    """Light transport and truth of a scene: read where an earlier run left them, else made, and left.

    Both ways give the same numbers. A damaged file is made again.

    Raises
    ------
    FileError
        When the folder cannot be written.
    """
    if folder is None:
        return _made(scene)
    name = _key(scene)
    files = folder / f"{name}.transport.exr", folder / f"{name}.truth.exr"
    if all(file.is_file() for file in files):
        try:
            return render.Transport.read(files[0]), scenes.Truth.read(files[1])
        except FringebenchError:
            pass
    made = _made(scene)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cache folder '{folder}' cannot be made: {error.strerror}") from error
    made[0].write(files[0])
    made[1].write(files[1])
    return made


def _made(scene: scenes.Scene) -> Light:
    surfaces = render.surfaces(scene)
    transport = render.trace(scene, surfaces=surfaces)
    return transport, render.truth(scene, transport, surfaces)


def _key(scene: scenes.Scene) -> str:
    """Digest of a scene, of the meshes it is made of, and of the code that renders it."""
    found = hashlib.sha256(_code())
    found.update(scenes.dumps(scene).encode())
    # Only these read files, whose contents the scene's text does not have.
    if scene.board or any(isinstance(item.shape, scenes.MeshFile) for item in scene.objects):
        for part in scenes.parts(scene):
            for array in (part.mesh.vertices, part.mesh.faces):
                found.update(array.tobytes())
    return found.hexdigest()[:32]


@lru_cache
def _code() -> bytes:
    """The source code of the rooms that make light and truth."""
    found = hashlib.sha256()
    for room in (scenes, render):
        for file in sorted(Path(str(room.__file__)).parent.rglob("*.py")):
            found.update(file.read_bytes())
    return found.digest()
