"""Two cameras that see the same fringes, from formulas alone."""

import numpy as np
import pytest

from decode.stereo import stereo
from decode.validity import Reason
from scenes.errors import DecodeError
from scenes.patterns import GrayCode, PhaseShift
from scenes.rig import LookAt, Pinhole
from scenes.sensor import SimpleSensor
from scenes.stack import Stack
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


def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 1.5 + np.sin(x / 3.0) * np.cos(y / 4.0)


def heights(device: Pinhole) -> np.ndarray:
    """Height of the surface in each pixel, by fixed-point iteration along the ray (its slope is below 1/3)."""
    geometry = device.projection()
    origin, direction = geometry.rays(geometry.pixel_centres())
    height = np.zeros(origin.shape[:2])
    for _ in range(60):
        t = (height - origin[..., 2]) / direction[..., 2]
        point = origin + t[..., None] * direction
        height = surface(point[..., 0], point[..., 1])
    return height


def look(
    device: Pinhole, patterns: PhaseShift | GrayCode, sigma_dn: float, seed: int
) -> tuple[Stack, np.ndarray]:
    geometry = device.projection()
    height = heights(device)
    origin, direction = geometry.rays(geometry.pixel_centres())
    t = (height - origin[..., 2]) / direction[..., 2]
    at = PROJECTOR.project(origin + t[..., None] * direction)[0]
    shown = patterns.frames()
    rng = np.random.default_rng(seed)
    light = np.stack([patterns.commanded(f, at[..., int(f.axis == "row")]) for f in shown])
    noisy = 40.0 + 160.0 * light + rng.normal(0.0, sigma_dn, light.shape)
    frames = noisy[None].astype(np.float32)
    sensor = SimpleSensor(bits=0, sigma_dn=max(sigma_dn, 1e-3))
    return Stack(frames, shown, (1.0,), sensor), height


@pytest.mark.parametrize("axes", [("column",), ("row",), ("column", "row")])
def test_noise_free_stereo_finds_the_surface(axes: tuple[str, ...]) -> None:
    patterns = BOTH.model_copy(update={"axes": axes})
    eyes = camera(-8.0), camera(8.0)
    (left, height), (right, _) = (look(eye, patterns, 0.0, 0) for eye in eyes)
    rec = stereo(left, right, eyes, HEIGHTS)
    assert rec.valid.mean() > 0.7
    error = (rec.height_mm - height)[rec.valid]
    # the right map is read between its pixels, 0.1 mm apart on a surface whose curvature is below 0.11 / mm: bilinear
    # reading is off by 0.11 * 0.1^2 / 8 mm; float32 phase adds as much
    assert np.abs(error).max() < 2e-3
    assert (rec.reason[~rec.valid] == Reason.NO_HEIGHT).any()


def test_sigma_of_stereo_is_its_scatter() -> None:
    eyes = camera(-8.0), camera(8.0)
    (left, height), (right, _) = (look(eye, BOTH, 2.0, seed) for seed, eye in enumerate(eyes))
    rec = stereo(left, right, eyes, HEIGHTS)
    ratio = ((rec.height_mm - height) / rec.sigma_mm)[rec.valid]
    # reading between four right pixels averages their noise: weights' squares sum to between 1/4 and 1, 4/9 on average
    low, high = np.sqrt((1.0 + 0.25) / 2.0), 1.0
    assert low < ratio.std() < high
    assert abs(np.median(ratio)) < 0.05


def test_gray_code_is_enough_for_stereo() -> None:
    eyes = camera(-8.0), camera(8.0)
    code = GrayCode(axes=("column", "row"), bits=(9, 9))
    (left, height), (right, _) = (look(eye, code, 1.0, seed) for seed, eye in enumerate(eyes))
    rec = stereo(left, right, eyes, HEIGHTS)
    assert rec.valid.mean() > 0.4
    # a cell of 1 px on either side, 0.1 mm on the surface, at a base to height of 16 to 60
    assert np.median(np.abs(rec.height_mm - height)[rec.valid]) < 0.1 * 60.0 / 16.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"cameras": (camera(-8.0), camera(8.0, (80, 60)))}, "right camera is 80 x 60"),
        ({"heights_mm": (3.0, 1.0)}, "first must be below"),
        ({"heights_mm": (20.0, 30.0)}, "no left pixel finds its match"),
    ],
)
def test_impossible_stereo_is_refused(change: dict[str, object], said: str) -> None:
    eyes = camera(-8.0), camera(8.0)
    (left, _), (right, _) = (look(eye, BOTH, 0.0, 0) for eye in eyes)
    keys = {"cameras": eyes, "heights_mm": HEIGHTS} | change
    with pytest.raises(DecodeError, match=said):
        stereo(left, right, **keys)  # type: ignore[arg-type]


def test_stacks_of_other_patterns_do_not_match() -> None:
    eyes = camera(-8.0), camera(8.0)
    left, _ = look(eyes[0], BOTH, 0.0, 0)
    right, _ = look(eyes[1], PhaseShift(steps=3, periods_px=(16.0, 512.0)), 0.0, 0)
    with pytest.raises(DecodeError, match="different patterns"):
        stereo(left, right, eyes, HEIGHTS)
