"""The comparison end to end, on rendered light: what is promised of the strategies, and the command."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import decode
import render
import scenes
from evaluation.bound import FringeLight, efficiency, phase_bound_rad2
from evaluation.comparison import Comparison, Entry
from fringebench.cli import app
from fringebench.compare import compare
from scenes.errors import ScoreError

RULES = (
    "brightest-unsaturated",
    "max-modulation",
    "radiance-merge",
    "phasor-sum",
    "inverse-variance",
    "masked-least-squares",
    "censored-ml",
)
SMALL = {"camera.resolution": [160, 120], "sampling.samples": 4, "sampling.depth": 1}


def by_name(result: Comparison, budget: str = "equal-time") -> dict[str, Entry]:
    return {e.name: e for e in result.entries if e.budget == budget}


@pytest.fixture(scope="module")
def highlight() -> Comparison:
    """The chapter's trap, whose one exposure becomes a ladder of four, in its own resolution: the disk has 600 pixels."""
    scene = scenes.load("chapter-trap", {"sampling.samples": 4})
    return compare(scene, ["single", *RULES], repeats=5)


@pytest.mark.parametrize("rule", RULES)
def test_hdr_rules_take_away_the_silent_bias_of_the_highlight(
    highlight: Comparison, rule: str
) -> None:
    entries = by_name(highlight)
    single = entries["single"].regions["highlight"]
    region = entries[rule].regions["highlight"]
    assert single.phase_bias_rad is not None and region.phase_bias_rad is not None
    # Clipping by 1.3 at N = 4 errs by some 0.07 rad RMS. What is left is the root of a mean of 600 noisy squares: of 0.03
    # rad noise over 5 repeats, 3 sigma of it are 4e-3 rad.
    assert single.phase_bias_rad > 0.05
    assert region.phase_bias_rad < 0.1 * single.phase_bias_rad
    assert single.systematic_mm is not None and region.systematic_mm is not None
    assert region.systematic_mm < 0.1 * single.systematic_mm
    for label in ("ink", "highlight"):
        coverage = entries[rule].regions[label].figures["coverage"]
        assert coverage is not None and coverage.value >= 0.99


def test_single_exposure_errs_silently_where_it_clips(highlight: Comparison) -> None:
    """The chapter's lesson, or the test above would show nothing: full coverage, and errors beyond the noise."""
    region = by_name(highlight)["single"].regions["highlight"]
    assert region.figures["flagged_fraction"] is not None
    assert region.figures["flagged_fraction"].value == 0.0
    rms, base = region.figures["rms_mm"], by_name(highlight)["single"].regions["base"]
    assert rms is not None and base.figures["rms_mm"] is not None
    assert rms.value > 3.0 * base.figures["rms_mm"].value


@pytest.fixture(scope="module")
def bench() -> render.Transport:
    return render.trace(scenes.load("bench", {**SMALL, "sampling.samples": 16}))


def test_predicted_sigma_is_the_scatter_on_unsaturated_pixels_of_bench(
    bench: render.Transport,
) -> None:
    repeats = 12
    stacks = [render.expose(bench, seed=seed) for seed in range(repeats)]
    sensor = bench.scene.sensor
    # Truncated noise is no Gaussian: pixels with a sample whose mean lies within 5 sigma of saturation are left out.
    # Exposures beyond that are clipped for sure, and rejected.
    quiet = np.ones((120, 160), np.bool_)
    for ms in stacks[0].exposure_ms:
        mean = sensor.mean_dn(bench.frames(), ms)
        away = np.abs(mean - sensor.saturation_dn) / np.sqrt(sensor.variance_dn2(mean, ms))
        quiet &= (away > 5.0).all(axis=0)
    for rule in ("single", *RULES):
        recs = [decode.reconstruct(s, fusion=rule) for s in stacks]
        valid = np.all([r.valid for r in recs], axis=0) & quiet
        assert valid.sum() > 1000
        height = np.stack([r.height_mm[valid] for r in recs]).astype(np.float64)
        sigma2 = np.mean([r.sigma_mm[valid].astype(np.float64) ** 2 for r in recs], axis=0)
        # a wrong fringe order in one repeat is no noise
        same = np.ptp(height, axis=0) < 20.0 * np.sqrt(sigma2)
        assert same.mean() > 0.999
        ratio = np.sqrt(np.mean(height[:, same].var(axis=0, ddof=1) / sigma2[same]))
        # its own scatter: sqrt(1 / (2 x 11 x 1000)) = 0.7 %
        assert abs(ratio - 1.0) < 0.03, rule


def test_weighted_rules_reach_the_bound_on_noise_limited_pixels(bench: render.Transport) -> None:
    """Efficiency at least 0.97 where nothing clips: `bench` at exposures that suit its paint, ink and plate."""
    repeats, times = 12, (0.1, 0.3, 1.0)
    base_ms = render.expose(bench, noise=False).exposure_ms[1]
    times_ms = tuple(t * base_ms for t in times)
    light = FringeLight.of(bench.frames(), bench.scene.frames, "column", 16.0)
    shifts = [f.phase_shift_rad for f in bench.scene.frames if f.period_px == 16.0]
    bound = phase_bound_rad2(light, shifts, times_ms, bench.scene.sensor)
    stacks = [render.expose(bench, seed=s, exposures=times_ms) for s in range(repeats)]
    peak = np.max([s.frames.max(axis=(0, 1)) for s in stacks], axis=0)
    quiet = (peak < 0.9 * stacks[0].saturation_dn) & (bound < 0.1**2)
    reached = {}
    for rule in ("inverse-variance", "masked-least-squares", "censored-ml", "phasor-sum"):
        recs = [decode.reconstruct(s, fusion=rule) for s in stacks]
        off = np.stack([np.where(r.valid, r.wrapped_rad - light.phase_rad, np.nan) for r in recs])
        found = efficiency(off[:, quiet], bound[quiet])
        assert found is not None
        assert found.pixels > 10_000
        reached[rule] = found
    # the interval's half width is 0.6 %
    for rule in ("inverse-variance", "masked-least-squares", "censored-ml"):
        assert reached[rule].value > 0.97, rule
    # shot noise: weights that do not know a step's own noise lose a quarter at full contrast
    assert reached["phasor-sum"].value < 0.85


@pytest.fixture(scope="module")
def everything() -> Comparison:
    return compare(scenes.load("bench", SMALL), repeats=2)


def test_every_strategy_has_both_budgets_at_equal_light_or_frames(everything: Comparison) -> None:
    assert everything.left_out == ()
    names = [e.name for e in everything.entries]
    assert all(names.count(name) == 2 for name in names)
    assert len(set(names)) == 13
    for e in everything.entries:
        if e.budget == "equal-time":
            assert e.exposure_ms == pytest.approx(everything.exposure_ms, rel=1e-9)
        else:
            assert 0.6 * everything.frames <= e.frames <= everything.frames
        assert e.regions.keys() == {"base", "cap", "step", "ink", "solder"}


def test_complementary_and_more_steps_pay_with_phase_bias_of_solder(everything: Comparison) -> None:
    """They let clipping cancel, which leaves less than one exposure does and more than leaving samples out."""
    rows = by_name(everything)
    bias = {name: rows[name].regions["solder"].phase_bias_rad or 0.0 for name in rows}
    assert bias["complementary"] < 0.8 * bias["single"]
    assert bias["more-steps"] < 0.5 * bias["single"]
    assert bias["censored-ml"] < 0.2 * bias["single"]


def test_a_scene_that_cannot_be_decoded_by_a_strategy_lists_why() -> None:
    scene = scenes.load(
        "step", {**SMALL, "exposures": {"times_ms": [1e4]}, "objects.0.material": "grey-paint"}
    )
    with pytest.raises(scenes.errors.DecodeError, match="saturated"):
        compare(scene, ["max-modulation"], repeats=1)


@pytest.mark.parametrize(("names", "repeats"), [(["sngle"], 2), (None, 0)])
def test_impossible_comparisons_are_refused_before_light_is_traced(
    names: list[str] | None, repeats: int
) -> None:
    with pytest.raises(ScoreError):
        compare(scenes.load("bench"), names, repeats)


def test_command_prints_json_and_writes_figures(tmp_path: Path) -> None:
    settings = [f"--set={key}={value}" for key, value in SMALL.items()]
    call = ["compare", "step", "--strategies", "max-modulation,censored-ml", "--repeats", "2"]
    result = CliRunner().invoke(app, [*call, *settings, "--json", "-o", str(tmp_path)])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert json.loads((tmp_path / "compare.json").read_text()) == told
    assert [(s["name"], s["budget"]) for s in told["strategies"]] == [
        (name, budget)
        for budget in ("equal-time", "equal-frames")
        for name in ("max-modulation", "censored-ml")
    ]
    for strategy in told["strategies"]:
        assert strategy["frames"] == told["budgets"]["equal-frames"]
        for region in strategy["regions"].values():
            assert 0.0 < region["efficiency"] < 2.0
            assert region["half_width"]["efficiency"] > 0.0
    for budget in ("equal-time", "equal-frames"):
        assert (tmp_path / f"compare-{budget}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize("name", scenes.shipped())
def test_no_rule_beats_censored_likelihood_on_any_shipped_scene(name: str) -> None:
    columns, rows = scenes.load(name).camera.resolution
    shrink = max(columns / 160, 1.0)
    scene = scenes.load(
        name,
        {"camera.resolution": [int(columns / shrink), int(rows / shrink)], "sampling.samples": 16},
    )
    # The bound is one projector's: of several, pixels differ in which they took.
    scene = scene.model_copy(update={"projectors": scene.projectors[:1]})
    entries = by_name(compare(scene, RULES, repeats=5))
    best = entries.pop("censored-ml")
    judged = 0
    for label, region in best.regions.items():
        if region.efficiency is None or region.efficiency.half_width is None:
            continue
        for rival in entries.values():
            other = rival.regions[label].efficiency
            if other is not None:
                judged += 1
                # the rules decode the same frames: their noise is shared, and the interval is wide for a difference
                assert other.value <= region.efficiency.value + region.efficiency.half_width, (
                    label,
                    rival.name,
                )
    assert judged
