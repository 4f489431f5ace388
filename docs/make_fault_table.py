"""How many planted faults `fringebench import --check` refuses: the table of docs/import.md.

    python docs/make_fault_table.py [SEEDS]

Each fault is planted in captures of 13 codes, with and without a calibration, SEEDS times (1) with other numbers.
"""

import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

from tests.fringebench.planted_faults import FAULTS, PATTERNS, judged, planted

Case = tuple[int, str, str, bool]
HEAD = """\
| planted fault | with a calibration: harmful, refused, named | without: harmful, refused, named |
|---|---|---|"""


def outcome(case: Case) -> str:
    """What became of one capture."""
    seed, patterns, fault, calibrated = case
    shot = planted(seed, patterns, fault, calibrated)
    if shot is None:
        return ""
    with tempfile.TemporaryDirectory() as folder:
        found = judged(shot, Path(folder))
    if not found.harmful:
        return "harmless"
    if found.refused:
        return "refused"
    return "silent" if found.silent(FAULTS[fault][0]) else "named"


def main(seeds: int = 1) -> None:
    """Print one row for each fault."""
    cases = list(product(range(seeds), PATTERNS, FAULTS, (True, False)))
    counts: Counter[tuple[str, bool, str]] = Counter()
    with ProcessPoolExecutor() as pool:
        for case, result in zip(cases, pool.map(outcome, cases, chunksize=8), strict=True):
            counts[case[2], case[3], result] += 1
            if result == "silent":
                print("silent:", case, file=sys.stderr)
    print(HEAD)
    for fault in FAULTS:
        cells = []
        for calibrated in (True, False):
            by = {r: counts[fault, calibrated, r] for r in ("refused", "named", "silent")}
            cells.append(f"{sum(by.values())}, {by['refused']}, {by['named']}")
        print(f"| {fault} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
