"""Every way of calling the decoder gives full images: the textbook's 16 kinds of call, and more."""

import subprocess
import sys

import numpy as np
import pytest

import decode
from decode.fusion import MaxModulation
from scenes import backend
from scenes.patterns import PhaseShift
from tests.decode.synthetic import calibrated_stack, hills, rig

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
    prepared = {"backend": backend.select().name, "fusion": MaxModulation()} if initialised else {}
    rec = decode.reconstruct(stack, roi=roi, **prepared)
    asked = np.zeros(truth.shape, bool)
    asked[slice(*(roi or (0, 48))[:2]), slice(*(roi or (0, 0, 0, 64))[2:])] = True
    assert (rec.valid == asked).all()
    error = (rec.height_mm - truth)[asked]
    # six predicted sigma: none of 3072 pixels beyond by chance (2e-9 each)
    assert (np.abs(error) < 6 * rec.sigma_mm[asked]).all()
    for image in (rec.phase_rad, rec.modulation_dn, rec.offset_dn, rec.xyz_mm):
        assert image.shape[:2] == truth.shape
        assert np.isfinite(image[asked]).all()
    assert (rec.row_px is not None) == both


def test_a_fresh_interpreter_needs_no_initialisation() -> None:
    code = (
        "import numpy as np, decode\n"
        "from scenes.patterns import PhaseShift\n"
        "from tests.decode.synthetic import calibrated_stack, hills, rig\n"
        "rec = decode.reconstruct(calibrated_stack(rig(), hills(), PhaseShift(periods_px=(16., 80.))))\n"
        "assert rec.valid.all() and abs(rec.height_mm - hills()).max() < 1e-3\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
