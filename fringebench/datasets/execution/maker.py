"""Versions and kind of processor, which decide the last bits of a rendered sample."""

import importlib.metadata
import platform
from pathlib import Path

from scenes.support import backend

# Packages that draw, mesh, trace or compress.
PACKAGES = (
    "fringebench",
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "shapely",
    "trimesh",
    "OpenEXR",
    "pillow",
)
# Dr.Jit and Embree have code for each; reciprocals, fused multiply-adds and reductions round differently.
VECTORS = ("avx512f", "avx2", "avx", "sse4_2")


def made_with() -> dict[str, str]:
    """Name -> version of everything that decides bytes here. Raises `BackendError` where nothing can render."""
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    return versions | {"variant": backend.select().variant, "processor": processor()}


def processor() -> str:
    """The machine's architecture and widest vectors: ``x86_64 avx2``."""
    try:
        flags = set(Path("/proc/cpuinfo").read_text("utf-8").split())
    except OSError:
        flags = set()
    widest = next((name for name in VECTORS if name in flags), "")
    return f"{platform.machine()} {widest}".strip()
