"""The gate lets an honest decoder through and catches each planted fault, in the case made for it."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import decode
from evaluation.gate.regression import Margins
from fringebench.gate.baseline import Baseline
from fringebench.gate.cases import CASES, Case, shipped_fingerprint, suite
from fringebench.gate.decoders import resolve
from fringebench.gate.regression_gate import SEEDS, regress
from fringebench.pages.regress_page import regress_report
from scenes import Stack
from scenes.support.errors import FileError, OutsideDecoderError
from tests.commands import ROOT, Done, finish, start
from tests.fringebench import faulty_decoders

FAULTY = "tests.fringebench.faulty_decoders"

pytest_plugins = ["pytester"]


@pytest.fixture(scope="module")
def cases() -> tuple[Case, ...]:
    return suite()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "where"),
    [
        ("ignores_saturation", ("sweep", "ratio-1.25", "systematic_mm")),
        ("saturation_a_little_too_high", ("highlight", "highlight", "silent_fraction")),
        ("trusts_everything", ("highlight", "unlit", "silent_fraction")),
        ("shifted_mask", ("grains", "unlit", "silent_fraction")),
        ("swapped_steps", ("ink-solder", "solder", "missing_fraction")),
        ("one_percent_high", ("highlight", "cap", "bias_mm")),
        ("boastful", ("solder", "base", "silent_fraction")),
        ("wrong_orders", ("ink-solder", "base", "wrong_order_fraction")),
    ],
)
def test_planted_fault_is_caught_where_it_shows(
    cases: tuple[Case, ...], fault: str, where: tuple[str, str, str]
) -> None:
    found = regress(f"{FAULTY}:{fault}", cases=cases, seeds=range(500, 508))
    failed = {(row.case, row.region, row.metric): row for row in found.failed}
    assert where in failed
    assert failed[where].comparison.verdict == "worse"
    assert f"{where[0]} / {where[1]}" in found.describe()


# Twenty of them show how often a gate gives false alarms; two show one that is broken.
@pytest.mark.slow
@pytest.mark.parametrize(
    "run", [run if run < 2 else pytest.param(run, marks=pytest.mark.trust) for run in range(20)]
)
def test_honest_decoder_passes_whatever_the_seeds(cases: tuple[Case, ...], run: int) -> None:
    seeds = range(1000 + 16 * run, 1016 + 16 * run)
    found = regress(f"{FAULTY}:honest", cases=cases, seeds=seeds)
    assert found.passed, found.describe()


@pytest.mark.slow
def test_honest_decoder_that_claims_no_sigma_passes(cases: tuple[Case, ...]) -> None:
    found = regress(f"{FAULTY}:without_sigma", cases=cases)
    assert found.passed, found.describe()


def test_biased_decoder_fails_and_its_baseline_stays(
    sweep: tuple[Case, ...], tmp_path: Path
) -> None:
    file = tmp_path / "baseline.json"
    first = regress(faulty_decoders.honest, file, update=True, cases=sweep, seeds=range(4))
    assert first.updated
    before = file.read_text()
    biased = faulty_decoders.one_percent_high
    found = regress(biased, file, update=True, cases=sweep, seeds=range(4))
    assert not found.passed
    assert not found.updated
    assert file.read_text() == before
    bias = next(row for row in found.failed if row.metric == "bias_mm")
    # one percent of the sweep's 2 mm
    assert bias.comparison.difference == pytest.approx(0.02, abs=0.001)


def test_improvement_is_reported_and_stored(sweep: tuple[Case, ...], tmp_path: Path) -> None:
    file = tmp_path / "baseline.json"
    regress(faulty_decoders.one_percent_high, file, update=True, cases=sweep, seeds=range(4))
    found = regress(f"{FAULTY}:honest", file, update=True, cases=sweep, seeds=range(4))
    assert {row.metric for row in found.improved} >= {"bias_mm"}
    assert found.updated
    assert Baseline.read(file).decoder == f"{FAULTY}:honest"


def test_unchanged_decoder_differs_by_nothing_from_a_baseline_of_its_own_seeds(
    sweep: tuple[Case, ...], tmp_path: Path
) -> None:
    """With margins far below the noise of the figures, only the same seeds can show that nothing changed."""
    narrow = Margins(1e-6, 1e-6, 1e-6)
    file = tmp_path / "baseline.json"
    honest = faulty_decoders.honest
    regress(honest, file, update=True, cases=sweep, seeds=range(4))
    same = regress(honest, file, cases=sweep, seeds=range(4), margins=narrow)
    assert same.passed, same.describe()
    compared = {(row.comparison.difference, row.comparison.upper) for row in same.rows}
    assert compared == {(0.0, 0.0)}
    page = regress_report(same, {}).html()
    assert "Passed: none of" in page and "exactly that of the baseline" in page
    other = regress(honest, file, cases=sweep, seeds=range(4, 8), margins=narrow)
    assert {row.metric for row in other.failed} >= {"bias_mm", "systematic_mm"}
    # the answer for programs stays as it was
    assert set(same.to_dict()["rows"][0]["new"]) == {"mean", "standard_error", "repeats"}


@pytest.mark.parametrize(
    ("spec", "named"),
    [
        ("no.such.module:decode", "cannot be imported"),
        (f"{FAULTY}:nothing", "cannot be imported"),
        (f"{FAULTY}:not_callable", "callable"),
        ("just-a-program", "neither"),
        (f"{FAULTY}:raises", "lens cap on"),
        (f"{FAULTY}:of_another_size", r"shape \(3, 3\)"),
        ("no-such-program {stack} {output}", "cannot be run"),
        (f"{sys.executable} -c raise(SystemExit(3)) {{stack}} {{output}}", "status 3"),
        (f"{sys.executable} -c pass {{manifest}} {{output}}", "wrote 0"),
    ],
)
def test_decoder_that_cannot_be_run_is_named(
    sweep: tuple[Case, ...], spec: str, named: str
) -> None:
    with pytest.raises(OutsideDecoderError, match=named):
        regress(spec, cases=sweep, seeds=range(3))


PROGRAM = """
import sys
from dataclasses import replace
import numpy as np, cv2
import decode
from scenes import Stack
from scenes.files.capture import Capture

source, output = sys.argv[1:]
stack = Stack.read(source) if source.endswith(".exr") else Capture.load(source).stack()
rec = decode.reconstruct(stack)
heights = np.where(rec.valid, rec.height_mm, np.nan)
if output.endswith(".npy"):
    np.save(output, np.stack([rec.height_mm, rec.valid, rec.sigma_mm]))
elif output.endswith(".tif"):
    cv2.imwrite(output, heights)
else:
    replace(rec, cause_sigma_mm={"mixed": 2.0 * rec.sigma_mm}).write(output)
"""


def by_cause(stack: Stack) -> decode.Reconstruction:
    """Predicts twice the sensor's noise from another cause."""
    rec = faulty_decoders.honest(stack)
    return replace(rec, cause_sigma_mm={"mixed": 2.0 * rec.sigma_mm})


@pytest.mark.parametrize(
    ("source", "suffix"),
    [
        ("{stack}", ".exr"),
        pytest.param("{manifest}", ".npy", marks=pytest.mark.slow),
        pytest.param("{manifest}", ".tif", marks=pytest.mark.slow),
    ],
)
def test_program_gives_the_heights_a_callable_gives(
    sweep: tuple[Case, ...], tmp_path: Path, source: str, suffix: str
) -> None:
    program = tmp_path / "my decoder.py"
    program.write_text(PROGRAM)
    stack = sweep[0].stack(3)
    theirs = resolve(f"{sys.executable} '{program}' {source} {{output}}{suffix}")(stack)
    ours = resolve(faulty_decoders.honest)(stack)
    np.testing.assert_allclose(theirs.height_mm, ours.height_mm, atol=1e-5)
    assert (theirs.sigma_mm is None) == (suffix == ".tif")
    if suffix == ".exr":
        # The sigma of all causes: the root of 1 + 2^2 times the sensor's.
        for answer in (theirs, resolve(by_cause)(stack)):
            assert answer.sigma_mm is not None and ours.sigma_mm is not None
            np.testing.assert_allclose(answer.sigma_mm, np.sqrt(5.0) * ours.sigma_mm, rtol=1e-5)


def test_unusable_baselines_are_refused(sweep: tuple[Case, ...], tmp_path: Path) -> None:
    with pytest.raises(FileError, match="--update"):
        regress(f"{FAULTY}:honest", tmp_path / "absent.json", cases=sweep)
    with pytest.raises(FileError, match="--baseline"):
        regress(f"{FAULTY}:honest", update=True, cases=sweep)
    broken = tmp_path / "broken.json"
    for text in ("{", "{}", '{"format": "other", "version": 1}', "[]"):
        broken.write_text(text)
        with pytest.raises(FileError, match=r"broken\.json"):
            regress(f"{FAULTY}:honest", broken, cases=sweep)


def test_shipped_baseline_belongs_to_the_shipped_cases() -> None:
    """When a case changes: fringebench regress decode:reconstruct --seeds 0-63 --baseline <a new file> --update."""
    baseline = Baseline.load(None)
    assert set(baseline.figures) == set(CASES)
    assert baseline.suite == shipped_fingerprint()


def test_plugin_fails_a_test_whose_decoder_got_worse(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import pytest
        from fringebench.gate.cases import suite
        from tests.fringebench import faulty_decoders

        @pytest.fixture(scope="session")
        def fringebench_cases():
            return suite(("sweep",))

        def test_honest(fringebench_regress):
            fringebench_regress(faulty_decoders.honest, "baseline.json", seeds=range(4))

        def test_biased(fringebench_regress):
            fringebench_regress(faulty_decoders.one_percent_high, "baseline.json", seeds=range(4))
        """
    )
    options = ["-p", "fringebench.pytest_plugin", "-p", "no:cacheprovider"]
    made = pytester.runpytest_inprocess(*options, "--fringebench-update", "-k", "honest")
    made.assert_outcomes(passed=1)
    checked = pytester.runpytest_inprocess(*options)
    checked.assert_outcomes(passed=1, failed=1)
    checked.stdout.fnmatch_lines(
        ["*got worse than baseline.json*", "*sweep / ratio-0.90: systematic error*: bias*"]
    )


@pytest.mark.slow
def test_command_line_gives_status_and_json() -> None:
    def run(*words: str) -> Done:
        return finish(start("regress", *words, folder=ROOT))

    status, out, err = run("decode:reconstruct", "--json")
    assert status == 0, err
    assert json.loads(out)["passed"] is True
    status, out, _ = run(f"{FAULTY}:ignores_saturation", "--seeds", "0-7")
    assert (status, "highlight / highlight" in out) == (1, True)
    assert run("nonsense")[0] == 2
    assert run("decode:reconstruct", "--seeds", "1")[0] == 2
    assert len(SEEDS) == 16
