"""Every way of calling the decoder gives full images: the textbook's 16 kinds of call, and more."""

from typing import Any

import numpy as np
import pytest

import decode
from decode.fusion.interface import MaxModulation
from scenes.acquisition.patterns import PhaseShift
from scenes.rig.devices import LookAt
from scenes.support import backend
from tests.commands import program
from tests.decode.synthetic import calibrated_stack, coordinates, hills, rig

ROI = (5, 41, 9, 60)


@pytest.mark.parametrize("initialised", [False, True])
@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize("roi", [None, ROI])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.uint16])
def test_every_kind_of_call_returns_the_right_heights(
    dtype: type, roi: tuple[int, int, int, int] | None, both: bool, initialised: bool
) -> None:
    truth = hills()
    patterns = PhaseShift(periods_px=(16.0, 80.0), axes=("column", "row") if both else ("column",))
    stack = calibrated_stack(rig(), truth, patterns, sigma_dn=1.0, dtype=dtype)
    prepared: Any = (
        {"backend": backend.select().name, "fusion": MaxModulation()} if initialised else {}
    )
    rec = decode.reconstruct(stack, roi=roi, **prepared)
    asked = np.zeros(truth.shape, bool)
    asked[slice(*(roi or (0, 48))[:2]), slice(*(roi or (0, 0, 0, 64))[2:])] = True
    assert (rec.valid == asked).all()
    error = (rec.height_mm - truth)[asked]
    # Six predicted sigma: none of 3072 pixels beyond by chance (2e-9 each).
    assert (np.abs(error) < 6 * rec.sigma_mm[asked]).all()
    for image in (rec.phase_rad, rec.modulation_dn, rec.offset_dn, rec.xyz_mm):
        assert image.shape[:2] == truth.shape
        assert np.isfinite(image[asked]).all()
    assert (rec.row_px is not None) == both


@pytest.mark.parametrize("model", ["telecentric", "pinhole"])
def test_fringes_along_the_baseline_do_no_harm_to_heights(model: str) -> None:
    """A projector straight next to the camera, the usual rig: no height moves its rows."""
    truth = hills()
    calibration = rig(model, model, lenses=model == "pinhole")
    sideways = LookAt(origin_mm=(35, 0, 50))
    projector = calibration.projectors[0].model_copy(update={"pose": sideways})
    calibration = calibration.model_copy(update={"projectors": (projector,)})
    patterns = PhaseShift(periods_px=(16.0, 80.0, 400.0), axes=("column", "row"))
    rec = decode.reconstruct(calibrated_stack(calibration, truth, patterns, sigma_dn=1.0))
    assert rec.axis == "column"
    assert rec.valid.all()
    assert (np.abs(rec.height_mm - truth) < 6 * rec.sigma_mm).all()
    assert rec.row_px is not None
    row = coordinates(calibration, truth)[1]
    # Six standard deviations of four-step phase: 16 px / 2 pi x sqrt(2 / 4) x 1 / 80.
    assert np.abs(rec.row_px - row).max() < 6 * 16 / (2 * np.pi) * np.sqrt(0.5) / 80


def test_fresh_interpreter_needs_no_initialisation() -> None:
    code = (
        "import numpy as np, decode\n"
        "from scenes.acquisition.patterns import PhaseShift\n"
        "from tests.decode.synthetic import calibrated_stack, hills, rig\n"
        "rec = decode.reconstruct(calibrated_stack(rig(), hills(), PhaseShift(periods_px=(16., 80.))))\n"
        "assert rec.valid.all() and abs(rec.height_mm - hills()).max() < 1e-3\n"
    )
    done = program(code)
    assert (done.returncode, done.stderr) == (0, "")
