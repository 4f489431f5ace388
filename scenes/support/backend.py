"""Chooses between CUDA and LLVM, and finds an LLVM that works.

Dr.Jit loads LLVM when it is first imported, from ``DRJIT_LIBLLVM_PATH`` if that is set; later changes have no effect. By
default it takes the system's, and LLVM 14 and 15 abort the whole process on AVX-512 machines ("Cannot select: fminimum").
So `select` decides before drjit is imported; if drjit was imported before, it checks what was loaded.
"""

import ctypes
import importlib.metadata
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenes.support.errors import BackendError

VARIABLE = "DRJIT_LIBLLVM_PATH"
WANTED = "FRINGEBENCH_BACKEND"
MIN_LLVM = 16
PACKAGE = "karellen-llvm-core"


@dataclass(frozen=True)
class Llvm:
    """An LLVM library and who chose it."""

    path: Path
    version: int
    """Major version; 0 if unknown."""
    origin: str
    """user, environment or system."""


@dataclass(frozen=True)
class Backend:
    """What light transport and decoding are computed on."""

    name: str
    """cuda or llvm."""
    variant: str
    """Mitsuba's variant."""
    llvm: Llvm | None
    """The LLVM in use, or available besides CUDA."""


def find_llvm() -> Llvm | None:
    """The LLVM to use: the user's, else the environment's, else a system one of at least version 16."""
    chosen = os.environ.get(VARIABLE)
    if chosen:
        return Llvm(Path(chosen), version_of(Path(chosen)), "user")
    for path in _of_environment():
        return Llvm(path, version_of(path), "environment")
    usable = [Llvm(path, version_of(path), "system") for path in _of_system()]
    usable = [llvm for llvm in usable if llvm.version >= MIN_LLVM]
    return max(usable, key=lambda llvm: llvm.version, default=None)


def select() -> Backend:
    """Choose CUDA where there is a device, else LLVM, and prepare the process; call it before drjit or mitsuba is
    imported.

    ``FRINGEBENCH_BACKEND`` (llvm or cuda) overrides this. Raises `BackendError`, which says what to install, or to
    import first.
    """
    wanted = os.environ.get(WANTED) or None
    if wanted not in (None, "llvm", "cuda"):
        raise BackendError(f"{WANTED} is '{wanted}': set it to llvm or cuda, or unset it")
    llvm = find_llvm()
    if llvm and llvm.origin == "user" and not llvm.path.is_file():
        raise BackendError(
            f"{VARIABLE} is '{llvm.path}', which does not exist: point it at libLLVM.so, or unset it"
        )
    if llvm and 0 < llvm.version < MIN_LLVM:
        raise BackendError(
            f"{VARIABLE} is '{llvm.path}', LLVM {llvm.version}: Dr.Jit needs {MIN_LLVM} or newer "
            "(older ones abort on AVX-512 machines); point it at a newer one, or unset it"
        )
    early = "drjit" in sys.modules
    if not early:
        # A path that does not exist keeps Dr.Jit from searching the system and finding an LLVM that aborts.
        os.environ[VARIABLE] = str(llvm.path) if llvm else os.devnull
    try:
        import drjit
    except ImportError as error:
        raise BackendError(
            f"drjit cannot be loaded ({error}): it needs the system's libatomic.so.1 (Debian: libatomic1)"
        ) from error
    if wanted != "llvm" and drjit.has_backend(drjit.JitBackend.CUDA):
        return Backend("cuda", "cuda_ad_mono", llvm)
    if wanted == "cuda":
        raise BackendError(
            f"{WANTED} is 'cuda', but Dr.Jit finds no CUDA device (an NVIDIA card and its driver): unset it to use the processor"
        )
    loaded = _loaded_version(drjit)
    if loaded >= MIN_LLVM:
        return Backend("llvm", "llvm_ad_mono", llvm)
    if llvm and (early or loaded):
        raise BackendError(
            f"drjit or mitsuba was imported first, and loaded {f'LLVM {loaded}' if loaded else 'no LLVM'}, where "
            f"{MIN_LLVM} or newer is needed (older ones abort on AVX-512 machines); it loads one once only: import render before "
            f"drjit and mitsuba, or start Python with {VARIABLE}={llvm.path}"
        )
    raise BackendError(
        f"no {'' if wanted else 'CUDA device and no '}LLVM of version {MIN_LLVM} or newer: "
        + (
            f"pip install {PACKAGE}==22.1.8"
            if sys.platform == "linux"
            else "install LLVM (macOS: brew install llvm)"
        )
        + f", or set {VARIABLE} to a libLLVM"
    )


def _loaded_version(drjit: Any) -> int:
    """Major version of the LLVM that Dr.Jit has loaded; 0 for none."""
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        return 0
    return int(drjit.detail.llvm_version()[0])


def version_of(path: Path) -> int:
    """Major version of an LLVM library, from its name, else from the library itself; 0 if unknown."""
    named = re.search(r"LLVM(?:-|\.so\.|\.)(\d+)", path.resolve().name)
    if named:
        return int(named[1])
    try:
        major = ctypes.c_uint()
        ctypes.CDLL(str(path)).LLVMGetVersion(ctypes.byref(major), None, None)
        return major.value
    except (OSError, AttributeError):
        # LLVMGetVersion came with LLVM 16: a library without it is older, or no LLVM at all.
        return 0


def _of_environment() -> list[Path]:
    found = [Path(sys.prefix) / "lib" / name for name in ("libLLVM.so", "libLLVM.dylib")]
    try:
        listed = importlib.metadata.files(PACKAGE) or []
        found += [Path(str(f.locate())) for f in listed if f.name.startswith("libLLVM.")]
    except importlib.metadata.PackageNotFoundError:
        pass
    return [path for path in found if path.is_file()]


def _of_system() -> list[Path]:
    folders = [
        "/usr/lib/x86_64-linux-gnu",
        "/usr/lib/aarch64-linux-gnu",
        "/usr/lib64",
        "/usr/lib",
        "/opt/homebrew/opt/llvm/lib",
        "/usr/local/opt/llvm/lib",
    ]
    found = [p for folder in folders for p in sorted(Path(folder).glob("libLLVM*")) if p.is_file()]
    found += sorted(Path("/usr/lib").glob("llvm-*/lib/libLLVM*"))
    return [path for path in found if re.search(r"\.(so|dylib)", path.name)]
