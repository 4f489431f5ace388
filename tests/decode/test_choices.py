"""Regions of interest, fusion rules, projectors, and refusals of bad choices."""

from dataclasses import replace
from importlib.metadata import EntryPoint, EntryPoints
from typing import Any

import numpy as np
import pytest

import decode
from decode.fusion import interface, registry
from decode.phase.n_step import Phasor
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.devices import LookAt
from scenes.support.errors import DecodeError
from tests.decode.synthetic import calibrated_stack, digitise, hills, rig

PATTERNS = PhaseShift(periods_px=(16.0, 80.0))
FIELDS = ("height_mm", "sigma_mm", "modulation_dn", "offset_dn", "wrapped_rad", "fringe_order")


@pytest.fixture(scope="module")
def stack() -> Stack:
    return calibrated_stack(rig(), hills(), PATTERNS, sigma_dn=1.0, dtype=np.uint16)


def disc() -> np.ndarray:
    y, x = np.mgrid[:48, :64]
    return np.asarray((x - 30) ** 2 + (y - 20) ** 2 < 150)


@pytest.mark.parametrize("unwrap", ["temporal", "row-scan", "quality-guided"])
@pytest.mark.parametrize(
    "roi", [(3, 17, 5, 50), (47, 48, 63, 64), disc()], ids=["box", "one", "disc"]
)
def test_region_of_interest_has_the_full_decodes_values(
    stack: Stack, roi: Any, unwrap: Any
) -> None:
    full = decode.reconstruct(stack, unwrap=unwrap)
    part = decode.reconstruct(stack, unwrap=unwrap, roi=roi)
    inside = np.zeros((48, 64), bool)
    inside[roi if isinstance(roi, np.ndarray) else np.s_[roi[0] : roi[1], roi[2] : roi[3]]] = True
    for name in (*FIELDS, "reason", "exposure"):
        assert np.array_equal(getattr(part, name)[inside], getattr(full, name)[inside]), name
    assert (part.reason[~inside] == decode.Reason.OUTSIDE_ROI).all()
    assert np.isnan(part.height_mm[~inside]).all()
    assert part.reason_fractions()["ok"] == full.valid[inside].mean()


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"roi": (5, 5, 0, 10)}, "is empty or leaves the image: rows are 0 to 48"),
        ({"roi": (0, 49, 0, 10)}, "is empty or leaves"),
        ({"roi": np.zeros((48, 64), bool)}, "mask is empty"),
        ({"roi": np.ones((4, 4), bool)}, r"give booleans of shape \(48, 64\)"),
        ({"roi": "all"}, "give \\(row0"),
        ({"roi": (0.5, 10, 0, 10)}, "in whole pixels"),
        ({"fusion": "max-modulaton"}, "did you mean 'max-modulation'"),
        ({"fussion": "single"}, "unknown option 'fussion': did you mean 'fusion'"),
        ({"unwrap": "spacial"}, "unwrap is 'spacial'"),
        ({"height": "triangulate"}, "did you mean 'triangulation'"),
        ({"axis": "row"}, "no row fringes: it has \\['column'\\]"),
        ({"projector": 3}, "no fringes of projector 3"),
        ({"fusion": "single", "exposure": 1}, "exposure 1 does not exist"),
        ({"exposure": 0}, "use fusion='single'"),
        ({"min_modulation_dn": -1}, "use 0 or more"),
        ({"min_modulation_dn": 200}, "no pixel could be decoded \\(dark 100.0%\\)"),
        ({"height_range_mm": (3, 1)}, "lowest and the highest"),
        ({"height_range_mm": (50, 60)}, "no pixel could be decoded"),
        ({"max_order_residual": 0.7}, "at most 0.5"),
        ({"height": "linear", "c_px_per_mm": 0.0}, "not 0"),
        ({"backend": "metal"}, "backend is 'metal'"),
        ({"fusion": "single", "exposure": 1.0}, "exposure is 1.0: give a whole number"),
        ({"projector": "first"}, "projector is 'first': give a whole number"),
        ({"min_modulation_dn": "20"}, "min_modulation_dn is '20': give a number"),
        ({"min_relative_modulation": [0.1]}, "give a number"),
        ({"c_px_per_mm": "4"}, "c_px_per_mm is '4': give a number"),
        ({"gamma": [2.2]}, "give a number, or 'estimate'"),
        ({"gamma": np.float32(9.0)}, "use 0.2 to 5"),
        ({"known_point": (10, 20, np.nan)}, "give row, column and height in mm"),
        ({"known_point": (10, 20)}, "give row, column and height in mm"),
        ({"height_range_mm": 3.0}, "lowest and the highest"),
    ],
)
def test_impossible_choices_are_refused_with_the_way_out(
    stack: Stack, choices: dict[str, Any], said: str
) -> None:
    with pytest.raises(DecodeError, match=said):
        decode.reconstruct(stack, **choices)


def test_uncalibrated_stack_is_refused_with_what_it_lacks(stack: Stack) -> None:
    bare = replace(stack, calibration=None)
    with pytest.raises(DecodeError, match="no calibration: give it one, or c_px_per_mm"):
        decode.reconstruct(bare)
    for kind in ("triangulation", "linear", "reference-plane"):
        with pytest.raises(DecodeError, match="calibration"):
            decode.reconstruct(bare, height=kind)


def test_black_and_white_stacks_are_errors_not_empty_successes() -> None:
    for level, cause in ((0, "shadow 100.0%"), (255, "saturated 100.0%")):
        counts = np.full((1, 8, 48, 64), level, np.uint8)
        stack = Stack(counts, PATTERNS.frames(), (1.0,), SimpleSensor(), rig())
        with pytest.raises(DecodeError, match=cause):
            decode.reconstruct(stack)


def exposures(times: tuple[float, ...], albedo: np.ndarray) -> Stack:
    made = calibrated_stack(rig(), hills(), PATTERNS, offset=60 * albedo, modulation=50 * albedo)
    rng = np.random.default_rng(3)
    counts = [digitise(made.frames[0] * t, 1.0, np.uint8, rng) for t in times]
    return replace(
        made, frames=np.stack(counts), exposure_ms=times, sensor=SimpleSensor(sigma_dn=1.0)
    )


def test_max_modulation_takes_the_brightest_unsaturated_exposure_in_any_order() -> None:
    albedo = np.ones((48, 64))
    albedo[:, 32:] = 0.2
    for times in ((1.0, 2.0, 8.0), (8.0, 1.0, 2.0)):
        rec = decode.reconstruct(exposures(times, albedo))
        assert rec.valid.all()
        assert (np.take(times, rec.exposure[:, :32]) == 2.0).all()
        assert (np.take(times, rec.exposure[:, 32:]) == 8.0).all()


def test_pixels_saturated_in_every_exposure_are_flagged_and_keep_the_shortest() -> None:
    albedo = np.ones((48, 64))
    albedo[:8, :8] = 6.0
    rec = decode.reconstruct(exposures((2.0, 1.0), albedo))
    assert (rec.exposure[:8, :8] == 1).all()
    flagged = rec.reason == decode.Reason.SATURATED
    assert flagged[:8, :8].any()
    assert not flagged[8:].any()


def test_single_takes_the_middle_exposure_or_the_one_named() -> None:
    stack = exposures((4.0, 0.5, 1.0), np.ones((48, 64)))
    assert (decode.reconstruct(stack, fusion="single").exposure == 2).all()
    assert (decode.reconstruct(stack, fusion="single", exposure=1).exposure == 1).all()


class Sum(interface.FusionRule):
    """A stranger's rule: the sum of all exposures' phasors."""

    def fuse(self, samples: interface.Samples) -> Phasor:
        parts = [samples.phasor(k) for k in samples.by_time]
        total = parts[0]
        for part in parts[1:]:
            total = replace(total, cosine=total.cosine + part.cosine, sine=total.sine + part.sine)
        return replace(total, exposure=samples.device.types.UInt32(interface.MERGED))


def test_rules_of_other_packages_are_found_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = [
        EntryPoint("sum", f"{__name__}:Sum", registry.ENTRY_POINT_GROUP),
        EntryPoint("broken", "no_such_package:Rule", registry.ENTRY_POINT_GROUP),
        EntryPoint("alien", "builtins:dict", registry.ENTRY_POINT_GROUP),
    ]
    monkeypatch.setattr(
        registry, "entry_points", lambda group: EntryPoints(mine).select(group=group)
    )
    monkeypatch.setattr(EntryPoint, "load", lambda self: {"sum": Sum, "alien": dict}[self.name])
    assert set(decode.rules()) == {*registry.RULES, "sum", "broken", "alien"}
    rec = decode.reconstruct(exposures((1.0, 2.0), np.ones((48, 64))), fusion="sum")
    assert (rec.exposure == interface.MERGED).all()
    assert (np.abs(rec.modulation_dn - 150) < 10).all()
    with pytest.raises(DecodeError, match=r"'broken' .* cannot be loaded"):
        registry.rule("broken")
    with pytest.raises(DecodeError, match="gives a dict"):
        registry.rule("alien")


def test_two_projectors_cover_each_others_shadows() -> None:
    one = rig()
    other = one.projectors[0].model_copy(update={"pose": LookAt(origin_mm=(-30, -18, 50))})
    both = one.model_copy(update={"projectors": (one.projectors[0], other)})
    shown = PATTERNS.frames(2)
    truth = hills()
    seen = [np.ones_like(truth), np.ones_like(truth)]
    seen[0][:10], seen[1][-10:] = 0.0, 0.0
    counts = [
        calibrated_stack(
            one.model_copy(update={"projectors": (p,)}),
            truth,
            PATTERNS,
            modulation=80 * s,
            sigma_dn=1.0,
            dtype=np.uint8,
        ).frames
        for p, s in zip((one.projectors[0], other), seen, strict=True)
    ]
    stack = Stack(np.concatenate(counts, axis=1), shown, (1.0,), SimpleSensor(sigma_dn=1.0), both)
    rec = decode.reconstruct(stack)
    assert rec.valid.all()
    assert (np.abs(rec.height_mm - truth) < 6 * rec.sigma_mm).all()
    alone = decode.reconstruct(stack, projector=0)
    assert (alone.reason[:10] != decode.Reason.OK).mean() > 0.99
    with pytest.raises(DecodeError, match="choose one with projector="):
        decode.reconstruct(stack, height="phase")


def test_middle_exposure_is_that_of_the_index() -> None:
    assert decode.middle_exposure((4.0, 1.0, 2.0)) == 2
    assert decode.middle_exposure((8.0, 1.0)) == 0


def test_minimum_modulation_of_less_than_one_count_is_allowed() -> None:
    for value in (0.0, 0.5):
        assert decode.Options(min_modulation_dn=value).min_modulation_dn == value
    with pytest.raises(DecodeError, match="use 0 or more"):
        decode.Options(min_modulation_dn=-0.001)
