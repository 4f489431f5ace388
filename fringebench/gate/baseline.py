"""Figures of an earlier run, as a JSON file, with its error maps in a file next to it."""

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from evaluation.gate.regression import Figures
from fringebench.gate.error_maps import ErrorMaps
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError
from scenes.support.safe_parse import parse_json
from scenes.support.validation_words import in_words

VERSION = 2
FORMAT = "fringebench-baseline"
# A baseline with more than half of its regions mostly missing guards nothing.
MISSING = 0.5


@dataclass(frozen=True)
class Baseline:
    """Figures of an earlier run, by case.

    Parameters
    ----------
    decoder
        What was run.
    suite
        Fingerprint of the cases.
    figures
        Case -> region -> metric -> estimate.
    seeds
        Seeds of the noise; empty where they are not known.
    maps
        Case -> error maps, where they are known.
    """

    decoder: str
    suite: str
    figures: dict[str, Figures]
    seeds: tuple[int, ...] = ()
    maps: Mapping[str, ErrorMaps] = field(default_factory=dict, repr=False, compare=False)

    def write(self, path: str | Path) -> None:
        """Write the figures as JSON, and the maps as ``<path>.maps.npz``, each atomically."""
        tree = {
            "format": FORMAT,
            "version": VERSION,
            "decoder": self.decoder,
            "suite": self.suite,
            "seeds": list(self.seeds),
        }
        lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in tree.items()]
        cases = [
            f"  {json.dumps(case)}: {{\n" + ",\n".join(_region_lines(regions)) + "\n  }"
            for case, regions in self.figures.items()
        ]
        lines.append(' "figures": {\n' + ",\n".join(cases) + "\n }")
        with replacing(path) as temporary:
            temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")
        if self.maps:
            packed = io.BytesIO()
            arrays = {
                f"{case}/{name}": values
                for case, maps in self.maps.items()
                for name, values in maps.to_arrays().items()
            }
            np.savez_compressed(packed, allow_pickle=False, **arrays)
            with replacing(maps_path(path)) as temporary:
                temporary.write_bytes(packed.getvalue())

    @classmethod
    def read(cls, path: Path) -> "Baseline":
        """Read a baseline and, where they are, its maps; `FileError` for anything but a whole baseline of this version."""
        try:
            tree = parse_json(path.read_text("utf-8"))
            if tree["format"] != FORMAT or tree["version"] != VERSION:
                raise FileError(
                    f"baseline '{path}' has format {tree['format']} {tree['version']}, not {FORMAT} {VERSION}: make it again "
                    "with --update and a new file"
                )
            figures = TypeAdapter(dict[str, Figures]).validate_python(tree["figures"])
            seeds = tuple(int(seed) for seed in tree.get("seeds", ()))
            decoder, suite = str(tree["decoder"]), str(tree["suite"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileError(f"baseline '{path}' cannot be read: {in_words(error)}") from error
        return cls(decoder, suite, figures, seeds, _read_maps(maps_path(path)))

    @classmethod
    def load(cls, path: Path | None) -> "Baseline":
        """The baseline of a file; None: the one shipped, of our own decoder."""
        if path is not None:
            if not path.is_file():
                raise FileError(f"baseline '{path}' does not exist: make it with --update")
            return cls.read(path)
        shipped = resources.files("fringebench.gate") / "baselines" / "default.json"
        with resources.as_file(shipped) as file:
            return cls.read(file)


def maps_path(path: str | Path) -> Path:
    """File of the error maps of a baseline."""
    return Path(f"{path}.maps.npz")


def mostly_missing(figures: Mapping[str, Figures]) -> list[tuple[str, str, float]]:
    """Regions (case, region, share missing) in which more than half of the pixels are missing."""
    return [
        (case, region, metrics["missing_fraction"].mean)
        for case, regions in figures.items()
        for region, metrics in regions.items()
        if "missing_fraction" in metrics and metrics["missing_fraction"].mean > MISSING
    ]


def _region_lines(regions: Figures) -> list[str]:
    """Regions as JSON, one line a figure."""
    return [
        f"   {json.dumps(region)}: {{\n"
        + ",\n".join(
            f"    {json.dumps(metric)}: {json.dumps(asdict(estimate), allow_nan=False)}"
            for metric, estimate in metrics.items()
        )
        + "\n   }"
        for region, metrics in regions.items()
    ]


def _read_maps(path: Path) -> dict[str, ErrorMaps]:
    """Maps by case; empty where there is no file, or none that can be read: they only illustrate."""
    found: dict[str, dict[str, Any]] = {}
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as arrays:
            for key in arrays.files:
                case, _, name = key.rpartition("/")
                found.setdefault(case, {})[name] = arrays[key]
        return {case: ErrorMaps.from_arrays(arrays) for case, arrays in found.items()}
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
        return {}
