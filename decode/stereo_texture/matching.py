"""Heights by matching two pictures, with OpenCV's matchers.

Semi-global matching: H. Hirschmueller, Stereo processing by semiglobal matching and mutual information, IEEE PAMI 30, 328
(2008); block matching: K. Konolige, Small vision systems, 1998. What a match is worth cannot be derived from them: no sigma
is predicted.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode.options import Matcher, Options
from decode.reason import Reason
from decode.reconstruction import Reconstruction
from decode.stereo_texture.rectification import Rectified
from scenes.files.stack import Stack
from scenes.rig.devices import Pinhole
from scenes.support.errors import DecodeError
from scenes.support.memory import room_for

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Side of the blocks compared, px. A block must distinguish one place from some 64 others, 6 bits, with some to spare. Of dots of 2.2 px
# a block of 7 holds 10. Smoothness helps semi-global matching; a block alone needs more.
BLOCK_PX: dict[Matcher, int] = {"sgbm": 7, "bm": 15}
# Penalties of a step of one and of more disparities, as OpenCV advises: times the block's area.
STEP_PENALTY, JUMP_PENALTY = 8, 32
# Percent by which the best match must beat the second, and disparities by which left and right may differ.
UNIQUE_PERCENT, AGREE_PX = 10, 1
# Patches of less than this many pixels of one disparity are chance.
PATCH_PX, PATCH_STEP_PX = 50, 1
# OpenCV gives sixteenths of a disparity.
SUBPIXEL = 16.0
# Contrast is texture where its variance in a block is three times that of noise: an estimate from 49 pixels scatters by a third, with
# a long tail.
TEXTURE = 3.0
# Memory per pixel and disparity: costs, and their sums along the paths.
COST_BYTES = 8


def match(
    left: Stack,
    right: Stack,
    cameras: tuple[Pinhole, Pinhole],
    heights_mm: tuple[float, float],
    options: Options,
) -> Reconstruction:
    """Heights of the left camera's pixels from pictures of two cameras; `DecodeError` where nothing matches."""
    rectified = Rectified.of(cameras[0].projection(), cameras[1].projection(), heights_mm)
    columns, rows = rectified.size
    with room_for(
        COST_BYTES * columns * rows * rectified.count_px,
        f"matching {columns} x {rows} pixels with {rectified.count_px} disparities",
        "choose a smaller image or a smaller height_range_mm",
    ):
        clipped = options.saturation == "reject"
        pictures = [_Picture.of(stack, clipped) for stack in (left, right)]
        disparity = _disparity(rectified, pictures[0].light, pictures[1].light, options.matcher)
    height = rectified.height_mm(disparity)
    low, high = heights_mm
    reason = np.full(height.shape, Reason.OK, np.uint8)
    for where, why in (
        (~((height >= low) & (height <= high)), Reason.OUT_OF_VOLUME),
        (~np.isfinite(height), Reason.NO_MATCH),
        (~pictures[0].textured, Reason.NO_TEXTURE),
        (pictures[0].saturated, Reason.SATURATED),
    ):
        reason[where] = why
    region = options.region(height.shape)
    if region is not None:
        reason[~region] = Reason.OUTSIDE_ROI
        height = np.where(region, height, np.nan)
    unknown = np.full(height.shape, np.nan, np.float32)
    found = Reconstruction(
        height_mm=height.astype(np.float32),
        sigma_mm=unknown,
        modulation_dn=unknown,
        offset_dn=pictures[0].mean_dn,
        reason=reason,
        exposure=pictures[0].exposure,
        settings=options.summary() | {"height": "stereo", "matcher": options.matcher or "sgbm"},
        scene=left.scene,
        identity=left.identity,
    )
    if not found.valid.any():
        shares = ", ".join(f"{n} {s:.1%}" for n, s in found.reason_fractions().items() if n != "ok")
        raise DecodeError(
            f"no pixel of the two pictures matches ({shares}): project random dots, check the exposure and the calibration"
        )
    return found


@dataclass(frozen=True)
class _Picture:
    """What is matched of one camera."""

    light: NDArray[np.float32]
    """(row, col) 0 to 255."""
    mean_dn: NDArray[np.float32]
    exposure: NDArray[np.uint8]
    saturated: Mask
    textured: Mask

    @classmethod
    def of(cls, stack: Stack, reject: bool) -> "_Picture":
        """The longest exposure of each pixel that is not saturated, averaged over the frames."""
        order = np.argsort(stack.exposure_ms)
        shape = stack.frames.shape[2:]
        exposure, mean_dn = np.full(shape, order[0], np.uint8), np.zeros(shape, np.float32)
        rate, variance, saturated = np.zeros(shape), np.zeros(shape), np.ones(shape, np.bool_)
        for e in order:
            frames, time_ms = stack.frames[e], stack.exposure_ms[e]
            clipped = (frames.max(axis=0) >= stack.saturation_dn) & reject
            saturated &= clipped
            # What is saturated in the shortest exposure has that one.
            use = ~clipped | (e == order[0])
            mean = frames.mean(axis=0, dtype=np.float64)
            noise = stack.sensor.variance_dn2(mean, time_ms) / len(frames)
            rate[use] = ((mean - stack.sensor.black_level_dn) / time_ms)[use]
            variance[use] = (noise / time_ms**2)[use]
            mean_dn[use], exposure[use] = mean[use], e
        # Of the root of light, shot noise is alike in the dark and in the bright.
        top = float(np.percentile(rate, 99.9)) or 1.0
        light = 255.0 * np.sqrt(np.clip(rate / top, 0.0, 1.0))
        side = BLOCK_PX["sgbm"]
        # Shading, which varies evenly, is no texture; of white noise a Laplacian has 20 times the variance.
        spread = ndimage.uniform_filter(ndimage.laplace(rate) ** 2, side) / 20.0
        textured = spread > TEXTURE * ndimage.uniform_filter(variance, side)
        return cls(light.astype(np.float32), mean_dn, exposure, saturated, textured)


def _disparity(
    rectified: Rectified,
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    matcher: Matcher | None,
) -> Floats:
    """Disparity of the left camera's pixels, NaN where there is no match."""
    kind: Matcher = matcher or "sgbm"
    side, count = BLOCK_PX[kind], rectified.count_px
    images = [
        np.clip(np.rint(rectified.resampled(image, camera)), 0, 255).astype(np.uint8)
        for camera, image in enumerate((left, right))
    ]
    if kind == "sgbm":
        found = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=count,
            blockSize=side,
            P1=STEP_PENALTY * side**2,
            P2=JUMP_PENALTY * side**2,
            disp12MaxDiff=AGREE_PX,
            preFilterCap=63,
            uniquenessRatio=UNIQUE_PERCENT,
            speckleWindowSize=PATCH_PX,
            speckleRange=PATCH_STEP_PX,
            mode=cv2.STEREO_SGBM_MODE_SGBM,
        ).compute(*images)
    else:
        blocks = cv2.StereoBM.create(numDisparities=count, blockSize=side)
        blocks.setDisp12MaxDiff(AGREE_PX)
        blocks.setUniquenessRatio(UNIQUE_PERCENT)
        blocks.setSpeckleWindowSize(PATCH_PX)
        blocks.setSpeckleRange(PATCH_STEP_PX)
        found = blocks.compute(*images)
    whole = found.astype(np.float32) / SUBPIXEL
    whole[found < 0] = np.nan
    # A match outside the right camera's field is none.
    seen = rectified.resampled(np.ones_like(right), 1) > 0.5
    row, column = np.indices(whole.shape)
    at = np.clip(np.nan_to_num(column - whole).astype(np.intp), 0, whole.shape[1] - 1)
    whole[~seen[row, at]] = np.nan
    return rectified.read(whole) + rectified.least_px
