"""Storage of a data set: a folder of this machine, or any URL that fsspec opens. One interface for both.

Names are relative, with slashes. `put` is all or nothing for a single file; a folder's samples count as made only once
their record is written, so that a partly uploaded one never counts.
"""

import os
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from scenes.support.errors import DatasetError

STAGING = ".staging"


class Store(ABC):
    """Named files and folders at one place."""

    where: str
    lasting = True
    """What is stored is still there when this process ends."""

    @abstractmethod
    def list(self, name: str = "") -> list[str]:
        """Names right under a folder, sorted; none if it is missing."""

    @abstractmethod
    def read(self, name: str) -> bytes | None:
        """A file's content, None if it is missing."""

    @abstractmethod
    def put(self, staged: Path, name: str) -> None:
        """Move a local file or folder to `name`, over what is there."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Take a file or folder away, if it is there."""

    @abstractmethod
    def local(self, name: str) -> Any:
        """Context that gives a file as a local path, None if it is missing."""

    @abstractmethod
    def staging(self) -> Any:
        """Context that gives an empty local folder to make things in, from where `put` is quick."""

    def clear_staging(self) -> None:
        """Remove what runs that were killed left behind."""
        for name in self.list():
            if name.startswith(STAGING):
                self.remove(name)

    @abstractmethod
    def alone(self) -> Any:
        """Context in which no other run writes here, where the storage has locks."""

    def write(self, name: str, content: bytes) -> None:
        """Write a file, whole or not at all."""
        with self.staging() as folder:
            staged = folder / Path(name).name
            staged.write_bytes(content)
            self.put(staged, name)


def open_store(where: str | Path) -> Store:
    """The store at a path or URL; nothing is made or touched yet. `DatasetError` for a URL that cannot be opened."""
    text = str(where)
    if not text.removeprefix("file://").strip():
        raise DatasetError("the place of the data set is empty: give a folder or a URL")
    if "://" not in text:
        return Folder(Path(text))
    if text.startswith("file://"):
        return Folder(Path(text.removeprefix("file://")))
    return Remote(text)


class Folder(Store):
    """A folder of this machine, or of a file system it shares."""

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self.where = str(root)

    def list(self, name: str = "") -> list[str]:
        """Names right under a folder, sorted; none if it is missing."""
        folder = self.root / name
        return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []

    def read(self, name: str) -> bytes | None:
        """A file's content, None if it is missing."""
        try:
            return (self.root / name).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise self._refused(name, error) from error

    def put(self, staged: Path, name: str) -> None:
        """Rename into place: a folder appears with all its files or not at all."""
        target = self.root / name
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            if staged.is_dir():
                # A folder cannot replace one with files: move the old one away first.
                with self.staging() as aside, suppress(FileNotFoundError):
                    target.rename(aside / "old")
            staged.replace(target)
        except OSError as error:
            raise self._refused(name, error) from error

    def remove(self, name: str) -> None:
        """Take a file or folder away, if it is there."""
        target = self.root / name
        try:
            if target.is_dir():
                shutil.rmtree(target)
            else:
                target.unlink(missing_ok=True)
        except OSError as error:
            raise self._refused(name, error) from error

    @contextmanager
    def local(self, name: str) -> Iterator[Path | None]:
        """The file itself."""
        path = self.root / name
        yield path if path.is_file() else None

    @contextmanager
    def staging(self) -> Iterator[Path]:
        """A folder inside this one, so that putting is a rename."""
        try:
            # Each has its own: workers of a cluster that shared one would remove it as another enters.
            self.root.mkdir(parents=True, exist_ok=True)
            folder = Path(tempfile.mkdtemp(prefix=STAGING, dir=self.root))
            # mkdtemp's folders are private; files of a data set follow the umask.
            made = folder / "new"
            made.mkdir()
        except OSError as error:
            raise self._refused("", error) from error
        try:
            yield made
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Holds a lock, which the system releases when the process ends."""
        try:
            self.root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._refused("", error) from error
        try:
            import fcntl
        except ImportError:
            # Windows: two runs at once would only make the same bytes twice.
            yield
            return
        lock = os.open(self.root, os.O_RDONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            raise DatasetError(
                f"another run is writing to '{self.where}': wait for it, or choose another folder"
            ) from None
        except OSError:
            # Some network file systems have no locks.
            pass
        try:
            yield
        finally:
            self.clear_staging()
            os.close(lock)

    def _refused(self, name: str, error: OSError) -> DatasetError:
        path = self.root / name if name else self.root
        return DatasetError(
            f"cannot use '{path}': {error.strerror or error}; choose a folder that is writable and has room"
        )


class Remote(Store):
    """Whatever fsspec opens: object stores, network file systems, memory."""

    def __init__(self, url: str) -> None:
        import fsspec

        self.where = url
        try:
            self.files, self.root = fsspec.core.url_to_fs(url)
        except (ImportError, ValueError, OSError) as error:
            raise DatasetError(f"cannot open '{url}': {error}") from error
        self.lasting = not _in_memory(self.files)

    def list(self, name: str = "") -> list[str]:
        """Names right under a folder, sorted; none if it is missing."""
        with self._errors_as_ours(name):
            self.files.invalidate_cache()
            try:
                found = self.files.ls(self._path(name), detail=False)
            except (FileNotFoundError, NotADirectoryError):
                return []
        return sorted(str(path).rstrip("/").rsplit("/", 1)[-1] for path in found)

    def read(self, name: str) -> bytes | None:
        """A file's content, None if it is missing."""
        with self._errors_as_ours(name):
            try:
                return bytes(self.files.cat_file(self._path(name)))
            except (FileNotFoundError, IsADirectoryError):
                return None

    def put(self, staged: Path, name: str) -> None:
        """Upload; a folder file by file."""
        with self._errors_as_ours(name):
            if staged.is_file():
                self.files.makedirs(self._path(name).rsplit("/", 1)[0], exist_ok=True)
                self.files.put_file(str(staged), self._path(name))
                return
            self.remove(name)
            self.files.makedirs(self._path(name), exist_ok=True)
            for path in sorted(staged.iterdir()):
                self.files.put_file(str(path), self._path(f"{name}/{path.name}"))

    def remove(self, name: str) -> None:
        """Take a file or folder away, if it is there."""
        with self._errors_as_ours(name), suppress(FileNotFoundError):
            self.files.rm(self._path(name), recursive=True)

    @contextmanager
    def local(self, name: str) -> Iterator[Path | None]:
        """A download that goes away with the context."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / Path(name).name
            with self._errors_as_ours(name):
                try:
                    self.files.get_file(self._path(name), str(path))
                except (FileNotFoundError, IsADirectoryError):
                    path.unlink(missing_ok=True)
            yield path if path.is_file() else None

    @contextmanager
    def staging(self) -> Iterator[Path]:
        """A temporary folder of this machine."""
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / "new"
            made.mkdir()
            yield made

    @contextmanager
    def alone(self) -> Iterator[None]:
        """URLs have no locks: two runs at once would only make the same bytes twice."""
        yield

    def _path(self, name: str) -> str:
        return f"{self.root}/{name}".rstrip("/")

    @contextmanager
    def _errors_as_ours(self, name: str) -> Iterator[None]:
        """Errors of the URL's library as `DatasetError`."""
        try:
            yield
        except (DatasetError, FileNotFoundError):
            raise
        except Exception as error:
            raise DatasetError(f"cannot use '{self.where}/{name}': {error}") from error


def _in_memory(files: Any) -> bool:
    """Whether a file system, or the one it caches, exists in this process alone."""
    while files is not None:
        protocol = files.protocol
        if "memory" in ((protocol,) if isinstance(protocol, str) else protocol):
            return True
        files = getattr(files, "fs", None)
    return False
