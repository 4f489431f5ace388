"""Mutation testing: do the tests notice small changes of numerical code?

    python -m tests.mutation --count 200 --seed 1           a random sample over all rooms
    python -m tests.mutation --module evaluation/gate --count 50
    python -m tests.mutation --record                       record again which tests execute which lines

Each change is made in a copy of the repository, where tests that execute the changed line are run, the nearest first, until one
fails; then the slow tests near it that continuous integration runs. Which tests execute a line is recorded once, by one run of
the quick suite, to a file outside the repository; test files that the record does not know yet come first, if they are near. Of a
line that more tests execute than run in a minute and a half, some of every file are chosen, and one left out may notice: run the
room's tests before writing another. What survives is listed, unless ``harmless.toml`` says why it changes nothing. Exit status 1 if more
than 5 % survive without a reason.
"""

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from pathlib import Path

from tests.mutation.mutants import Mutant, mutants
from tests.mutation.recorder import FOLDER, Record, merged
from tests.mutation.trials import NOTICED, ROOT, outcomes

HARMLESS = Path(__file__).with_name("harmless.toml")
RECORD = Path.home() / ".cache" / "fringebench" / "mutation.json"
# Where numbers are made or read: no pages, no plots, no command line.
MODULES = (
    "scenes/acquisition", "scenes/board", "scenes/files", "scenes/labels", "scenes/rig", "scenes/shapes",
    "scenes/scene.py", "scenes/scene_meshes.py", "scenes/support/distribution.py",
    "render", "decode",
    "evaluation/gate", "evaluation/hdr", "evaluation/inspection", "evaluation/scoring", "evaluation/theory",
    "evaluation/output/cloud.py", "evaluation/output/height_image.py",
    "fringebench/datasets", "fringebench/exchange", "fringebench/experiments", "fringebench/gate",
)  # fmt: skip
ALLOWED = 0.05


def main() -> int:
    """Run a sample and list the survivors."""
    parser = argparse.ArgumentParser(description="Mutation testing of the numerical modules.")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="mutants tried at a time")
    parser.add_argument(
        "--module", action="append", help="folder, file or file:line; default: all numerical ones"
    )
    parser.add_argument("--quick", action="store_true", help="leave out the slow tests")
    parser.add_argument("--record", action="store_true", help="only record what tests execute")
    parser.add_argument("--list", action="store_true", help="only list what would be changed")
    chosen = parser.parse_args()
    if chosen.record or not (chosen.list or RECORD.is_file()):
        record(chosen.jobs)
        if chosen.record:
            return 0
    sample = sampled(ROOT, chosen.module, chosen.count, chosen.seed)
    if chosen.list:
        for path, mutant in sample:
            print(said(path, mutant, (ROOT / path).read_text("utf-8")))
        return 0
    known: Record = json.loads(RECORD.read_text("utf-8"))
    reasons = {
        (entry["file"], entry["after"]): entry["reason"]
        for entry in tomllib.loads(HARMLESS.read_text("utf-8"))["harmless"]
    }
    counted: Counter[str] = Counter()
    for i, (path, mutant, source, outcome, spent_s) in enumerate(
        outcomes(sample, known, chosen.jobs, chosen.quick)
    ):
        reason = reasons.get((path, mutant.described(source)[1]), "")
        why = f" ({reason})" if reason and outcome not in NOTICED else ""
        said_outcome = "harmless" if why else outcome
        counted[said_outcome] += 1
        print(
            f"{i + 1}/{len(sample)} {said_outcome}{why}: {said(path, mutant, source)}  [{spent_s:.0f} s]",
            flush=True,
        )
    survived = sum(
        count for outcome, count in counted.items() if outcome not in (*NOTICED, "harmless")
    )
    share = survived / max(len(sample), 1)
    print(", ".join(f"{count} {outcome}" for outcome, count in counted.most_common()))
    print(
        f"{survived} of {len(sample)} survived without a stated reason ({share:.1%}; {ALLOWED:.0%} allowed)"
    )
    return int(share > ALLOWED)


def record(jobs: int) -> None:
    """Run the quick suite once and keep which tests execute which lines."""
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        words = ["-q", "-n", str(jobs), "-p", "tests.mutation.recorder", "-p", "no:cacheprovider"]
        subprocess.run(
            [sys.executable, "-m", "pytest", *words],
            cwd=ROOT,
            check=False,
            env={**os.environ, FOLDER: folder, "PYTHONPATH": str(ROOT)},
        )
        RECORD.parent.mkdir(parents=True, exist_ok=True)
        RECORD.write_text(json.dumps(merged(Path(folder), ROOT)), "utf-8")


def said(path: str, mutant: Mutant, source: str) -> str:
    """A mutant in words."""
    before, after = mutant.described(source)
    return f"{path}:{mutant.line}: {before}  ->  {after}"


def sampled(
    root: Path, chosen: list[str] | None, count: int, seed: int
) -> list[tuple[str, Mutant]]:
    """A random sample of the mutants of the chosen modules."""
    lines = {tuple(name.split(":")) for name in chosen or () if ":" in name}
    pool = [
        (path, mutant)
        for path in modules([name.partition(":")[0] for name in chosen or MODULES], root)
        for mutant in mutants((root / path).read_text("utf-8"))
        if not lines or (path, str(mutant.line)) in lines
    ]
    return random.Random(seed).sample(pool, min(count, len(pool)))


def modules(chosen: list[str] | tuple[str, ...], root: Path = ROOT) -> list[str]:
    """Files of the chosen folders, relative to the repository."""
    found = set()
    for name in chosen:
        place = root / name
        files = [place] if place.is_file() else place.rglob("*.py")
        found |= {str(file.relative_to(root)) for file in files if file.name != "__init__.py"}
    return sorted(found)


if __name__ == "__main__":
    sys.exit(main())
