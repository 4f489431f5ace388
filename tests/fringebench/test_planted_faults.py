"""No harmful fault passes `import --check` unless the part of the manifest that is wrong is said not to be verified."""

import random
from itertools import product
from pathlib import Path

import pytest

from tests.fringebench.planted_faults import FAULTS, PATTERNS, Shot, judged, planted

# All cases take five minutes of a processor, so continuous integration runs six of each fault, the nightly suite all.
CASES = list(product(FAULTS, PATTERNS, (True, False)))
SAMPLE = {
    case
    for fault in FAULTS
    for case in random.Random(fault).sample([case for case in CASES if case[0] == fault], 6)
}


@pytest.mark.slow
@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("patterns", PATTERNS)
def test_capture_without_a_fault_passes_without_a_warning(
    tmp_path: Path, patterns: str, calibrated: bool
) -> None:
    found = judged(Shot(PATTERNS[patterns], calibrated), tmp_path)
    assert not found.harmful
    assert found.report is not None
    assert {f.verdict for f in found.report.findings} <= {"ok", "unknown"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "patterns", "calibrated"),
    [pytest.param(*case, marks=[] if case in SAMPLE else pytest.mark.trust) for case in CASES],
)
def test_harmful_fault_is_refused_or_its_part_is_named(
    tmp_path: Path, fault: str, patterns: str, calibrated: bool
) -> None:
    shot = planted(0, patterns, fault, calibrated)
    if shot is not None:
        assert not judged(shot, tmp_path).silent(FAULTS[fault][0])


@pytest.mark.slow
@pytest.mark.parametrize("patterns", ["three periods, both axes", "cell is a period, both axes"])
def test_both_axes_and_a_calibration_leave_nothing_unverified(
    tmp_path: Path, patterns: str
) -> None:
    found = judged(Shot(PATTERNS[patterns]), tmp_path)
    assert found.report is not None
    # Of the coarsest fringes, less than one is in view.
    assert set(found.report.not_verified) <= {"brightness of the source", "gamma"}
