"""Files against NumPy's own: run `python -m benchmarks.exr`.

What the scene `bench` gives (12 frames of 3 exposures with their noise, the light, the truth) is written and read with every
lossless codec of OpenEXR (among the others: with the three that matter). Samples a second, all channels together; baseline `np.savez`, which compresses nothing. All
writers wait until the disk has the file. Besides: frames a band of rows at a time, as stacks go; and `np.savez_compressed`.
"""

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

import render
import scenes
from benchmarks.result import Result, main
from benchmarks.turns import Work, take_turns
from scenes.acquisition.sensor import Emva
from scenes.files import exr, exr_rows

# PXR24 drops 8 of a float's bits: exact for counts, not for light and lengths. DWA and B44 are lossy by design.
ALL = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "ZSTD", "HTJ2K32", "HTJ2K256")
LOSSY = {("light", "PXR24"), ("truth", "PXR24")}
# Codecs that `Stack`, `Transport` and `Truth` use.
OURS = {"12-bit frames": "PIZ", "8-bit frames": "PIZ", "light": "ZIP", "truth": "ZIP"}
# 12 bits of the same sensor become 8: a sixteenth of the gain.
COARSE = Emva(bits=8, gain_dn_per_e=Emva().gain_dn_per_e / 16, black_level_dn=4.0)

Arrays = Mapping[str, NDArray[Any]]


def contents(folder: Path, quick: bool) -> dict[str, tuple[Arrays, Arrays]]:
    """Channels as they are stored in files, and as arrays for NumPy."""
    size = [320, 240] if quick else [800, 600]
    scene = scenes.load("bench", {"camera.resolution": size, "sampling.samples": 4})
    light = render.trace(scene)
    fine = render.expose(light)
    coarse = render.expose(light, sensor=COARSE, exposures=fine.exposure_ms)
    found: dict[str, tuple[Arrays, Arrays]] = {}
    for name, thing in (
        ("12-bit frames", fine),
        ("8-bit frames", coarse),
        ("light", light),
        ("truth", render.truth(scene, light)),
    ):
        thing.write(folder / "a.exr")
        channels, _ = exr.load(folder / "a.exr")
        arrays = {"frames": thing.frames} if isinstance(thing, scenes.Stack) else channels
        found[name] = channels, arrays
    return found


def _numpy(save: Callable[..., None], path: Path, arrays: Arrays) -> Work:
    def work() -> None:
        with path.open("wb") as file:
            save(file, **arrays)
            file.flush()
            os.fsync(file.fileno())

    return work


def _load(path: Path) -> None:
    with np.load(path, allow_pickle=False) as stored:
        for name in stored:
            stored[name]


def _read_bands(path: Path) -> None:
    with exr_rows.reading(path, "measured") as bands:
        for _ in bands:
            pass


def _codec(name: str) -> dict[str, Any]:
    return {"compression": getattr(OpenEXR, f"{name}_COMPRESSION")}


def _compare(
    folder: Path, content: str, channels: Arrays, arrays: Arrays, codecs: Sequence[str], quick: bool
) -> list[Result]:
    ours = OURS[content]
    codecs = [c for c in codecs if hasattr(OpenEXR, f"{c}_COMPRESSION")]
    codecs = [c for c in codecs if (content, c) not in LOSSY]
    names = ["np.savez", *codecs, f"{ours} by bands", "np.savez_compressed"]
    paths = [folder / f"{i}.{'npz' if n.startswith('np') else 'exr'}" for i, n in enumerate(names)]

    def exr_work(codec: str, path: Path) -> Work:
        return lambda: exr.write(path, "measured", channels, {}, _codec(codec))

    writes = [
        _numpy(np.savez, paths[0], arrays),
        *(exr_work(c, p) for c, p in zip(codecs, paths[1:], strict=False)),
        lambda: exr_rows.write(paths[-2], "measured", channels, {}, _codec(ours)),
        _numpy(np.savez_compressed, paths[-1], arrays),
    ]
    reads: list[Work] = [lambda: _load(paths[0])]
    reads += [lambda path=path: exr.load(path) for path in paths[1:-2]]  # type: ignore[misc]
    reads += [lambda: _read_bands(paths[-2]), lambda: _load(paths[-1])]
    written = take_turns(writes, 1 if quick else 3, warm=False)
    for path in paths[1:-1]:
        back, _ = exr.load(path)
        assert all(np.array_equal(back[n], p, equal_nan=True) for n, p in channels.items()), path
    taken = take_turns(reads, 1 if quick else 3)
    amounts = [1e-6 * sum(plane.size for plane in channels.values())] * len(names)
    sizes = [1e-6 * path.stat().st_size for path in paths]
    results = []
    for i, name in enumerate(names[1:], 1):
        for what, turns in (("write", written), ("read", taken)):
            results.append(
                turns.rate(f"{content}, {name}: {what}", "np.savez", amounts, "Msample/s", i, 0)
            )
        results.append(
            Result(
                f"{content}, {name}: size",
                sizes[i],
                "MB",
                "np.savez",
                sizes[0],
                sizes[i] / sizes[0],
                note="what is written" if name == f"{ours} by bands" else "",
            )
        )
    return results


def measure(quick: bool, codecs: Sequence[str] = ("ZIP", "PIZ", "ZSTD")) -> list[Result]:
    """Codecs on every kind of file; `quick`: small files, and only the codecs in use."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        return [
            result
            for content, (channels, arrays) in contents(folder, quick).items()
            for result in _compare(
                folder, content, channels, arrays, (OURS[content],) if quick else codecs, quick
            )
        ]


if __name__ == "__main__":
    raise SystemExit(main("Files", __doc__, lambda quick: measure(quick, ALL)))
