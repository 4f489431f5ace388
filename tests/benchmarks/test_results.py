"""The benchmarks' own arithmetic: ratios, verdicts, JSON, the scatter's scale. Nothing here is timed."""

import importlib
import importlib.util
import inspect
import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import process
from benchmarks.__main__ import MODULES
from benchmarks.cost import exponent
from benchmarks.quality import scatter
from benchmarks.result import BEGIN, END, Result, Target, between, cells, not_run
from benchmarks.turns import Copy, Elsewhere, Turns, take_turns

PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"

# Ours takes 2 and 30 s, theirs 8 and 60 s: ratios 4 and 2. Of the processor: 1, 1 and 5, 7.
TURNS = Turns(np.array([[2.0, 8.0], [30.0, 60.0]]), np.array([[1.0, 5.0], [1.0, 7.0]]))


def test_ratio_is_the_median_over_pairs_in_turns() -> None:
    faster = TURNS.compared("ours", "theirs", unit="s")
    # of the medians it would be 34 / 16
    assert faster.ratio == pytest.approx(3.0)
    assert faster.processor_ratio == pytest.approx(6.0)
    assert (faster.value, faster.baseline_value) == (16.0, 34.0)
    slower = TURNS.compared("ours", "theirs", unit="s", reads="x baseline")
    assert slower.ratio == pytest.approx((0.25 + 0.5) / 2)
    rate = TURNS.rate("ours", "theirs", [6.0, 6.0], "GB/s")
    assert rate.ratio == pytest.approx(3.0)


def test_missed_target_is_reported_as_missed() -> None:
    good = Result("x", 3.0, "s", ratio=2.0, target=Target("ratio", "at least", 2.0))
    bad = Result("x", 3.0, "s", ratio=2.0, target=Target("value", "at most", 2.9))
    assert good.met is True
    assert bad.met is False
    assert "MISSED" in cells(bad)[-1]
    assert "MISSED" not in cells(bad, judged=False)[-1]
    assert not_run("x", "no decoder").met is None


def test_json_has_the_keys_that_the_page_lists() -> None:
    made = json.loads(
        json.dumps(TURNS.compared("a", "b", target=Target("ratio", "at least", 2.0)).to_dict())
    )
    assert made["target"] == {"of": "ratio", "sense": "at least", "limit": 2.0}
    listed = re.search(r"`results`.*?\n\n(.*?)(?:\n\n|\Z)", PAGE.read_text("utf-8"), re.DOTALL)
    assert listed
    assert set(re.findall(r"^\| `(\w+)`", listed[1], re.MULTILINE)) == {"benchmark", *made}


def test_page_keeps_its_text_around_the_tables() -> None:
    page = f"above\n{BEGIN}\nold\n{END}\nbelow\n"
    assert between(page, "new") == f"above\n{BEGIN}\nnew\n{END}\nbelow\n"
    assert between("", "new") == "new"
    assert BEGIN in PAGE.read_text("utf-8")
    assert END in PAGE.read_text("utf-8")


@pytest.mark.parametrize(
    "name", [n for n in MODULES if importlib.util.find_spec(f"benchmarks.{n}")]
)
def test_every_listed_benchmark_can_be_run(name: str) -> None:
    module = importlib.import_module(f"benchmarks.{name}")
    inspect.signature(module.measure).bind(True)


def test_scatter_about_the_local_fit_is_the_noise() -> None:
    y, x = np.mgrid[0:200, 0:200].astype(float)
    smooth = 3.0 + 0.1 * x - 0.2 * y + 1e-3 * (x * x - 2.0 * x * y + 3.0 * y * y)
    inside = (slice(5, -5), slice(5, -5))
    # the fit is exact for a quadratic: 121 terms of 81 numbers up to 100, in float64
    np.testing.assert_allclose(scatter(smooth)[inside], 0.0, atol=1e-10)
    noise = 0.01 * np.random.default_rng(0).standard_normal(y.shape)
    found = np.sqrt(np.mean(scatter(smooth + noise)[inside] ** 2))
    # The mean of n squares of correlation rho varies by 2 sum(rho^2) / n, the root by half of that; the centre's weight in
    # the fit is 0.044, and sum(rho^2) 1.09. Five sigma.
    assert found == pytest.approx(0.01, rel=5.0 * 0.5 * np.sqrt(2.0 * 1.09 / noise[inside].size))


def test_exponent_is_the_power() -> None:
    sizes = [1.0, 10.0, 100.0, 1000.0]
    assert exponent(sizes, [3.0 * n**1.5 for n in sizes]) == pytest.approx(1.5)


def test_copy_copies_everything() -> None:
    copy = Copy(8001)
    copy()
    assert np.array_equal(np.concatenate(copy._to), np.arange(1001))
    assert copy.moved_gb == pytest.approx(2e-9 * 8008)


def test_times_of_another_process_are_used() -> None:
    turns = take_turns([lambda: Elsewhere(5.0, 7.0), lambda: sum(range(100))], 2)
    assert turns.wall_s[:, 0].tolist() == [5.0, 5.0]
    assert turns.processor_s[:, 0].tolist() == [7.0, 7.0]
    assert (turns.wall_s[:, 1] < 5.0).all()


def test_memory_of_a_program_excludes_its_parent() -> None:
    parents = np.ones(40_000_000)  # 320 MB
    used = process.python("-S", "-c", "print('here')")
    assert used.output == "here\n"
    # An interpreter alone takes some 10 MB.
    assert used.peak_mb < 100 < parents.nbytes / 1e6
    with pytest.raises(process.ProgramFailedError, match="status 3"):
        process.python("-c", "raise SystemExit(3)")
