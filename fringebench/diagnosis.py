"""What this machine has, and what to do about what is missing."""

import importlib.metadata
import os
import platform
import sys
from dataclasses import asdict, dataclass, field
from typing import Any

from scenes.support import backend
from scenes.support.errors import BackendError

PACKAGES = (
    "fringebench",
    "mitsuba",
    "drjit",
    "numpy",
    "OpenEXR",
    "trimesh",
    "opencv-python-headless",
)


@dataclass(frozen=True)
class Diagnosis:
    """Properties of the machine that matter to fringebench."""

    python: str
    platform: str
    cores: int
    packages: dict[str, str]
    backend: str | None
    variant: str | None
    llvm_path: str | None
    llvm_version: int | None
    llvm_origin: str | None
    cuda: bool
    problems: list[str] = field(default_factory=list)

    @property
    def healthy(self) -> bool:
        """Whether light can be traced here."""
        return not self.problems

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {**asdict(self), "healthy": self.healthy}


def diagnose() -> Diagnosis:
    """Inspect interpreter, packages and backend; problems are listed, not raised."""
    problems = []
    chosen = None
    try:
        chosen = backend.select()
    except BackendError as error:
        problems.append(str(error))
    llvm = chosen.llvm if chosen else backend.find_llvm()
    packages = {name: _version(name) for name in PACKAGES}
    problems += [
        f"{name} is not installed: pip install {name}"
        for name, version in packages.items()
        if version == "missing" and name != "fringebench"
    ]
    return Diagnosis(
        python=sys.version.split()[0],
        platform=platform.platform(),
        cores=os.cpu_count() or 1,
        packages=packages,
        backend=chosen.name if chosen else None,
        variant=chosen.variant if chosen else None,
        llvm_path=str(llvm.path) if llvm else None,
        llvm_version=llvm.version if llvm else None,
        llvm_origin=llvm.origin if llvm else None,
        cuda=bool(chosen and chosen.name == "cuda"),
        problems=problems,
    )


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
