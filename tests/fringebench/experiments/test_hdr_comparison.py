"""The comparison end to end, on rendered light: what is promised of the strategies, and the command."""

import json
from pathlib import Path

import numpy as np
import pytest

import decode
import render
import scenes
from evaluation.hdr.capture_strategies import BUILT_IN
from evaluation.hdr.coding_strategies import CODINGS
from evaluation.hdr.comparison import StrategyComparison, StrategyResult
from evaluation.hdr.projector_plans import PROJECTOR
from evaluation.theory.cramer_rao import FringeLight, efficiency, phase_bound_rad2
from fringebench import verbs
from fringebench.experiments.hdr_comparison import compare
from scenes.acquisition.sensor import without_blur
from scenes.support.errors import DecodeError, ScoreError
from tests.conftest import Call

# All but those of one exposure for every pixel.
RULES = [rule for rule in decode.rules() if rule not in ("single", "auto-exposure")]
# So small an image has fringes of few pixels: the camera's blur would take their contrast.
SMALL = {
    "camera.resolution": [160, 120],
    "sampling.samples": 4,
    "sampling.depth": 1,
    "sensor.psf": "none",
}


def by_name(result: StrategyComparison, budget: str = "equal-time") -> dict[str, StrategyResult]:
    return {e.name: e for e in result.entries if e.budget == budget}


@pytest.fixture(scope="module")
def highlight() -> StrategyComparison:
    """The chapter's trap, whose one exposure becomes a ladder of four, in its own resolution: the disk has 600 pixels."""
    scene = scenes.load("chapter-trap", {"sampling.samples": 4})
    return compare(scene, ["single", *RULES], repeats=5)


@pytest.mark.parametrize("rule", RULES)
def test_hdr_rules_remove_the_silent_bias_of_the_highlight(
    highlight: StrategyComparison, rule: str
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


def test_single_exposure_errs_silently_where_it_clips(highlight: StrategyComparison) -> None:
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


@pytest.mark.slow
def test_predicted_sigma_is_the_scatter_on_unsaturated_pixels_of_bench(
    bench: render.Transport,
) -> None:
    repeats = 12
    stacks = [render.expose(bench, seed=seed) for seed in range(repeats)]
    sensor = bench.scene.sensor
    # Truncated noise is no Gaussian: pixels with a sample whose mean is within 5 sigma of saturation are left out.
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
    seen = render.through_lens(bench).frames()
    light = FringeLight.of(seen, bench.scene.frames, "column", 16.0)
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
def everything() -> StrategyComparison:
    names = [s.name for s in (*BUILT_IN, *PROJECTOR[:2])]  # The others need two projectors.
    return compare(scenes.load("bench", SMALL), names, repeats=2)


@pytest.mark.slow
def test_every_strategy_has_both_budgets_at_equal_light_or_frames(
    everything: StrategyComparison,
) -> None:
    assert everything.left_out == ()
    names = [e.name for e in everything.entries]
    assert all(names.count(name) == 2 for name in names)
    assert len(set(names)) == len(BUILT_IN) + 2
    for e in everything.entries:
        limit = everything.limits[e.budget]
        if e.budget == "equal-time":
            assert e.exposure_ms == pytest.approx(limit, rel=1e-9)
        else:
            assert 0.6 * limit <= e.frames <= limit
        assert e.regions.keys() == {"base", "cap", "step", "ink", "solder"}


@pytest.mark.slow
def test_strategies_that_let_clipping_cancel_leave_phase_bias_on_solder(
    everything: StrategyComparison,
) -> None:
    """2N steps and more leave less than one exposure does; all leave more than leaving samples out."""
    rows = by_name(everything)
    bias = {name: rows[name].regions["solder"].phase_bias_rad or 0.0 for name in rows}
    assert bias["2n-step"] < 0.8 * bias["single"]
    assert bias["censored-ml"] < 0.2 * bias["complementary"]
    assert bias["more-steps"] < 0.5 * bias["single"]
    assert bias["censored-ml"] < 0.2 * bias["single"]


@pytest.mark.slow
def test_mask_keeps_its_pixels_below_saturation_at_the_longest_exposure(
    everything: StrategyComparison,
) -> None:
    """Paint that the longest exposure clips eightfold is covered, next to black ink that needs that exposure."""
    masked = by_name(everything)["adaptive-projection"]
    for label in ("base", "ink"):
        covered, reached = (
            masked.regions[label].figures["coverage"],
            masked.regions[label].efficiency,
        )
        assert covered is not None and covered.value > 0.95
        # Relative to its own light, whose phase the mask may have moved: noise alone.
        assert reached is not None and reached.value > 0.9


@pytest.mark.slow
def test_another_projector_sees_what_the_first_does_not() -> None:
    """Four projectors for a quarter of the light each, or one for all of it: shadows and glints differ."""
    small = {"camera.resolution": [160, 120], "sampling.samples": 16, "sampling.depth": 1}
    scene = scenes.load("spi-four", small)
    rows = by_name(compare(scene, ["one-projector", "every-projector"], 2, budgets=["equal-time"]))
    one, every = (rows[name] for name in ("one-projector", "every-projector"))
    assert one.exposure_ms == pytest.approx(every.exposure_ms)
    more = []
    for label in one.regions:
        less, all_seen = (e.regions[label].figures["coverage"] for e in (one, every))
        if less is not None and all_seen is not None:
            more.append(all_seen.value - less.value)
    assert min(more) >= 0.0
    assert max(more) > 0.05


def test_strategy_that_fails_is_listed_with_its_reason() -> None:
    scene = scenes.load(
        "step", {**SMALL, "exposures": {"times_ms": [1e4]}, "objects.0.material": "grey-paint"}
    )
    with pytest.raises(DecodeError, match="saturated"):
        compare(scene, ["max-modulation"], repeats=1)


@pytest.mark.parametrize(("names", "repeats"), [(["sngle"], 2), (None, 0)])
def test_invalid_comparison_is_refused_before_light_is_traced(
    names: list[str] | None, repeats: int
) -> None:
    with pytest.raises(ScoreError):
        compare(scenes.load("bench"), names, repeats)


def test_command_prints_json_and_writes_figures(call: Call, tmp_path: Path) -> None:
    # Four exposures of all frames, the shortest far below the limit in a quarter of the cycle: that does not fit.
    changed = {**SMALL, "acquisition.min_exposure_ms": 0.1}
    settings = [f"--set={key}={value}" for key, value in changed.items()]
    words = (
        "--strategies max-modulation,single --budget equal-frames,cycle-time --repeats 2 --pareto"
    )
    status, out, err = call("compare", "step", *words.split(), *settings, "--json", "-o", tmp_path)
    assert status == 0, err
    answer = json.loads(out)
    assert json.loads((tmp_path / "compare.json").read_text()) == answer
    assert [(s["name"], s["budget"]) for s in answer["strategies"]] == [
        (name, budget)
        for budget in ("equal-frames", "cycle-time")
        for name in ("max-modulation", "single")
    ]
    for strategy in answer["strategies"]:
        named = {"name", "budget", "frames", "exposure_ms", "cycle_ms", "regions"}
        assert named <= strategy.keys()
        spent = {"equal-frames": strategy["frames"], "cycle-time": strategy["cycle_ms"]}
        allowed = answer["budgets"][strategy["budget"]]
        assert spent[strategy["budget"]] <= allowed * (1.0 + 1e-9)
        for region in strategy["regions"].values():
            assert 0.0 < region["efficiency"] < 2.0
            assert region["half_width"]["efficiency"] > 0.0
    swept = {(p["name"], p["share"]) for p in answer["pareto"]}
    left_out = {(item["name"], item["budget"]) for item in answer["left_out"]}
    shares = (0.25, 0.5, 1.0, 2.0, 4.0)
    for name in ("max-modulation", "single"):
        for share in shares:
            at = "cycle-time" if share == 1.0 else f"cycle-time x {share:g}"
            assert ((name, share) in swept) != ((name, at) in left_out)
    assert {name for name, _ in left_out} == {"max-modulation"}
    for name in ("equal-frames", "cycle-time", "pareto"):
        assert (tmp_path / f"compare-{name}.png").read_bytes().startswith(b"\x89PNG")


def test_unknown_budget_is_refused_with_a_hint(call: Call) -> None:
    status, _, err = call("compare", "step", "--budget", "cycle-tme")
    assert (status, "did you mean 'cycle-time'" in err) == (2, True)


def test_whole_decoder_is_compared_as_the_rule_that_it_wraps() -> None:
    def mine(stack: scenes.Stack) -> decode.Reconstruction:
        return decode.reconstruct(stack, fusion="max-modulation")

    scene = scenes.load("step", SMALL)
    found = by_name(verbs.compare(scene, ["max-modulation"], 2, decoders=[mine]))
    name = next(name for name in found if name.endswith("mine"))
    for label, region in found["max-modulation"].regions.items():
        assert found[name].regions[label].rms_mm == pytest.approx(region.rms_mm, rel=1e-6)


@pytest.mark.slow
def test_codings_are_compared_with_intervals_from_one_trace() -> None:
    """On a plate without indirect light every coding finds the heights, within the noise that it predicts."""
    scene = scenes.load("step", {**SMALL, "sampling.samples": 16})
    found = compare(scene, [s.name for s in CODINGS], 3, budgets=["equal-time"])
    assert {e.name for e in found.entries} == {s.name for s in CODINGS}
    for entry in found.entries:
        base = entry.regions["base"]
        coverage, rms = base.figures["coverage"], base.figures["rms_mm"]
        # A camera pixel is 5.5 projector px wide here: the XOR code's cells of 4 px are not resolved everywhere.
        expected = 0.5 if entry.name == "xor-gray-code" else 0.98
        assert coverage is not None and coverage.value > expected, entry.name
        assert rms is not None and rms.half_width is not None
        # Three repeats of some 10 000 pixels: the ratio's own scatter is 1 %, and pixels near edges add to it.
        assert base.sigma_ratio == pytest.approx(1.0, abs=0.1), entry.name


@pytest.mark.slow
# `stereo` shows no fringes, a screen's are no strategy's.
@pytest.mark.parametrize(
    "name",
    [name for name in scenes.shipped() if name != "stereo" and not scenes.load(name).screens],
)
def test_no_rule_beats_censored_likelihood_on_any_shipped_scene(name: str) -> None:
    columns, rows = scenes.load(name).camera.resolution
    shrink = max(columns / 160, 1.0)
    scene = scenes.load(
        name,
        {"camera.resolution": [int(columns / shrink), int(rows / shrink)], "sampling.samples": 16},
    )
    # The bound is one projector's: of several, pixels differ in which they took.
    sharp = without_blur(scene.sensor)  # as in SMALL
    scene = scene.model_copy(update={"projectors": scene.projectors[:1], "sensor": sharp})
    entries = by_name(compare(scene, RULES, repeats=5))
    best = entries.pop("censored-ml")
    judged = 0
    for label, region in best.regions.items():
        reached = region.efficiency
        if reached is None or reached.half_width is None:
            continue
        for rival in entries.values():
            other = rival.regions[label].efficiency
            if other is not None:
                judged += 1
                # the rules decode the same frames: their noise is shared, and the interval is wide for a difference
                assert other.value <= reached.value + reached.half_width, (label, rival.name)
    assert judged
