"""Comparison of outside decoders with `decode` on rendered stacks: agreement and errors.

The adapters are in `adapters/` at the top of the repository, each a separate program with its own environment. They read
what `fringebench export` writes, and give projector coordinates and phases. Heights come from the same triangulation for
all decoders, so that only decoding differs.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import decode
import render
import scenes
from decode.phase import wrap
from fringebench.exchange.capture_export import export
from scenes import Emva, GrayBits, GrayCode, PhaseShift, SimpleSensor, Stack, Truth
from scenes.support.errors import FileError, FringebenchError

VARIABLE = "FRINGEBENCH_OUTSIDE_PYTHON"
ADAPTERS = Path(__file__).resolve().parents[1] / "adapters"
OPENCV, FRINGES = "opencv_structured_light", "comimag_fringes"
# An outlier is an error larger than noise can cause in these stacks.
OUTLIER_MM = 0.2
PHASE_RAD = 1e-3
SIZE = (320, 240)

Maps = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class OutsideRow:
    """Result of one decoder on one scene."""

    scene: str
    patterns: str
    decoder: str
    coverage: float
    """Share of lit pixels with an answer."""
    agreement: float
    """Share of pixels valid in both where it agrees with `decode`: the same Gray cell, or a phase within 1e-3 rad."""
    phase_rad: float
    """Median error of the finest wrapped phase, absolute; NaN for Gray code."""
    median_um: float
    """Median absolute height error; NaN if a decoder gives wrapped phases only."""
    outliers: float
    """Share of its answers with an error of more than 0.2 mm."""
    seconds: float
    """Time of decoding; of programs including start, reading and compiling."""


def python() -> str:
    """The interpreter that has the outside decoders; raises `FileError` if none is named."""
    path = os.environ.get(VARIABLE)
    if not path:
        raise FileError(
            f"no outside decoders: set {VARIABLE} to the python of an environment with "
            "opencv-contrib-python-headless and fringes (see docs/outside-decoders.md)"
        )
    return path


def run_adapter(
    name: str, manifest: Path, exposure: int = 0, interpreter: str | None = None
) -> Maps:
    """Maps (row, col) of an adapter for one exposure of an exported stack. Raises `FileError` with its last line if it fails."""
    script = ADAPTERS / f"{name}.py"
    if not script.is_file():
        raise FileError(f"adapter '{script}' does not exist: run from a checkout of the repository")
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "maps.npz"
        command = [interpreter or python(), str(script), str(manifest), str(output), str(exposure)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=900)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise FileError(f"adapter {name} did not run: {error}") from error
        if done.returncode or not output.is_file():
            last = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no output"]
            raise FileError(f"adapter {name} failed: {last[0]}")
        with np.load(output, allow_pickle=False) as maps:
            return {key: maps[key] for key in maps.files}


def compare_with_outside(
    name: str, interpreter: str | None = None, seed: int = 0
) -> list[OutsideRow]:
    """Decode Gray code, three and four steps of a scene with `decode` and an outside decoder; one exposure, 8 bits."""
    plain = scenes.load(name).patterns
    if not isinstance(plain, PhaseShift):
        raise FileError(f"scene '{name}' has no fringes: choose one with phase-shift patterns")
    patterns = PhaseShift(
        steps=4,
        periods_px=plain.periods_px,
        axes=("column", "row"),
        gray=GrayBits(bits=10, cell_px=1.0, flat=True),
    )
    scene = scenes.load(
        name, {"camera.resolution": list(SIZE), "patterns": patterns.model_dump(exclude_none=True)}
    )
    surfaces = render.surfaces(scene)
    transport = render.trace(scene, seed=seed, surfaces=surfaces)
    truth = render.truth(scene, transport, surfaces)
    times = render.expose(transport, noise=False).exposure_ms
    shown: dict[str, Any] = {
        "Gray code": GrayCode(axes=("column", "row"), bits=(10, 10)),
        "4 steps": patterns.model_copy(update={"gray": None, "axes": ("column",)}),
        "3 steps": patterns.model_copy(
            update={
                "gray": None,
                "axes": ("column",),
                "steps": 3,
                "periods_px": patterns.periods_px[:1],
            }
        ),
    }
    rows = []
    for kind, taken in shown.items():
        full = render.expose(
            transport, seed, sensor=eight_bits(scene.sensor), exposures=times, patterns=taken
        )
        stack = _middle(full)
        with tempfile.TemporaryDirectory() as folder:
            manifest = export(stack, folder)
            rows += _rows(name, kind, stack, truth, manifest, interpreter)
    return rows


def eight_bits(sensor: scenes.Sensor) -> scenes.Sensor:
    """The same sensor with an 8-bit converter over the same range of light: the decoders of OpenCV read 8 bits."""
    fewer = 2.0 ** (8 - sensor.bits)
    if isinstance(sensor, SimpleSensor):
        scaled = {
            "responsivity_dn": sensor.responsivity_dn * fewer,
            "sigma_dn": sensor.sigma_dn * fewer,
        }
    else:
        assert isinstance(sensor, Emva)
        scaled = {"gain_dn_per_e": sensor.gain_dn_per_e * fewer}
    black = {"black_level_dn": sensor.black_level_dn * fewer, "bits": 8}
    return sensor.model_copy(update={**scaled, **black})


def _middle(stack: Stack) -> Stack:
    """The median exposure, the shorter of two: outside decoders do not detect clipped samples."""
    at = decode.middle_exposure(stack.exposure_ms, of_two="shorter")
    return replace(
        stack, frames=stack.frames[at : at + 1], exposure_ms=stack.exposure_ms[at : at + 1]
    )


def _rows(
    name: str, kind: str, stack: Stack, truth: Truth, manifest: Path, interpreter: str | None
) -> list[OutsideRow]:
    start = time.perf_counter()
    rec = decode.reconstruct(
        stack,
        height="phase",
        anchor="field" if kind == "4 steps" else None,
        unwrap="quality-guided" if kind == "3 steps" else None,
        axis="column",
    )
    spent = time.perf_counter() - start
    ours: Maps = {"valid": rec.valid, "column_px": np.asarray(rec.column_px)}
    period = stack.patterns[0].period_px
    if kind == "Gray code":
        rows = decode.reconstruct(stack, height="phase", axis="row")
        ours |= {"valid": rec.valid & rows.valid, "row_px": np.asarray(rows.row_px)}
    else:
        ours["phase"] = rec.phases["column"].wrapped_rad
    lit = truth.lit & np.isfinite(truth.height_mm)
    heights = kind != "3 steps"
    mine = np.where(ours["valid"], ours["column_px"], np.nan) if heights else None
    here = _Shown(name, kind, stack, truth, lit)
    found = [here.row("fringebench", ours["valid"], 1.0, ours.get("phase"), mine, spent)]
    adapters = {"Gray code": OPENCV, "3 steps": OPENCV, "4 steps": FRINGES}
    start = time.perf_counter()
    theirs = run_adapter(adapters[kind], manifest, 0, interpreter)
    spent = time.perf_counter() - start
    if kind == "Gray code":
        valid = np.isfinite(theirs["column_px"])
        # Where blur spans two cells, either counts as agreement.
        same = np.hypot(
            np.maximum(np.abs(theirs["column_px"] - ours["column_px"]) - 0.5, 0.0),
            np.maximum(np.abs(theirs["row_px"] - ours["row_px"]) - 0.5, 0.0),
        )
        both = valid & ours["valid"]
        agreement = float((same[both] < 1e-6).mean())
        at_px = theirs["column_px"]
    else:
        phase = theirs[f"phase_column_{period:g}_rad"]
        valid = np.isfinite(phase)
        if kind == "4 steps":
            valid &= theirs[f"modulation_column_{period:g}_dn"] > 0.0
        both = valid & ours["valid"]
        off = np.abs(wrap(phase - ours["phase"]))
        agreement = float((off[both] < PHASE_RAD).mean())
        at_px = theirs.get("column_px", np.full(phase.shape, np.nan))
    decoder = "OpenCV structured_light" if adapters[kind] == OPENCV else "fringes"
    their_phase = None if kind == "Gray code" else phase
    their_px = at_px if heights else None
    found.append(here.row(decoder, valid, agreement, their_phase, their_px, spent))
    return found


@dataclass(frozen=True)
class _Shown:
    """One stack of one scene, and its truth."""

    scene: str
    patterns: str
    stack: Stack
    truth: Truth
    lit: NDArray[np.bool_]

    def row(
        self,
        decoder: str,
        valid: NDArray[np.bool_],
        agreement: float,
        phase_rad: NDArray[Any] | None,
        column_px: NDArray[Any] | None,
        seconds: float,
    ) -> OutsideRow:
        """Score the answer of a decoder on lit pixels."""
        seen = self.lit & valid
        phase = median = outliers = float("nan")
        if phase_rad is not None:
            period = self.stack.patterns[0].period_px
            true = 2.0 * np.pi * self.truth.column_px / period
            phase = float(np.median(np.abs(wrap(phase_rad - true))[seen]))
        if column_px is not None:
            assert self.stack.calibration is not None
            height = decode.triangulate(column_px, self.stack.calibration)
            error = np.abs(height - self.truth.height_mm)[seen]
            error = np.where(np.isfinite(error), error, np.inf)
            median, outliers = float(np.median(error)) * 1e3, float((error > OUTLIER_MM).mean())
        coverage = float(valid[self.lit].mean())
        return OutsideRow(
            self.scene,
            self.patterns,
            decoder,
            coverage,
            agreement,
            phase,
            median,
            outliers,
            seconds,
        )


def table(rows: Sequence[OutsideRow]) -> str:
    """The rows as Markdown."""
    lines = [
        "| scene | patterns | decoder | coverage | agrees with ours | phase error | height error | outliers |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        ours = row.decoder == "fringebench"
        cells = [
            row.scene,
            row.patterns,
            row.decoder,
            f"{row.coverage:.2%}",
            "" if ours else f"{row.agreement:.2%}",
            "" if np.isnan(row.phase_rad) else f"{row.phase_rad * 1e3:.1f} mrad",
            "" if np.isnan(row.median_um) else f"{row.median_um:.1f} µm",
            "" if np.isnan(row.outliers) else f"{row.outliers:.2%}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Print the table of the scenes named on the command line (default bench, step, ink)."""
    names = sys.argv[1:] or ["bench", "step", "ink"]
    try:
        rows = [row for name in names for row in compare_with_outside(name)]
    except FringebenchError as error:
        sys.exit(f"fringebench: {error}")
    sys.stdout.write(table(rows) + "\n" + json.dumps([asdict(row) for row in rows]) + "\n")


if __name__ == "__main__":
    main()
