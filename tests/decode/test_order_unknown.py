"""A fringe order that nothing measured fixes is reported, for the image and for each pixel."""

import numpy as np

import decode
from decode.reconstruction import ORDER_ABSOLUTE, ORDER_UP_TO_TURNS
from scenes.acquisition.patterns import PhaseShift
from scenes.files.stack import Stack
from tests.decode.synthetic import calibrated_stack, hills, rig

# 40 px of projector are 4 mm here: a volume of 13 mm holds three fringes.
DEEP, SHALLOW = (-1.0, 12.0), (-0.5, 3.0)


def one_period(heights_mm: tuple[float, float]) -> Stack:
    calibration = rig(heights_mm=heights_mm)
    return calibrated_stack(calibration, hills(), PhaseShift(periods_px=(40.0,)), sigma_dn=1.0)


def test_heights_of_an_unknown_order_are_rejected_as_such() -> None:
    rec = decode.reconstruct(one_period(DEEP))
    assert (rec.reason == decode.Reason.ORDER_UNKNOWN).all()
    assert rec.reason_fractions() == {"ok": 0.0, "order-unknown": 1.0}
    assert rec.settings["resolved"]["order"] == ORDER_UP_TO_TURNS
    assert not rec.order_known
    assert np.isfinite(rec.height_mm).all()


def test_heights_of_a_requested_scan_are_valid_and_marked() -> None:
    rec = decode.reconstruct(one_period(DEEP), unwrap="quality-guided")
    assert rec.valid.all()
    assert not rec.order_known


def test_order_fixed_by_the_volume_is_absolute() -> None:
    rec = decode.reconstruct(one_period(SHALLOW))
    assert rec.valid.all() and rec.order_known
    resolved = rec.settings["resolved"]
    assert resolved["order"] == ORDER_ABSOLUTE
    assert (resolved["axis"], resolved["height"]) == ("column", "triangulation")
    assert (resolved["unwrap"], resolved["anchor"]) == ("temporal", "volume")


def test_scan_levelled_by_coarser_periods_is_absolute() -> None:
    patterns = PhaseShift(periods_px=(16.0, 100.0, 400.0))
    stack = calibrated_stack(rig(heights_mm=DEEP), hills(), patterns, sigma_dn=1.0)
    rec = decode.reconstruct(stack, unwrap="quality-guided")
    assert rec.order_known
    assert rec.settings["resolved"]["unwrap"] == "quality-guided"


def test_check_warns_of_an_unknown_order() -> None:
    found = {f.name: f for f in decode.check(one_period(DEEP)).findings}
    assert found["columns, fringe order"].verdict == "warning"
    assert ORDER_UP_TO_TURNS in found["columns, fringe order"].message
    assert "columns, fringe order" not in {
        f.name for f in decode.check(one_period(SHALLOW)).findings
    }
