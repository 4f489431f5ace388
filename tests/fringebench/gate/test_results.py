"""What a run of the gate leaves behind: words, JUnit, annotations, history, baselines, pages."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import decode
import render
import scenes
from evaluation.gate.equivalence import EquivalenceTest, Estimate, Verdict
from evaluation.gate.regression import JudgedFigure
from fringebench.gate.baseline import Baseline, maps_path
from fringebench.gate.cached_light import chosen_folder, light_of
from fringebench.gate.cases import Case, plane_stack, suite
from fringebench.gate.ci_formats import (
    append_history,
    github_annotations,
    read_history,
    write_junit,
)
from fringebench.gate.decoders import resolve
from fringebench.gate.error_maps import ErrorMaps
from fringebench.gate.regression_gate import regress
from fringebench.gate.regression_result import Regression
from fringebench.gate.wording import sentence
from fringebench.pages.regress_page import regress_report
from scenes.support.errors import FileError, OutsideDecoderError, SceneError
from tests.commands import finish, start
from tests.conftest import Call
from tests.fringebench import faulty_decoders

SEEDS = range(4)


@pytest.fixture(scope="module")
def biased(sweep: tuple[Case, ...], tmp_path_factory: pytest.TempPathFactory) -> Regression:
    """A decoder that is 1 % high in a corner of the image, compared with itself without that fault."""
    file = tmp_path_factory.mktemp("gate") / "baseline.json"
    regress(faulty_decoders.honest, file, update=True, cases=sweep, seeds=SEEDS)
    return regress(corner_high, file, cases=sweep, seeds=SEEDS)


def corner_high(stack: scenes.Stack) -> faulty_decoders.Heights:
    height, valid, sigma = faulty_decoders.parts(faulty_decoders.honest(stack))
    height = height.copy()
    height[:10, :60] += 20.0
    return height, valid, sigma


def test_failure_is_described_in_words_with_its_place(biased: Regression) -> None:
    """One line a region; an error is named before the claims of sigma that fail with it."""
    [line] = biased.describe().splitlines()
    # 10 rows of 16, and 60 columns of 240: 15.6 %
    assert line.startswith(
        "sweep / ratio-0.90: wrong fringe orders: 0.00 % -> 15.62 %, worse by 15.62 %, 0.50 % allowed; rows 0 to 9, columns"
    )
    others = line.split("; failed too: ")[1].split(", ")
    assert "silent" in others
    assert len(others) == len(biased.failed) - 1


@pytest.mark.parametrize(
    ("verdict", "said"),
    [
        ("worse", "worse by 2.00 µm, 5.00 µm allowed"),
        ("undecided", "may be worse by up to 7.00 µm, 5.00 µm allowed: give more seeds"),
        ("same", "same by 2.00 µm"),
        ("better", "better by 2.00 µm"),
    ],
)
def test_sentence_says_the_verdict_and_only_an_undecided_one_asks_for_seeds(
    verdict: Verdict, said: str
) -> None:
    old, new = Estimate(0.001, 0.0, 4), Estimate(0.003, 0.0, 4)
    test = EquivalenceTest(0.002, -0.003, 0.007, 0.005, verdict)
    words = sentence(JudgedFigure("sweep", "cap", "bias_mm", new, old, test))
    assert words == f"sweep / cap: mean error: 1.00 µm -> 3.00 µm, {said}"


def test_junit_has_a_case_for_each_figure_and_a_failure_for_each_that_failed(
    biased: Regression, tmp_path: Path
) -> None:
    write_junit(biased, tmp_path / "gate.xml")
    root = ET.parse(tmp_path / "gate.xml").getroot()
    cases = root.findall("./testsuite/testcase")
    assert len(cases) == len(biased.rows) == int(root.attrib["tests"])
    failures = root.findall("./testsuite/testcase/failure")
    assert len(failures) == len(biased.failed) == int(root.attrib["failures"])
    assert any("rows 0 to 9" in failure.attrib["message"] for failure in failures)


def test_annotations_escape_what_github_reads_as_markup(biased: Regression) -> None:
    [line] = github_annotations(biased)
    assert line.startswith("::error title=sweep / ratio-0.90::sweep / ratio-0.90: wrong")
    assert "\n" not in line and " %," not in line


def test_history_grows_by_a_line_a_run_and_refuses_other_files(
    biased: Regression, tmp_path: Path
) -> None:
    file = tmp_path / "history.jsonl"
    append_history(biased, file)
    runs = append_history(biased, file)
    assert runs == read_history(file)
    assert len(file.read_text().splitlines()) == 2
    figure = runs[-1]["figures"]["sweep"]["ratio-0.90"]["wrong_order_fraction"]
    assert figure == pytest.approx(10 * 60 / (16 * 240))
    other = tmp_path / "other.json"
    other.write_text('{"format": "fringebench-baseline"}\n')
    with pytest.raises(FileError, match="no history"):
        append_history(biased, other)
    assert other.read_text() == '{"format": "fringebench-baseline"}\n'


def test_page_shows_the_failed_case_next_to_the_baseline_s(
    biased: Regression, tmp_path: Path
) -> None:
    assert set(biased.baseline_maps) == {"sweep"}
    runs = [append_history(biased, tmp_path / "history.jsonl") for _ in range(2)][-1]
    html = regress_report(biased, {"decode": 1.0}, runs).html()
    assert "left now, right the baseline" in html
    # The verdict is the first sentence, with the place; the figures of all regions come last.
    headline = html.split('<p class="headline bad">')[1].split("</p>")[0]
    assert "wrong fringe orders: 0.00 % -&gt; 15.62 %" in headline
    assert "rows 0 to 9" in headline
    assert "✗ 0.00 → 15.62" in html
    assert "<td>0, 1, 2, 3</td>" in html
    assert "History" in html
    # The corner's wrong pixels come with what the camera saw there: 2 exposures of 8 frames.
    worst = biased.worst[0]
    assert worst.row < 10
    assert worst.col < 60
    assert worst.error_mm == pytest.approx(20.0, abs=0.5)
    assert np.shape(worst.counts_dn) == (2, 8)
    seen = suite(("sweep",))[0].stack(SEEDS[0]).frames[:, :, worst.row, worst.col]
    np.testing.assert_array_equal(worst.counts_dn, seen)
    assert f"{worst.row}, {worst.col}" in html
    assert " ".join(f"{dn}" for dn in seen[0]) in html
    assert json.loads(json.dumps(biased.to_dict()))["worst_pixels"][0]["row"] == worst.row


def test_cached_light_equals_traced_light(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = {"camera.resolution": [40, 30], "sampling.samples": 4}
    scene = scenes.load("step", small)
    made = light_of(scene, tmp_path / "cache")
    fresh = light_of(scene, None)
    files = sorted((tmp_path / "cache").iterdir())
    assert len(files) == 2
    files[1].write_bytes(b"damaged")
    again = light_of(scene, tmp_path / "cache")
    monkeypatch.setattr(render, "trace", None)
    kept = light_of(scene, tmp_path / "cache")
    for light, truth in (made, again, kept):
        np.testing.assert_array_equal(light.total, fresh[0].total)
        np.testing.assert_array_equal(light.ambient, fresh[0].ambient)
        np.testing.assert_array_equal(truth.height_mm, fresh[1].height_mm)
        np.testing.assert_array_equal(truth.lit, fresh[1].lit)
        assert light.scene == scene
    with pytest.raises(TypeError, match="not callable"):
        light_of(scenes.load("step", small | {"vibration_um": 1.0}), tmp_path / "cache")
    monkeypatch.setenv("FRINGEBENCH_CACHE", "there")
    assert chosen_folder(None) == Path("there")
    assert chosen_folder("here") == Path("here")


def test_maps_are_means_over_the_repeats_in_which_a_pixel_is_valid(sweep: tuple[Case, ...]) -> None:
    (case,) = sweep
    repeats = np.stack([case.height_mm + 0.25, case.height_mm + 0.25, case.height_mm + 0.75])
    seen, never = (5, 5), (6, 6)
    assert np.isfinite(case.height_mm[[5, 6], [5, 6]]).all()
    repeats[:2, *seen] = np.nan
    repeats[:, *never] = np.nan
    maps = ErrorMaps.of(case, repeats, np.full(repeats.shape, 0.1))
    assert maps.error_mm[7, 7] == pytest.approx((0.25 + 0.25 + 0.75) / 3)
    assert maps.error_mm[seen] == pytest.approx(0.75)
    assert np.isnan(maps.error_mm[never])
    assert maps.missing[seen] == pytest.approx(2 / 3) and maps.missing[never] == 1.0
    # Five claimed sigmas are 0.5 mm.
    assert maps.silent[7, 7] == pytest.approx(1 / 3) and maps.silent[never] == 0.0


def test_maps_are_stored_next_to_a_baseline_and_damaged_ones_are_ignored(
    sweep: tuple[Case, ...], tmp_path: Path
) -> None:
    file = tmp_path / "baseline.json"
    regress(faulty_decoders.honest, file, update=True, cases=sweep, seeds=SEEDS)
    maps = Baseline.read(file).maps["sweep"]
    assert maps.error_mm.shape == sweep[0].height_mm.shape
    # The mean of four repeats of noise of 0.02 mm.
    assert np.nanstd(maps.error_mm) < 0.02
    maps_path(file).write_bytes(maps_path(file).read_bytes()[:1000])
    assert Baseline.read(file).maps == {}


def test_baseline_of_missing_regions_is_stored_only_by_force(
    sweep: tuple[Case, ...], tmp_path: Path
) -> None:
    file = tmp_path / "baseline.json"

    def blind(stack: scenes.Stack) -> np.ndarray:
        return np.full(stack.frames.shape[2:], np.nan)

    with pytest.raises(
        FileError, match=r"(?s)guards nothing.*--force.*ratio-1\.75: 100 % missing|ratio-1\.75"
    ):
        regress(blind, file, update=True, cases=sweep, seeds=SEEDS)
    assert not file.exists()
    assert regress(blind, file, update=True, force=True, cases=sweep, seeds=SEEDS).updated


def test_baseline_of_other_cases_is_refused(sweep: tuple[Case, ...], tmp_path: Path) -> None:
    file = tmp_path / "baseline.json"
    regress(faulty_decoders.honest, file, update=True, cases=sweep, seeds=SEEDS)
    tree = json.loads(file.read_text())
    file.write_text(json.dumps(tree | {"suite": "0" * 16}))
    with pytest.raises(FileError, match="other cases"):
        regress(faulty_decoders.honest, file, cases=sweep, seeds=SEEDS)
    file.write_text(json.dumps(tree | {"figures": {"mine": tree["figures"]["sweep"]}}))
    with pytest.raises(FileError, match="has no case sweep"):
        regress(faulty_decoders.honest, file, cases=sweep, seeds=SEEDS)
    file.write_text(json.dumps(tree | {"version": 1}))
    with pytest.raises(FileError, match="make it again"):
        regress(faulty_decoders.honest, file, cases=sweep, seeds=SEEDS)


def mine(patterns: Mapping[str, object], name: str = "mine") -> scenes.Scene:
    """A small rig of the user's own."""
    keys: dict[str, object] = {"camera.resolution": [96, 72], "sampling.samples": 4}
    scene = scenes.load("step", keys)
    tree = scene.model_dump(mode="json") | {"name": name, "patterns": dict(patterns)}
    return scenes.Scene.model_validate(tree)


GRAY = {"kind": "gray-code", "bits": [10], "axes": ["column"]}
HETERODYNE = {"kind": "phase-shift", "steps": 3, "periods_px": [16.0, 17.0, 19.0]}
BOTH = {"kind": "phase-shift", "steps": 4, "periods_px": [18.0, 144.0], "axes": ["column", "row"]}


@pytest.mark.parametrize(
    "patterns", [GRAY, HETERODYNE, BOTH], ids=["gray", "heterodyne", "both axes"]
)
def test_formula_stack_of_any_patterns_is_decoded(patterns: Mapping[str, object]) -> None:
    stack = plane_stack(mine(patterns))
    assert stack.frames.shape[2:] == (72, 96)
    answer = resolve(decode.reconstruct)(stack)
    middle = sum(stack.calibration.height_range_mm) / 2.0 if stack.calibration else 0.0
    # A Gray code resolves a projector pixel, some 0.1 mm of height here; an order would be off by millimetres.
    assert np.nanmedian(np.abs(answer.height_mm - middle)) < 0.5
    assert np.isfinite(answer.height_mm).mean() > 0.5


@pytest.mark.slow
def test_own_scene_is_judged_against_our_decoder(tmp_path: Path) -> None:
    scene = mine(BOTH)
    good = regress("decode:reconstruct", scenes=[scene], seeds=range(3))
    assert good.passed and good.baseline == "decode:reconstruct"
    bad = regress(faulty_decoders.one_percent_high, scenes=[scene], seeds=range(3))
    assert {row.case for row in bad.failed} == {"mine"}
    file = tmp_path / "mine.json"
    assert regress("decode:reconstruct", file, scenes=[scene], update=True, seeds=range(3)).updated
    with pytest.raises(FileError, match="other cases"):
        regress("decode:reconstruct", file, scenes=[mine(GRAY)], seeds=range(3))


def test_baseline_with_missing_regions_is_not_stored_in_silence(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A region that is mostly missing may be as it should be, or a decoder that does not see it: the user decides."""
    empty = {"missing_fraction": Estimate(0.8, 0.0, 3)}
    figures = {"sweep": {"ratio-0.90": empty, "ratio-1.10": {}, "ratio-1.25": {}}}
    stored = Regression("my:decoder", "base.json (new)", (0, 1, 2), (), figures, updated=True)
    monkeypatch.setattr("fringebench.gate.regression_gate.regress", lambda *_, **__: stored)
    file = tmp_path / "base.json"
    status, said, _ = call("regress", "my:decoder", "--baseline", file, "--update")
    assert status == 0
    assert "warning: 80 % of the pixels of sweep / ratio-0.90 are missing" in said


def test_two_scenes_of_one_name_are_refused() -> None:
    with pytest.raises(SceneError, match="'mine'"):
        regress(faulty_decoders.honest, scenes=[mine(BOTH), mine(GRAY)], seeds=SEEDS)


@pytest.mark.parametrize("fault", ["raises", "of_another_size"])
def test_decoder_that_cannot_work_fails_before_anything_is_rendered(
    fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("render.trace", lambda *_, **__: pytest.fail("a scene was rendered"))
    with pytest.raises(OutsideDecoderError, match="first try"):
        regress(getattr(faulty_decoders, fault))


def test_decoder_that_cannot_start_ends_with_status_two_in_seconds(tmp_path: Path) -> None:
    before = os.times()
    status, _, err = finish(start("regress", "no.such.module:decode", folder=tmp_path))
    assert (status, "cannot be imported" in err) == (2, True)
    # Processor time, which a loaded machine does not stretch.
    after = os.times()
    spent = after.children_user - before.children_user
    assert spent + after.children_system - before.children_system < 10.0
