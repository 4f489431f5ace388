"""The first sentence of a page names the result, where it is and how large."""

from dataclasses import replace

import evaluation
from evaluation.scoring.score_result import RegionScore, UnlitScore
from fringebench.experiments.textbook import ChapterResult, ChapterRow
from fringebench.pages.headlines import chapter_headline, run_headline


def scored(**ratios: float) -> evaluation.Score:
    """A score whose regions have RMS errors of that many times a predicted micrometre."""
    regions = {label: _region(ratio * 1e-3) for label, ratio in ratios.items()}
    return evaluation.Score("s", regions, {}, UnlitScore(0, 0))


def _region(rms_mm: float) -> RegionScore:
    known = {"rms_mm": rms_mm, "predicted_sd_mm": 1e-3}
    unknown = dict.fromkeys(set(RegionScore.__dataclass_fields__) - set(known))
    return RegionScore(**unknown | known)  # type: ignore[arg-type]


def test_accurate_run_is_good() -> None:
    found = run_headline(scored(base=1.0, ink=1.2), scored(base=1.0, ink=1.2), 3)
    assert found.tone == "good"
    assert "at most 1.2 × predicted" in found.text


def test_silent_error_of_the_naive_decoder_is_named() -> None:
    found = run_headline(scored(base=1.0, solder=1.2), scored(base=1.0, solder=10.0), 3)
    assert found.tone == "attention"
    assert "solder has an RMS error of 10 µm, 10 × predicted, without a warning" in found.text


def test_worst_regions_of_a_bad_run_come_first() -> None:
    score = scored(a=2.0, b=9.0, c=3.0, d=1.0)
    found = run_headline(score, score, 1)
    assert found.tone == "bad"
    assert found.text.index("b has") < found.text.index("c has")
    assert "1 more region exceeds" in found.text
    assert "without a warning" not in found.text


def test_chapter_names_the_figure_farthest_from_theory() -> None:
    row = ChapterRow("near", 1.0, 1.0, 1.001, "")
    found = chapter_headline(ChapterResult((row, replace(row, name="far", measured=1.2))))
    assert found.tone == "attention"
    assert "20 %, of far" in found.text
