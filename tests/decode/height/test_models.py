"""Heights of every rig against the geometry that made the stack, and the models against one another."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import decode
from decode.height.calibrated_view import CalibratedView
from decode.height.models import Linear
from scenes.acquisition.patterns import Axis, PhaseShift
from scenes.rig.calibration import Calibration
from scenes.support.errors import DecodeError
from tests.decode.synthetic import calibrated_stack, coordinates, hills, rig

PATTERNS = PhaseShift(periods_px=(16.0, 80.0), axes=("column", "row"))
RIGS = {
    f"{camera}-{projector}{'-lenses' if lenses else ''}": rig(camera, projector, lenses)
    for camera in ("telecentric", "pinhole")
    for projector in ("telecentric", "pinhole")
    for lenses in (False, True)
    if not lenses or "pinhole" in (camera, projector)
}


def float32_bound_mm(calibration: Calibration, axis: Axis, period_px: float) -> float:
    """What float32 frames of A = 120, B = 80 and float32 phase may cost in height: see test_phase, times dh/du."""
    phase = 2.0 * (4 + 2) * 2.0**-24 * 200.0 / 80.0 + 1e-6
    rigid = CalibratedView(calibration, 0).rig
    ray = rigid.ray(*CalibratedView(calibration, 0).grid())
    slope = rigid.coordinate(ray, ray.t_at(1.0), axis)[1] / ray.world_direction[2]
    # And float32 heights of up to 3 mm.
    return float(phase * period_px / (2 * np.pi) / np.abs(slope).min() * 1.1 + 3.0 * 2.0**-24)


@pytest.mark.parametrize("name", RIGS)
def test_two_axes_give_the_height_where_either_is_known(name: str) -> None:
    height = hills()
    columns, rows = coordinates(RIGS[name], height)
    columns[:, ::3], rows[:, 1::3] = np.nan, np.nan
    columns[0], rows[0] = np.nan, np.nan
    found = decode.triangulate(columns, RIGS[name], row_px=rows)
    # Float64 throughout.
    np.testing.assert_allclose(found[1:], height[1:], atol=1e-8)
    assert np.isnan(found[0]).all()


@pytest.mark.parametrize("axis", ["column", "row"])
@pytest.mark.parametrize("name", RIGS)
def test_triangulation_loses_nothing_on_any_rig_and_axis(name: str, axis: Axis) -> None:
    calibration, truth = RIGS[name], hills()
    rec = decode.reconstruct(calibrated_stack(calibration, truth, PATTERNS), axis=axis)
    assert rec.valid.all()
    bound = float32_bound_mm(calibration, axis, 16.0)
    assert bound < 2e-5
    assert np.abs(rec.height_mm - truth).max() < bound
    column, row = coordinates(calibration, truth)
    scale = 16.0 / (2 * np.pi) * 3e-6
    assert (
        rec.phases["column"].coordinate_px is not None
        and np.abs(rec.phases["column"].coordinate_px - column).max() < scale
    )
    assert (
        rec.phases["row"].coordinate_px is not None
        and np.abs(rec.phases["row"].coordinate_px - row).max() < scale
    )


@pytest.mark.parametrize("height_mm", [-1.0, 0.0, 1.7])
@pytest.mark.parametrize("name", [name for name in RIGS if "lenses" not in name])
def test_expected_coordinates_are_where_the_rays_meet_the_plane(
    name: str, height_mm: float
) -> None:
    rigid = CalibratedView(RIGS[name], 0).rig
    pixels = CalibratedView(RIGS[name], 0).grid()
    ray = rigid.ray(*pixels)
    for axis in ("column", "row"):
        met = rigid.coordinate(ray, ray.t_at(height_mm), axis)[0]
        # float64, through a matrix product and an inverse: a thousand roundings of a thousand pixels.
        assert np.abs(rigid.coordinate_on_plane(*pixels, height_mm, axis) - met).max() < 1e-9


@pytest.mark.parametrize("name", RIGS)
def test_points_are_on_the_surface_and_on_the_camera_rays(name: str) -> None:
    calibration, truth = RIGS[name], hills()
    rec = decode.reconstruct(calibrated_stack(calibration, truth, PATTERNS))
    camera = calibration.camera.projection()
    pixels, _ = camera.project(rec.xyz_mm)
    # float32 coordinates of up to 16 mm, 4 px per mm.
    assert np.abs(pixels - camera.pixel_centres()).max() < 16 * 2.0**-24 * 4 * 4
    assert np.array_equal(rec.xyz_mm[..., 2], rec.height_mm)


def test_opencv_projects_the_points_back_onto_both_devices_pixels() -> None:
    calibration, truth = RIGS["pinhole-pinhole-lenses"], hills()
    rec = decode.reconstruct(calibrated_stack(calibration, truth, PATTERNS))
    shown = {
        "camera": calibration.camera.projection().pixel_centres(),
        "projector": np.stack(
            [rec.phases["column"].coordinate_px, rec.phases["row"].coordinate_px], axis=-1
        ),
    }
    for name, device in (("camera", calibration.camera), ("projector", calibration.projectors[0])):
        p = device.projection()
        # OpenCV's pixel centres are at whole numbers.
        matrix = np.array([[p.fx, 0, p.cx - 0.5], [0, p.fy, p.cy - 0.5], [0, 0, 1]])
        turn, _ = cv2.Rodrigues(p.R)
        points = rec.xyz_mm.reshape(-1, 1, 3).astype(np.float64)
        found, _ = cv2.projectPoints(points, turn, p.t, matrix, np.array(p.distortion))
        error = np.abs(found.reshape(*truth.shape, 2) + 0.5 - shown[name])
        # The projector's coordinates carry float32 phase (3e-6 rad of 16 px), the points float32 mm (10 px per mm).
        assert error.max() < 3e-6 * 16 / (2 * np.pi) + 16 * 2.0**-24 * 12 * 4


@settings(max_examples=25, deadline=None)
@given(
    lens=st.tuples(*[st.floats(-0.15, 0.15)] * 2, *[st.floats(-2e-3, 2e-3)] * 2, st.just(0.0)),
    name=st.sampled_from(["pinhole-pinhole", "telecentric-pinhole", "pinhole-telecentric"]),
    axis=st.sampled_from(["column", "row"]),
)
def test_ray_and_distorted_fringe_meet_to_a_nanometre(
    lens: tuple[float, ...], name: str, axis: Axis
) -> None:
    calibration = RIGS[name]
    devices = [calibration.camera, calibration.projectors[0]]
    bent = [
        d.model_copy(update={"distortion": lens}) if "distortion" in type(d).model_fields else d
        for d in devices
    ]
    calibration = calibration.model_copy(update={"camera": bent[0], "projectors": (bent[1],)})
    truth = hills()
    column, row = coordinates(calibration, truth)
    plan = CalibratedView(calibration, 0).kernel_rig(axis)
    x, y = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    ray = plan.ray(x, y)
    t, slope = plan.meet(ray, column if axis == "column" else row, axis)
    assert np.abs(ray.point(t)[2] - truth).max() < 1e-6
    # The slope is the derivative: a central difference of 1e-3 px errs by its square.
    near = [
        plan.meet(ray, (column if axis == "column" else row) + d, axis)[0] for d in (1e-3, -1e-3)
    ]
    assert np.allclose((near[0] - near[1]) / 2e-3, slope, rtol=1e-5, atol=0)


@pytest.mark.parametrize(
    "name", ["telecentric-telecentric", "telecentric-pinhole", "pinhole-pinhole"]
)
def test_reference_plane_of_the_calibration_is_triangulation_without_lenses(name: str) -> None:
    stack = calibrated_stack(RIGS[name], hills(), PATTERNS)
    exact = decode.reconstruct(stack)
    plane = decode.reconstruct(stack, height="reference-plane")
    bound = float32_bound_mm(RIGS[name], exact.axis, 16.0)
    assert np.abs(plane.height_mm - exact.height_mm).max() < 2 * bound
    assert np.allclose(plane.sigma_mm, exact.sigma_mm, rtol=1e-4, atol=0)


def test_measured_reference_removes_errors_of_the_calibration() -> None:
    bent = RIGS["telecentric-pinhole-lenses"]
    straight = bent.model_copy(
        update={"projectors": (bent.projectors[0].model_copy(update={"distortion": (0.0,) * 5}),)}
    )

    def believed(height: np.ndarray):  # type: ignore[no-untyped-def]
        made = calibrated_stack(bent, height, PATTERNS)
        return type(made)(made.frames, made.patterns, made.exposure_ms, made.sensor, straight)

    truth = hills()
    flat = believed(np.zeros_like(truth))
    wrong = np.abs(decode.reconstruct(believed(truth)).height_mm - truth)
    better = decode.reconstruct(believed(truth), height="reference-plane", reference=flat)
    error = np.abs(better.height_mm - truth)
    assert error[truth < 0.01].max() < 1e-4
    assert error.max() < wrong.max() / 3


def test_uncalibrated_reference_needs_only_the_shift_per_mm() -> None:
    calibration, truth = RIGS["telecentric-telecentric"], hills()
    made = [calibrated_stack(calibration, h, PATTERNS) for h in (truth, np.zeros_like(truth))]
    bare = [type(s)(s.frames, s.patterns, s.exposure_ms, s.sensor) for s in made]
    shift = (
        coordinates(calibration, np.ones_like(truth))[0] - coordinates(calibration, 0 * truth)[0]
    )
    rec = decode.reconstruct(
        bare[0],
        height="reference-plane",
        reference=bare[1],
        c_px_per_mm=float(shift.mean()),
        height_range_mm=(-0.5, 3.0),
        axis="column",
    )
    assert rec.valid.all()
    assert np.abs(rec.height_mm - truth).max() < 2 * float32_bound_mm(calibration, "column", 16.0)
    with pytest.raises(DecodeError, match="points need a calibration"):
        _ = rec.xyz_mm


def test_linear_model_of_the_calibration_is_exact_for_parallel_rays_only() -> None:
    truth = hills()
    for name, exact in (("telecentric-telecentric", True), ("pinhole-pinhole", False)):
        rec = decode.reconstruct(calibrated_stack(RIGS[name], truth, PATTERNS), height="linear")
        bound = float32_bound_mm(RIGS[name], rec.axis, 16.0)
        assert (np.abs(rec.height_mm - truth).max() < bound) == exact


@pytest.mark.parametrize("name", ["telecentric-telecentric", "pinhole-pinhole-lenses"])
def test_predicted_height_noise_is_the_scatter(name: str) -> None:
    truth = hills((160, 120))
    camera, projector = name.split("-")[:2]
    calibration = rig(camera, projector, lenses="lenses" in name, size=(160, 120))
    albedo = 0.3 + 0.7 * np.linspace(0, 1, 160)[None, :] * np.ones((120, 1))
    stack = calibrated_stack(
        calibration,
        truth,
        PATTERNS,
        sigma_dn=2.0,
        dtype=np.uint8,
        offset=120 * albedo,
        modulation=80 * albedo,
        rng=np.random.default_rng(5),
    )
    rec = decode.reconstruct(stack)
    assert rec.valid.all()
    pull = (rec.height_mm - truth) / rec.sigma_mm
    n = pull.size
    # Variance of n squared normals; B itself is estimated (relative variance sigma_B^2/B^2 <= 3.5e-3), and so is sigma.
    assert abs(np.mean(pull**2) - 1) < 5 * np.sqrt(2 / n) + 3 * (2.02 / np.sqrt(2) / 24) ** 2
    assert abs(pull.mean()) < 5 / np.sqrt(n)


def test_calibration_of_another_image_size_is_refused() -> None:
    stack = calibrated_stack(rig(), hills(), PATTERNS)
    small = type(stack)(
        stack.frames[..., :-1], stack.patterns, stack.exposure_ms, stack.sensor, stack.calibration
    )
    with pytest.raises(DecodeError, match="64 x 48 pixels, the frames are 63 x 48"):
        decode.reconstruct(small)


def test_projector_that_looks_elsewhere_is_refused() -> None:
    calibration = rig("telecentric", "pinhole")
    away = {"origin_mm": (30, 18, 50), "target_mm": (300, 18, 50), "up": (0, 0, 1)}
    pose = type(calibration.projectors[0].pose)(**away)
    lost = calibration.model_copy(
        update={"projectors": (calibration.projectors[0].model_copy(update={"pose": pose}),)}
    )
    made = calibrated_stack(calibration, hills(), PATTERNS)
    stack = type(made)(made.frames, made.patterns, made.exposure_ms, made.sensor, lost)
    with pytest.raises(DecodeError, match="do not overlap"):
        decode.reconstruct(stack)


def test_band_of_linear_heights_has_a_width_whichever_way_fringes_shift() -> None:
    for c_px_per_mm in (2.5, -2.5):
        assert Linear(c_px_per_mm, "column").band_px((-1.0, 3.0)) == 10.0
