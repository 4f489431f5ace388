"""A run's warning example, decoded from one exposure: the one that `fusion="single"` would take."""

from dataclasses import replace

import numpy as np

import decode
from fringebench.experiments.whole_run import middle_exposure_alone
from scenes.acquisition.patterns import PhaseShift
from tests.decode.synthetic import calibrated_stack, hills, rig


def test_run_and_single_take_the_same_exposure() -> None:
    made = calibrated_stack(rig(), hills(), PhaseShift(periods_px=(16.0, 80.0)), sigma_dn=1.0)
    times = (4.0, 1.0, 2.0)
    frames = np.concatenate([made.frames * t for t in times])
    stack = replace(made, frames=frames, exposure_ms=times)
    alone = middle_exposure_alone(stack)
    assert alone.exposure_ms == (2.0,)
    chosen = int(decode.reconstruct(stack, fusion="single").exposure[0, 0])
    assert stack.exposure_ms[chosen] == 2.0
