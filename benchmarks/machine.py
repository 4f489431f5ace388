"""The machine that the numbers were measured on."""

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

from scenes.support import backend

PACKAGES = (
    "fringebench",
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "OpenEXR",
)


def describe() -> dict[str, Any]:
    """The machine as plain data for JSON."""
    chosen = backend.select()
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "usable_cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": _system(),
        "python": platform.python_version(),
        "packages": {name: importlib.metadata.version(name) for name in PACKAGES},
        "variant": chosen.variant,
        "llvm": chosen.llvm.version if chosen.llvm else None,
        "device": _device() if chosen.name == "cuda" else None,
    }


def load() -> float:
    """Number of runnable programs, averaged over the last minute."""
    return round(os.getloadavg()[0], 2)


def sentence(machine: dict[str, Any]) -> str:
    """The machine in one paragraph."""
    packages = ", ".join(f"{name} {version}" for name, version in machine["packages"].items())
    device = f", {machine['device']}" if machine["device"] else ""
    return (
        f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gb']} GB{device}; {machine['system']}; "
        f"Python {machine['python']}, {packages}; {machine['variant']}, LLVM {machine['llvm']}"
    )


def _processor() -> str:
    """Name of the processor, with family and model: virtual machines may give a generic name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    found = {
        key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)
    }
    if "model name" not in found:
        return platform.machine()
    return f"{found['model name']} (family {found.get('cpu family')}, model {found.get('model')})"


def _system() -> str:
    try:
        name = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        name = f"{platform.system()} {platform.release()}"
    return f"{name}, {platform.machine()}"


def _device() -> str:
    """Name of the CUDA device."""
    try:
        found = subprocess.run(
            ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"],
            capture_output=True, text=True, check=True, timeout=30,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return "a CUDA device"
    return found.stdout.splitlines()[0].strip()
