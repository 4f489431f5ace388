"""The reconstruction as a value: files, other people's heights, phases without loss."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import decode
from decode.reconstruction import AxisPhase
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.devices import LookAt
from scenes.support.errors import DecodeError, FileError
from tests.decode.synthetic import calibrated_stack, hills, rig

IMAGES = (
    "height_mm",
    "sigma_mm",
    "modulation_dn",
    "offset_dn",
    "reason",
    "exposure",
    "projector",
    "xyz_mm",
)


@pytest.fixture(scope="module")
def rec() -> decode.Reconstruction:
    patterns = PhaseShift(periods_px=(16.0, 80.0), axes=("column", "row"))
    stack = calibrated_stack(rig(), hills(), patterns, sigma_dn=1.0, dtype=np.uint8)
    return decode.reconstruct(stack, roi=(0, 40, 3, 64), height_range_mm=(-0.5, 1.5))


def same(one: decode.Reconstruction, two: decode.Reconstruction) -> None:
    for name in IMAGES:
        a, b = getattr(one, name), getattr(two, name)
        assert a.dtype == b.dtype, name
        assert np.array_equal(a, b, equal_nan=True), name
    assert one.axis == two.axis
    assert one.calibration == two.calibration
    for axis, phase in one.phases.items():
        assert np.array_equal(phase.phase_rad, two.phases[axis].phase_rad, equal_nan=True)
    assert one.reason_fractions() == two.reason_fractions()


def test_file_gives_back_every_value(rec: decode.Reconstruction, tmp_path: Path) -> None:
    rec.write(tmp_path / "rec.exr")
    back = decode.Reconstruction.read(tmp_path / "rec.exr")
    same(rec, back)
    assert back.settings["fusion"] == "max-modulation"
    assert set(rec.reason_fractions()) == {"ok", "out-of-volume"}


def test_constant_maps_take_no_memory_and_are_written_like_others(tmp_path: Path) -> None:
    stack = calibrated_stack(rig(), hills(), PhaseShift(periods_px=(16.0, 80.0)))
    phases = decode.reconstruct(stack, height="phase")
    # A single exposure, and no heights: one number each, which must not be written out pixel by pixel.
    for name in ("exposure", "height_mm"):
        image = getattr(phases, name)
        assert image.shape == (48, 64) and image.strides == (0, 0)
    phases.write(tmp_path / "rec.exr")
    same(phases, decode.Reconstruction.read(tmp_path / "rec.exr"))
    same(phases, pickle.loads(pickle.dumps(phases)))


def test_reconstruction_can_be_pickled(rec: decode.Reconstruction) -> None:
    same(rec, pickle.loads(pickle.dumps(rec)))


def test_damaged_reconstruction_is_an_error(rec: decode.Reconstruction, tmp_path: Path) -> None:
    rec.write(tmp_path / "rec.exr")
    (tmp_path / "rec.exr").write_bytes((tmp_path / "rec.exr").read_bytes()[:5000])
    with pytest.raises(FileError, match="truncated"):
        decode.Reconstruction.read(tmp_path / "rec.exr")


def test_heights_of_another_decoder_are_scored_by_their_nans() -> None:
    height = hills()
    height[0, 0] = np.nan
    mine = decode.Reconstruction.of_heights(height, calibration=rig())
    assert (mine.valid == np.isfinite(height)).all()
    assert mine.xyz_mm.shape == (48, 64, 3)
    with pytest.raises(DecodeError, match="no phase"):
        _ = mine.phase_rad
    with pytest.raises(DecodeError, match="nothing to score"):
        decode.Reconstruction.of_heights(np.full((3, 3), np.nan))
    with pytest.raises(DecodeError, match="expected \\(row, col\\)"):
        decode.Reconstruction.of_heights(np.zeros(3))
    with pytest.raises(DecodeError, match="valid has shape"):
        decode.Reconstruction.of_heights(np.zeros((3, 3)), valid=np.ones((2, 2), bool))


def test_order_and_wrapped_phase_keep_more_digits_than_float32() -> None:
    wrapped = np.linspace(-3, 3, 1000, dtype=np.float32)[None]
    phase = AxisPhase(16.0, wrapped, np.full(wrapped.shape, 400, np.int32))
    back = phase.phase_rad - 2 * np.pi * 400
    assert np.abs(back - wrapped).max() < 2500 * 2.0**-52
    lost = phase.phase_rad.astype(np.float32).astype(np.float64) - 2 * np.pi * 400
    assert np.abs(lost - wrapped).max() > 1e-5


def two_projectors() -> Stack:
    """One hill under two projectors; the first lights the left half alone, the second the right half and 8 columns more."""
    one = rig()
    (left,) = one.projectors
    right = left.model_copy(update={"pose": LookAt(origin_mm=(-30, 18, 50))})
    patterns, frames, shown = PhaseShift(periods_px=(16.0, 80.0)), [], []
    for index, (projector, columns) in enumerate([(left, slice(0, 32)), (right, slice(24, 64))]):
        light = np.full((48, 64), 0.005)
        light[:, columns] = 1.0
        alone = one.model_copy(update={"projectors": (projector,)})
        made = calibrated_stack(alone, hills(), patterns, offset=90 * light, modulation=80 * light)
        frames.append(made.frames)
        shown += [replace(frame, projector=index) for frame in made.patterns]
    both = one.model_copy(update={"projectors": (left, right)})
    sensor = SimpleSensor(sigma_dn=0.1, bits=0)
    return Stack(np.concatenate(frames, axis=1), tuple(shown), (1.0,), sensor, both)


def test_projector_map_names_who_measured_each_pixel(tmp_path: Path) -> None:
    stack = two_projectors()
    rec = decode.reconstruct(stack)
    assert rec.valid.all()
    assert rec.projector is not None
    assert (rec.projector[:, :24] == 0).all() and (rec.projector[:, 32:] == 1).all()
    both = np.arange(64) // 8 == 3
    for index in (0, 1):
        alone = decode.reconstruct(stack, projector=index)
        assert alone.projector is not None and (alone.projector == index).all()
        mine = rec.projector == index
        assert np.array_equal(rec.phase_rad[mine], alone.phase_rad[mine])
        # Where both do, the height is that of both.
        assert np.array_equal(rec.height_mm[mine & ~both], alone.height_mm[mine & ~both])
        assert np.array_equal(rec.sigma_mm[mine & ~both], alone.sigma_mm[mine & ~both])
        assert (rec.sigma_mm[mine & both] < alone.sigma_mm[mine & both]).all()
    rec.write(tmp_path / "rec.exr")
    back = decode.Reconstruction.read(tmp_path / "rec.exr")
    assert back.projector is not None and np.array_equal(back.projector, rec.projector)


def test_frames_of_nan_are_rejected_as_not_a_number() -> None:
    made = calibrated_stack(rig(), hills(), PhaseShift(periods_px=(16.0, 80.0)), sigma_dn=1.0)
    frames = made.frames.copy()
    frames[0, 5, :9] = np.nan
    rec = decode.reconstruct(replace(made, frames=frames))
    assert (rec.reason[:9] == decode.Reason.NOT_A_NUMBER).all()
    assert rec.valid[9:].all()
    with pytest.raises(DecodeError, match=r"not-a-number 100.0%.*frames hold NaN"):
        decode.reconstruct(replace(made, frames=np.full_like(frames, np.nan)))


@pytest.mark.parametrize("clipped_set", [0, 1, 2])
def test_one_clipped_sample_of_any_period_rejects_the_pixel(clipped_set: int) -> None:
    """Whichever of three periods it belongs to: a coarse one would shift the order, the finest one the height."""
    patterns = PhaseShift(steps=4, periods_px=(16.0, 64.0, 400.0))
    stack = calibrated_stack(rig(), hills(), patterns, sigma_dn=0.5, dtype=np.uint8)
    stack.frames[0, 4 * clipped_set + 1, 10:20, 30:40] = 255
    rec = decode.reconstruct(stack)
    clipped = np.zeros(rec.valid.shape, np.bool_)
    clipped[10:20, 30:40] = True
    np.testing.assert_array_equal(rec.valid, ~clipped)
    assert (rec.reason[clipped] == decode.Reason.SATURATED).all()
