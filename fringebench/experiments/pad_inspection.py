"""Paste inspection of a scene: pads against the truth, an error budget and a gauge study."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import decode
import render
import scenes
from evaluation.inspection.pad_limits import (
    Confusion,
    PadErrors,
    PadLimits,
    confusion,
    pad_errors,
    threshold_shares,
)
from evaluation.inspection.pad_measurement import THRESHOLD_MM, PadMeasure, measure_pads
from evaluation.inspection.repeatability import GaugeStudy, gauge_study
from evaluation.scoring.error_budget import RENDER_NOISE
from fringebench.experiments.cause_budget import CAUSES, RANDOM, has_cause, without_causes
from fringebench.progress import Steps
from scenes.acquisition.sensor import without_blur
from scenes.board.board import Board
from scenes.board.board_settings import BoardRegion
from scenes.shapes.materials import Diffuse
from scenes.support.errors import SceneError, ScoreError

# Paint of the ideal board: about the reflectance of diffuse mask and paste.
PAINT = Diffuse(reflectance=0.5)
# Causes of devices and of time, which have a row where the scene has them.
DEVICES = tuple(c for c in CAUSES[4:] if c != "footprint")
# A threshold above rounding: a fiftieth of a deposit's height.
FAINT_MM = 0.002
# Pads smaller than this have budgets of their own.
SMALL_MM = 0.299


@dataclass(frozen=True)
class Inspection:
    """A board's pads as measured, and how that compares with what was printed."""

    scene: scenes.Scene
    board: scenes.BoardTruth
    measured: tuple[PadMeasure, ...]
    threshold_mm: float
    errors: PadErrors
    confusion: Confusion
    threshold_bias_percent: float
    """Mean share of volume that the threshold alone removes, from the meshes, as a negative percentage."""


def inspect(
    scene: scenes.Scene,
    seed: int = 0,
    threshold_mm: float = THRESHOLD_MM,
    limits: PadLimits | None = None,
    steps: Steps | None = None,
    **choices: Any,
) -> Inspection:
    """Trace, expose, decode and measure a board once; `threshold_mm` above the pad paste counts; `choices` are those of
    `decode.reconstruct`.
    """
    _require_board(scene)
    steps = steps or Steps()
    with steps.step("trace light") as done:
        transport = render.trace(scene, seed=seed, progress=done)
    with steps.step("measure"):
        stack = render.expose(transport, seed=seed)
        return inspect_stack(stack, scene, threshold_mm, limits, **choices)


def inspect_stack(
    stack: scenes.Stack,
    scene: scenes.Scene,
    threshold_mm: float = THRESHOLD_MM,
    limits: PadLimits | None = None,
    **choices: Any,
) -> Inspection:
    """Decode and measure the frames of a scene's board, see `inspect`."""
    printed = _require_board(scene)
    board = scenes.board_truth(scene)
    measured = measure_pads(decode.reconstruct(stack, **choices), board, threshold_mm=threshold_mm)
    shares = [volume for _, volume in threshold_shares(printed, threshold_mm).values()]
    return Inspection(
        scene,
        board,
        measured,
        threshold_mm,
        pad_errors(measured, board),
        confusion(measured, board, limits),
        100.0 * (float(np.mean(shares)) - 1.0) if shares else 0.0,
    )


def measure_capture(
    stack: scenes.Stack, scene: scenes.Scene, threshold_mm: float = THRESHOLD_MM, **choices: Any
) -> tuple[scenes.BoardTruth, tuple[PadMeasure, ...]]:
    """The artwork's nominal figures, and the pads measured in calibrated frames of a real board; see `inspect`.

    The board of `scene` is placed in the world as the calibration is; its printed figures mean nothing here.
    """
    board = scenes.board_truth(scene)
    return board, measure_pads(
        decode.reconstruct(stack, **choices), board, threshold_mm=threshold_mm
    )


def pad_budget(
    scene: scenes.Scene, seed: int = 0, steps: Steps | None = None, **choices: Any
) -> dict[str, PadErrors]:
    """Errors of pads of 0.3 mm and more under one cause at a time, under none and under all.

    ``ideal``: every surface diffuse and equally bright, direct light alone, no noise, all projectors, a threshold of
    2 um; what is left is the rig's own, pixels and shadows. Then one at a time: ``one projector`` (where the scene has
    more), ``metal`` (the board's real materials), ``grains``, ``interreflection``, ``noise``, ``threshold`` (40 um), and those causes of `budget` that are of
    `DEVICES` and that the scene has; ``render-noise``, drawn for each pixel with the deviation that the light of ``all`` states; ``metal,
    interreflection`` together, which do what neither does alone: metal throws light onto its neighbours; these and ``grains``, whose dark
    walls it outshines; and ``all`` of them but the single projector. The deposits are the same throughout, and so is their truth.

    Raises `SceneError` for a scene without a board, `ScoreError` where it has no pad of 0.3 mm.
    """
    _require_board(scene)
    steps = steps or Steps()
    depth = scene.sampling.depth
    lights: dict[frozenset[str], render.Transport] = {}

    optics = frozenset({"metal", "grains", "interreflection", *DEVICES}) - {
        "psf",
        "rolling-shutter",
    }

    def errors(*causes: str, scatter_mm: NDArray[np.float32] | None = None) -> PadErrors:
        on = frozenset(causes)
        optical = on & optics
        variant = _variant(without_causes(scene, frozenset(DEVICES) - on), optical, depth)
        if optical not in lights:
            with steps.step("trace light: " + (", ".join(sorted(optical)) or "ideal")) as done:
                lights[optical] = render.trace(variant, seed=seed, progress=done)
        with steps.step("measure"):
            sensor = without_causes(scene, frozenset({"rolling-shutter"}) - on).sensor
            stack = render.expose(
                lights[optical],
                seed=seed,
                sensor=sensor if "psf" in on else without_blur(sensor),
                noise="noise" in on,
                steady=not on & RANDOM & set(DEVICES),
            )
            single = {"projector": 0} if "one projector" in on else {}
            rec = decode.reconstruct(stack, **(choices | single))
            if scatter_mm is not None:
                drawn = np.random.default_rng(seed).standard_normal(scatter_mm.shape)
                height = rec.height_mm + drawn * np.nan_to_num(scatter_mm)
                rec = replace(rec, height_mm=height.astype(np.float32))
            threshold = THRESHOLD_MM if "threshold" in on else FAINT_MM
            board = scenes.board_truth(variant)
            return pad_errors(measure_pads(rec, board, threshold_mm=threshold), board, SMALL_MM)

    causes = ["metal", "grains", "interreflection", "noise", "threshold"]
    causes += [cause for cause in DEVICES if has_cause(scene, cause)]
    rows = {"ideal": errors()}
    if len(scene.projectors) > 1:
        rows["one projector"] = errors("one projector")
    rows |= {cause: errors(cause) for cause in causes}
    together = (("metal", "interreflection"), ("metal", "grains", "interreflection"))
    groups = {", ".join(group): errors(*group) for group in together} | {"all": errors(*causes)}
    light = lights[frozenset(causes) & optics]
    scatter_mm = render.truth(light.scene, light).render_noise_mm
    if scatter_mm is not None:
        rows[RENDER_NOISE] = errors(scatter_mm=scatter_mm)
    return rows | groups


def gauge(
    scene: scenes.Scene,
    seed: int = 0,
    appraisers: int = 3,
    repeats: int = 3,
    shift_mm: float = 0.3,
    threshold_mm: float = THRESHOLD_MM,
    tolerance_percent: float = 100.0,
    steps: Steps | None = None,
    **choices: Any,
) -> GaugeStudy:
    """Gauge study of pad volumes in percent of nominal: each appraiser is another sensor over another place of the board.

    Appraiser k sees the board moved by k steps of `shift_mm` along x and y, by a sensor with a fixed pattern of its own;
    repeats differ in noise. Pads that leave the field for one appraiser, were not printed, or could not be measured every
    time are left out. `tolerance_percent` is the width of the tolerance: 100 for 50 to 150 % of nominal.

    Raises `ScoreError` where fewer than two pads remain, `SceneError` for a scene without a board.
    """
    _require_board(scene)
    steps = steps or Steps()
    taken: dict[tuple[int, int], dict[int, float]] = {}
    nominal: dict[int, float] = {}
    for a in range(appraisers):
        moved = _moved(scene, a * shift_mm)
        board = scenes.board_truth(moved)
        nominal |= {p.pad: p.nominal_volume_mm3 for p in board.pads if p.volume_mm3 > 0.0}
        with steps.step(f"trace light, place {a + 1}") as done:
            transport = render.trace(moved, seed=seed, progress=done)
        with steps.step("measure"):
            for r in range(repeats):
                noise = int(np.random.SeedSequence((seed, a, r)).generate_state(1)[0])
                stack = render.expose(transport, seed=noise, chip_seed=seed + a)
                pads = measure_pads(
                    decode.reconstruct(stack, **choices), board, threshold_mm=threshold_mm
                )
                taken[a, r] = {p.pad: p.volume_mm3 for p in pads if p.volume_mm3 is not None}
    common = sorted(set(nominal).intersection(*map(set, taken.values())))
    if len(common) < 2:
        raise ScoreError(
            f"only {len(common)} pads were measured every time: a study needs 2; reduce shift_mm ({shift_mm}) or look at "
            "why pads are not measured"
        )
    values = [
        [
            [100.0 * taken[a, r][pad] / nominal[pad] for r in range(repeats)]
            for a in range(appraisers)
        ]
        for pad in common
    ]
    return gauge_study(values, tolerance_percent)


def _require_board(scene: scenes.Scene) -> Board:
    if scene.board is None:
        raise SceneError(f"scene '{scene.name}' has no board: only boards have pads to measure")
    scene.calibration().require_projectors("a measurement of pads")
    return scene.board


def _variant(scene: scenes.Scene, on: frozenset[str], depth: int) -> scenes.Scene:
    """The scene with ideal surfaces and light except for what is on."""
    board = scene.board
    assert board is not None
    texture = "granular" if "grains" in on else "smooth"
    board = board.model_copy(update={"paste": board.paste.model_copy(update={"texture": texture})})
    materials = scene.materials
    if "metal" not in on:
        # The same names, so that every surface keeps its label.
        materials = materials | dict.fromkeys(board.materials, PAINT)
    light = scene.sampling.model_copy(update={"depth": depth if "interreflection" in on else 1})
    return scene.model_copy(update={"board": board, "materials": materials, "sampling": light})


def _moved(scene: scenes.Scene, by_mm: float) -> scenes.Scene:
    """The same board seen from elsewhere: its region moves, its deposits do not."""
    if by_mm == 0.0:
        return scene
    board = scene.board
    assert board is not None
    x0, y0, x1, y1 = board.layout().box
    region = BoardRegion(
        centre_mm=((x0 + x1) / 2 + by_mm, (y0 + y1) / 2 + by_mm), size_mm=(x1 - x0, y1 - y0)
    )
    return scene.model_copy(
        update={"board": board.model_copy(update={"region": region, "pads": ()})}
    )
