"""A data set killed at random times and continued: is it whole, is it the same as one made in one go, is memory flat?

    python -m benchmarks.killed 1000 --kills 6      # some 30 minutes on two cores

Both data sets are made by `fringebench dataset` with two workers. SIGKILL goes to the command and its workers at once, when
a random number of samples is done and up to 2 s later. The same command continues. Then every file of the killed
set is compared with its checksum, its manifest (the checksums of all samples) with that of the undisturbed set, and the
files of 20 random samples byte by byte. Resident memory is read every second. Status 1: the set is not whole or not the same.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fringebench import Dataset
from fringebench.datasets.contents import RECORDS
from fringebench.datasets.manifest import MANIFEST_FILE
from fringebench.datasets.store import STAGING
from fringebench.datasets.verification import verify

WORKERS = 2
COMPARED = 20
# Samples at which memory is given.
MARKS = 10
SMALL = {
    "camera.resolution": "[96,72]",
    "camera.field_width_mm": "4",
    "projectors.0.field_width_mm": "6",
    "patterns.steps": "3",
    "exposures.relative": "[0.5,2]",
    "sampling.samples": "4",
    "board.region": "{size_mm=[4,3]}",
}


@dataclass(frozen=True)
class Reading:
    """Resident memory at one moment of a run."""

    done: int
    command_mb: float
    worker_mb: float
    """Of the largest worker; 0 while there is none."""


def command(folder: Path, count: int) -> list[str]:
    """The command that makes, or continues, the data set."""
    words = [sys.executable, "-m", "fringebench", "dataset", "spi", "--count", str(count)]
    words += ["--workers", str(WORKERS), "--heights", "-o", str(folder)]
    words += ["--format", "webdataset", "--card", "--progress", "none"]
    return words + [w for key, value in SMALL.items() for w in ("--set", f"{key}={value}")]


def run(folder: Path, count: int, kill_at: int | None, wait_s: float) -> list[Reading]:
    """Run the command to its end, or until `wait_s` after `kill_at` samples are done; memory once a second."""
    process = subprocess.Popen(
        command(folder, count), stdout=subprocess.DEVNULL, start_new_session=True
    )
    readings: list[Reading] = []
    while process.poll() is None:
        # Records become the manifest at the end.
        done = len(list((folder / RECORDS).iterdir())) if (folder / RECORDS).is_dir() else 0
        done = max(done, readings[-1].done if readings else 0)
        workers = [resident_mb(pid) for pid in children(process.pid)]
        readings.append(Reading(done, resident_mb(process.pid), max(workers, default=0.0)))
        if kill_at is not None and done >= kill_at:
            time.sleep(wait_s)
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return readings
        time.sleep(1.0)
    if process.returncode:
        raise SystemExit(f"the command ended with status {process.returncode}")
    return readings


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        return [int(c) for task in tasks for c in (task / "children").read_text().split()]
    except OSError:
        return []


def resident_mb(pid: int) -> float:
    """Resident memory of a process, 0 if it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def slope_mb(done: Sequence[int], resident: Sequence[float]) -> float:
    """Growth per 100 samples, without the first tenth, in which libraries are loaded."""
    keep = np.array(done) >= max(done) / 10
    return float(100 * np.polyfit(np.array(done)[keep], np.array(resident)[keep], 1)[0])


def show_memory(readings: Sequence[Reading], count: int) -> None:
    """Memory as a table over samples done."""
    busy = [r for r in readings if r.worker_mb]
    print("\n| samples done | command, MB | largest worker, MB |\n|---|---|---|")
    for mark in np.linspace(count / MARKS, count, MARKS):
        at = min(busy, key=lambda r: abs(r.done - mark))
        print(f"| {at.done} | {at.command_mb:.0f} | {at.worker_mb:.0f} |")
    done = [r.done for r in busy]
    command_mb = slope_mb(done, [r.command_mb for r in busy])
    worker_mb = slope_mb(done, [r.worker_mb for r in busy])
    print(
        f"\nper 100 samples: command {command_mb:+.2f} MB, largest worker {worker_mb:+.2f} MB; "
        f"command at the end, with manifest, shards and card: {readings[-1].command_mb:.0f} MB"
    )


def same(killed: Path, whole: Path, count: int, seed: int) -> list[str]:
    """What is wrong with the killed set."""
    wrong = [f"{problem.file}: {problem.what}" for problem in verify(killed)]
    if len(Dataset(killed)) != count:
        wrong.append(f"{len(Dataset(killed))} samples instead of {count}")
    wrong += [f"left: {path.name}" for path in killed.glob(f"{STAGING}*")]
    if (killed / MANIFEST_FILE).read_bytes() != (whole / MANIFEST_FILE).read_bytes():
        wrong.append("the manifests differ")
    for index in random.Random(seed).sample(range(count), min(COMPARED, count)):
        for path in (whole / f"samples/{index:06d}").iterdir():
            if path.read_bytes() != (killed / path.relative_to(whole)).read_bytes():
                wrong.append(f"{path.relative_to(whole)} differs")
    return wrong


def main() -> int:
    """Make both sets, compare them, print what was seen."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("count", type=int)
    parser.add_argument("--kills", type=int, default=6)
    parser.add_argument(
        "--seed", type=int, default=0, help="of the moments and of the samples compared"
    )
    asked = parser.parse_args()
    draw = random.Random(asked.seed)
    kills = sorted(draw.randrange(1, asked.count) for _ in range(asked.kills))
    with tempfile.TemporaryDirectory() as place:
        killed, whole = Path(place) / "killed", Path(place) / "whole"
        for at in kills:
            seen = run(killed, asked.count, at, draw.uniform(0.0, 2.0))
            left = len(list(killed.glob(f"{STAGING}*")))
            print(f"killed at {seen[-1].done} samples or just after; {left} staging folders left")
        start = time.monotonic()
        run(killed, asked.count, None, 0.0)
        middle = time.monotonic()
        readings = run(whole, asked.count, None, 0.0)
        minutes = (time.monotonic() - middle) / 60
        print(f"last run {middle - start:.0f} s; undisturbed {60 * minutes:.0f} s, ", end="")
        print(f"{asked.count / minutes:.0f} samples/min")
        wrong = same(killed, whole, asked.count, asked.seed)
        show_memory(readings, asked.count)
    print("\n".join(wrong) or f"{asked.kills} kills: whole, and the same as the undisturbed set")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
