"""Two cameras that see the same fringes, from formulas alone."""

import numpy as np
import pytest

from decode.reason import Reason
from decode.stereo_phase import stereo
from decode.stereo_phase.epipolar_grid import CameraBaseline, EpipolarGrid
from scenes.acquisition.patterns import GrayCode, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.devices import LookAt, Pinhole
from scenes.support import memory
from scenes.support.errors import DecodeError, TooLargeError
from tests.decode.synthetic import LENS, rig

HEIGHTS = (-1.0, 4.0)
PROJECTOR = rig("pinhole", "pinhole", lenses=True).projectors[0].projection()
BOTH = PhaseShift(steps=4, periods_px=(16.0, 512.0), axes=("column", "row"))


def camera(x_mm: float, size: tuple[int, int] = (160, 120)) -> Pinhole:
    return Pinhole(
        resolution=size,
        pose=LookAt(origin_mm=(x_mm, 2.0, 60.0)),
        fx_px=600.0,
        fy_px=605.0,
        cx_px=size[0] / 2 + 3.3,
        cy_px=size[1] / 2 - 1.7,
        distortion=LENS,
    )


EYES = camera(-8.0), camera(8.0)


def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 1.5 + np.sin(x / 3.0) * np.cos(y / 4.0)


def heights(device: Pinhole) -> np.ndarray:
    """Height of the surface in each pixel, by fixed-point iteration along the ray (its slope is below 1/3)."""
    geometry = device.projection()
    origin, direction = geometry.rays(geometry.pixel_centres())
    height = np.zeros(origin.shape[:2])
    for _ in range(60):
        point = geometry.ray_points(origin, direction, height)
        height = surface(point[..., 0], point[..., 1])
    return height


def seen(
    device: Pinhole, height: np.ndarray, patterns: PhaseShift | GrayCode, sigma_dn: float, seed: int
) -> Stack:
    """Frames of a surface whose height in each pixel is given."""
    at = PROJECTOR.project(device.projection().points_at(height))[0]
    shown = patterns.frames()
    rng = np.random.default_rng(seed)
    light = np.stack([patterns.commanded(f, at[..., int(f.axis == "row")]) for f in shown])
    noisy = 40.0 + 160.0 * light + rng.normal(0.0, sigma_dn, light.shape)
    sensor = SimpleSensor(bits=0, sigma_dn=max(sigma_dn, 1e-3))
    return Stack(noisy[None].astype(np.float32), shown, (1.0,), sensor)


def look(
    device: Pinhole, patterns: PhaseShift | GrayCode, sigma_dn: float, seed: int
) -> tuple[Stack, np.ndarray]:
    """What a camera sees of the surface: frames and heights."""
    height = heights(device)
    return seen(device, height, patterns, sigma_dn, seed), height


def views(patterns: PhaseShift | GrayCode, sigma_dn: float) -> list[tuple[Stack, np.ndarray]]:
    return [look(eye, patterns, sigma_dn, seed) for seed, eye in enumerate(EYES)]


@pytest.mark.parametrize("axes", [("column",), ("row",), ("column", "row")])
def test_noise_free_stereo_finds_the_surface(axes: tuple[str, ...]) -> None:
    patterns = BOTH.model_copy(update={"axes": axes})
    (left, height), (right, _) = views(patterns, 0.0)
    rec = stereo(left, right, EYES, HEIGHTS)
    assert rec.valid.mean() > 0.7
    error = (rec.height_mm - height)[rec.valid]
    # The right map is read between its pixels, 0.1 mm apart on a surface whose curvature is below 0.11 / mm: bilinear
    # reading is off by 0.11 * 0.1^2 / 8 mm; float32 phase adds as much.
    assert np.abs(error).max() < 2e-3
    assert (rec.reason[~rec.valid] == Reason.NO_HEIGHT).any()


def test_sigma_of_stereo_is_its_scatter() -> None:
    (left, height), (right, _) = views(BOTH, 2.0)
    rec = stereo(left, right, EYES, HEIGHTS)
    ratio = ((rec.height_mm - height) / rec.sigma_mm)[rec.valid]
    # Reading between four right pixels averages their noise: weights' squares sum to between 1/4 and 1, 4/9 on average.
    low, high = np.sqrt((1.0 + 0.25) / 2.0), 1.0
    assert low < ratio.std() < high
    assert abs(np.median(ratio)) < 0.05


def test_gray_code_is_enough_for_stereo() -> None:
    code = GrayCode(axes=("column", "row"), bits=(9, 9))
    (left, height), (right, _) = views(code, 1.0)
    rec = stereo(left, right, EYES, HEIGHTS)
    assert rec.valid.mean() > 0.4
    # A cell of 1 px on either side, 0.1 mm on the surface, at a base to height of 16 to 60.
    assert np.median(np.abs(rec.height_mm - height)[rec.valid]) < 0.1 * 60.0 / 16.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"cameras": (camera(-8.0), camera(8.0, (80, 60)))}, "right stack.s frames are"),
        ({"heights_mm": (3.0, 1.0)}, "first must be below"),
        ({"heights_mm": (0.0, 60.5)}, "reach the left camera, which is at 60 mm"),
        ({"heights_mm": (20.0, 30.0)}, "no left pixel finds its match"),
    ],
)
def test_impossible_stereo_is_refused(change: dict[str, object], said: str) -> None:
    (left, _), (right, _) = views(BOTH, 0.0)
    keys = {"cameras": EYES, "heights_mm": HEIGHTS} | change
    with pytest.raises(DecodeError, match=said):
        stereo(left, right, **keys)  # type: ignore[arg-type]


def test_images_beyond_memory_are_refused_with_their_number_of_pixels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (left, _), (right, _) = views(BOTH, 0.0)
    monkeypatch.setattr(memory, "available_bytes", lambda: 1)
    pixels = left.frames[0, 0].size + right.frames[0, 0].size
    with pytest.raises(TooLargeError, match=f"stereo of {pixels} pixels"):
        stereo(left, right, EYES, HEIGHTS)


def test_grid_of_a_camera_that_looks_along_the_baseline_stays_small() -> None:
    # A strip around the epipole: the disk of equal angles that holds it has 15 times its pixels.
    left, right = EYES[0].projection(), camera(-8.0, (160, 8))
    right = right.model_copy(update={"pose": LookAt(origin_mm=(-7.9, 2.0, 20.0))})
    baseline = CameraBaseline.of(left, right.projection())
    planes = baseline.angles(left.rays(left.pixel_centres())[1])[0]
    grid = EpipolarGrid.of(baseline, right.projection(), {"column": np.zeros((8, 160))}, planes)
    assert grid.plane_rad.size * grid.along_rad.size <= 4 * 8 * 160


@pytest.mark.parametrize("from_mm", [(-8.0, 2.0, 60.0), (8.0, -14.0, 60.0)])
@pytest.mark.parametrize("bulge", [-0.1, 0.1])
def test_grid_holds_every_pixel_of_the_right_image(
    from_mm: tuple[float, float, float], bulge: float
) -> None:
    """Of a wide lens: of barrel and pincushion either the corners or the middles of the sides are farthest out."""
    wide = {"fx_px": 150.0, "fy_px": 150.0, "distortion": (bulge, 0.0, 0.0, 0.0, 0.0)}
    right = EYES[1].model_copy(update=wide).projection()
    left = EYES[0].model_copy(update={"pose": LookAt(origin_mm=from_mm)}).projection()
    baseline = CameraBaseline.of(left, right)
    map_px = {"column": np.zeros((right.height, right.width))}
    grid = EpipolarGrid.of(baseline, right, map_px, np.array([-1.5, 1.5]))  # type: ignore[arg-type]
    seen_at = baseline.angles(right.rays(right.pixel_centres())[1])
    for nodes, angle in zip((grid.plane_rad, grid.along_rad), seen_at, strict=True):
        assert nodes[0] <= angle.min() and angle.max() <= nodes[-1]


def test_candidate_has_the_other_coordinate_of_its_place_on_the_line() -> None:
    column = np.arange(0.0, 60.0, 3.0)
    maps = {"column": np.tile(column, (4, 1)), "row": np.tile(5.0 * column, (4, 1))}
    angles = np.linspace(0.5, 0.6, column.size)
    baseline = CameraBaseline.of(EYES[0].projection(), EYES[1].projection())
    grid = EpipolarGrid(baseline, np.linspace(0.0, 0.3, 4), angles, maps)  # type: ignore[arg-type]
    wanted = np.random.default_rng(0).uniform(0.0, 50.0, 30)
    pixel, along, others = grid.candidates("column", np.full(30, 0.1), wanted, 0.0)
    assert sorted(pixel) == list(range(30))
    np.testing.assert_allclose(others["row"], 5.0 * wanted[pixel], atol=1e-9)
    np.testing.assert_allclose(along, np.interp(wanted[pixel], column, angles), atol=1e-9)


def test_stacks_of_different_patterns_are_refused() -> None:
    left, _ = look(EYES[0], BOTH, 0.0, 0)
    right, _ = look(EYES[1], BOTH.model_copy(update={"steps": 3}), 0.0, 0)
    with pytest.raises(DecodeError, match="different patterns"):
        stereo(left, right, EYES, HEIGHTS)


def test_region_has_the_heights_of_the_whole_image() -> None:
    (left, _), (right, _) = views(BOTH, 1.0)
    roi = (30, 90, 40, 120)
    whole, part = stereo(left, right, EYES, HEIGHTS), stereo(left, right, EYES, HEIGHTS, roi=roi)
    inside = np.s_[roi[0] : roi[1], roi[2] : roi[3]]
    assert part.valid.sum() == part.valid[inside].sum() > 0.8 * 60 * 80
    both = whole.valid & part.valid
    # The grid of epipolar lines is another one, so a candidate may start elsewhere; the exact ray's crossing stays.
    assert np.abs(whole.height_mm - part.height_mm)[both].max() < 0.1 * whole.sigma_mm[both].min()
    assert (whole.valid != part.valid)[inside].mean() < 0.01


def test_steps_and_occlusions_leave_no_wrong_heights() -> None:
    """A block of 2 mm on a plane: its edges jump, and its side hides a strip from one camera."""
    stacks, heights_mm = [], []
    for seed, eye in enumerate(EYES):
        geometry = eye.projection()
        top = geometry.ray_points(*geometry.rays(geometry.pixel_centres()), 2.0)
        inside = (np.abs(top[..., 0]) < 2.0) & (np.abs(top[..., 1]) < 2.0)
        heights_mm.append(np.where(inside, 2.0, 0.0))
        stacks.append(seen(eye, heights_mm[-1], BOTH, 1.0, seed))
    rec = stereo(stacks[0], stacks[1], EYES, HEIGHTS)
    assert rec.valid.mean() > 0.7
    error = np.abs(rec.height_mm - heights_mm[0])
    # Six sigma; of the rest, right pixels across an edge mix two surfaces, one pixel wide around the block.
    wrong = rec.valid & (error > 6.0 * rec.sigma_mm)
    assert wrong.mean() < 0.005


def test_progress_ends_at_one_and_never_falls() -> None:
    (left, _), (right, _) = views(BOTH, 0.0)
    shares: list[float] = []
    stereo(left, right, EYES, HEIGHTS, progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1.0)
