"""Origin of results: versions, machine, times."""

import importlib.metadata
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from evaluation.output.report import Grid, Listing, Section
from fringebench.experiments.noise_summary import describe

STEPS_LISTED = 8
PACKAGES = ("fringebench", "mitsuba", "drjit", "numpy", "OpenEXR")


def provenance(
    toml: str,
    seed: int | str | None,
    seconds: Mapping[str, float],
    light: Mapping[str, Any] | None = None,
) -> Section:
    """Last section of a report: how to repeat it; without a scene if `toml` is empty.

    `light` is `fringebench.experiments.noise_summary.figures`.
    """
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)
    rows = [
        ["made", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")],
        ["seed", "-" if seed is None else str(seed)],
        ["versions", versions],
        [
            "machine",
            f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        ],
    ]
    if light is not None:
        rows.append(["light", describe(light)])
    if len(seconds) > STEPS_LISTED:
        rows.append(["time", f"{sum(seconds.values()):.1f} s in {len(seconds)} steps"])
    elif seconds:
        rows.append(["time", ", ".join(f"{name} {spent:.1f} s" for name, spent in seconds.items())])
    scene = [Listing("The scene as TOML", toml)] if toml else []
    return Section("Provenance", [Grid(["", "value"], rows, words=True), *scene])
