"""Light traced until the noise of its paths is below a share of the sensor's, in each label.

A pilot of few paths finds what each pixel needs (`render.pathtracer.path_budget`) and is thrown away; then that many are
traced, in independent blocks, whose scatter says what was reached. The pilot knows long tails badly, so labels for which it
promised too much are traced some more. Stopping where the noise looks small would bias the light: bright paths are rare, so
light that has met none looks both dark and quiet. Therefore blocks are traced in two halves, and the noise of one half decides
how many more blocks the other gets. What decides is never averaged with what it decides; the mean of both halves has no bias.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.fringe_phasor import FinestFringe, finest_fringes, white_weights
from render.light_noise import (
    SensorNoise,
    chosen,
    on_chip,
    render_to_sensor_noise,
    sensor_noise,
    through,
)
from render.pathtracer.block_light import (
    BlockLight,
    Blocks,
    add,
    phasor_variance,
    scatter_about_direct,
    trace_blocks,
)
from render.pathtracer.cut_light import cut_to_sensor_noise
from render.pathtracer.one_pass import check, require_finite, set_up
from render.pathtracer.path_budget import PILOT_PATHS, Pilot, blocks_needed, pilot_blocks
from render.pathtracer.path_kernel import DEEPEST_CUT, Pass
from render.pathtracer.pixel_centres import label_map, lit
from render.pathtracer.tile_survey import TileGrid
from render.plugins.shared_surfaces import Surfaces, shared
from render.plugins.variant import use
from render.point_spread import spread_kernel
from render.transport import RenderNoise, Transport
from scenes.acquisition.pattern_basis import Basis, basis
from scenes.scene import Scene
from scenes.scene_identity import identity
from scenes.support.errors import FringebenchWarning, RenderError, nearest
from scenes.support.memory import room_for

Floats = NDArray[np.float64]

# The survey looks around as densely as for so many samples per pixel.
SURVEY_SAMPLES = 64
# Streams of the pilot: what decides is not what is averaged.
PILOT_STREAM = 0x517CC1B7
# The pilot knows a pixel's modulation only roughly: what misses the decoder's limits by so much may still be decoded.
SLACK = 2.0
# Where the pilot promised too much, how much more is traced than the scatter asks for.
MORE = 1.1
# Fraction of the golden ratio: rounds fractions of blocks up in so many pixels as the fraction says, evenly spread.
GOLDEN = 0.6180339887498949
# Shares of the work, for progress.
PILOT_SHARE = 0.05
# Bytes for each pixel and projector in addition to the images: budgets, scatters and one chunk of lanes.
PIXEL_BYTES = 300


def trace(
    scene: Scene,
    target: float,
    seed: int = 0,
    depth: int | None = None,
    footprint: float = 1.0,
    progress: Callable[[float], None] | None = None,
    surfaces: Surfaces | None = None,
) -> Transport:
    """Trace until the light's noise is below `target` times the sensor's in the scene's `sampling.labels`."""
    depth = scene.sampling.depth if depth is None else depth
    check(samples=1, depth=depth, seed=seed, footprint=footprint)
    targets = _targets(scene, target)
    use()
    bases = tuple(basis(scene.patterns, p, p.resolution) for p in scene.projectors)
    fringes = finest_fringes(scene.patterns, bases)
    if not fringes:
        raise RenderError(
            f"{scene.patterns.kind} patterns have no fringes, so there is no noise of a phase to stop by: leave out "
            "render_noise, and give sampling.samples"
        )
    width, height = scene.camera.resolution
    tiles = TileGrid.of(scene.camera.resolution, SURVEY_SAMPLES)
    images = 2 * len(bases) * max(len(b.channels) for b in bases) + 1
    with room_for(
        (4 * (5 * images + 6 * len(bases) * len(fringes)) + PIXEL_BYTES) * width * height
        + tiles.memory,
        f"tracing {width} x {height} pixels of {images} channels (2 x projectors x channels + 1)",
        "lower camera.resolution, or trace fewer periods or axes at a time",
    ):
        made = shared(scene, surfaces)
        pass_ = set_up(scene, made, bases, tiles, depth, footprint, seed)
        return _traced(pass_, scene, made, bases, fringes, (target, targets), seed, progress)


def _targets(scene: Scene, target: float) -> dict[int, float]:
    """Each wanted label's number -> its target."""
    wanted = scene.sampling.labels or scene.labels
    for label in wanted:
        if label not in scene.labels:
            raise RenderError(
                f"sampling.labels: the scene has no label '{label}': {nearest(label, scene.labels)}"
            )
    return {scene.labels.index(label) + 1: target for label in wanted}


def _traced(
    pass_: Pass,
    scene: Scene,
    surfaces: Surfaces,
    bases: tuple[Basis, ...],
    fringes: tuple[FinestFringe, ...],
    wanted: tuple[float, dict[int, float]],
    seed: int,
    progress: Callable[[float], None] | None,
) -> Transport:
    target, targets = wanted
    width, height = scene.camera.resolution
    channels = [len(b.channels) for b in bases]
    label = label_map(pass_.scene, pass_.camera, surfaces.ids, (height, width))
    lit_px = lit(pass_.scene, pass_.camera, pass_.lights, (height, width))

    def done(start: float, share: float) -> Callable[[float], None] | None:
        return None if progress is None else lambda at: progress(start + share * at)

    def light(
        blocks: Blocks, stream: int, shown: Callable[[float], None] | None, direct: bool = False
    ) -> BlockLight:
        found = trace_blocks(pass_, width, blocks, channels, fringes, stream, shown, direct)
        require_finite(found.total, found.direct, found.ambient)
        return found

    def transport(found: BlockLight, paths: int) -> Transport:
        shape = (height, width)

        def image(values: NDArray[np.float32]) -> NDArray[np.float32]:
            """(..., row, col) of values (..., entry): the mean of halves."""
            halves = values.shape[-1] // label.size
            images: NDArray[np.float32] = values.reshape(*values.shape[:-1], *shape, halves).mean(
                -1
            )
            return images

        return Transport(
            image(found.total),
            image(found.direct),
            image(found.ambient),
            label,
            scene.labels,
            bases,
            scene,
            seed,
            max(round(paths / label.size), 1),
            pass_.depth,
            identity=identity(scene),
        )

    indirect = pass_.depth > 1 or pass_.ambient is not None
    most = scene.sampling.most_samples
    first = pilot_blocks(label)
    quick = light(first, seed ^ PILOT_STREAM, done(0.0, PILOT_SHARE), direct=True)
    rough = transport(quick, first.total_paths)
    pilot, sensor = _pilot(rough, scatter_about_direct(quick, first.number), lit_px)
    # Direct light alone is a choice; deeper paths end by chance, which cuts nothing.
    cut: Mapping[int, float] = {}
    if 1 < pass_.depth < DEEPEST_CUT:
        deep = replace(pass_, depth=DEEPEST_CUT)
        again = trace_blocks(deep, width, first, channels, fringes, seed ^ PILOT_STREAM)
        cut = cut_to_sensor_noise(quick, again, first, pilot, sensor)
    del quick
    blocks, asked_by = blocks_needed(pilot, targets, most, indirect, pass_.lens)
    blocks = blocks.halved()
    final = light(blocks, seed, done(PILOT_SHARE, 0.9 - PILOT_SHARE))
    number, paths = blocks.number, blocks.total_paths
    traced = [(np.repeat(np.arange(number.size), number), final.phasor[0])]
    known = (len(fringes), len(bases), height, width)
    noise = [np.sqrt(v).reshape(*known, 2) for v in phasor_variance(traced, number, 1)]
    halves = [
        chosen(on_chip(_with_noise(rough, [part[..., half] for part in noise])), sensor) ** 2
        for half in (0, 1)
    ]
    del rough
    entry, more = _more(blocks, asked_by, _excess(halves, pilot, targets), most)
    if entry.size:
        extra = blocks.more(entry, more)
        new = light(extra, seed, None)
        number, paths = add(final, number, new, more, entry), paths + extra.total_paths
        traced.append((np.repeat(entry, more), new.phasor[0]))
        del new
    noise = [np.sqrt(v).reshape(known) for v in phasor_variance(traced, number, 2)]
    result = _with_noise(transport(final, paths), noise)
    ratios = render_to_sensor_noise(result, lit_px)
    reached = RenderNoise(
        target,
        {scene.labels[n - 1]: ratios.get(scene.labels[n - 1]) for n in targets},
        paths,
        {scene.labels[n - 1]: ratio for n, ratio in cut.items() if n in targets},
    )
    if not reached.met:
        warnings.warn(_unmet(reached, most), FringebenchWarning, stacklevel=4)
    return replace(result, render_noise=reached)


def _with_noise(transport: Transport, noise: Sequence[NDArray[np.float32]]) -> Transport:
    phase, amplitude = noise
    return replace(transport, noise_rad=phase, amplitude_noise=amplitude)


def _excess(halves: Sequence[Floats], pilot: Pilot, targets: dict[int, float]) -> Floats:
    """Variance of each half over what its label may have, (label, half); 0 where nothing is known.

    What a pixel's sensor adds is taken from the pilot, which neither half is part of.
    """
    excess = np.zeros((int(pilot.label.max()) + 1, 2))
    for label, target in targets.items():
        for half, variance in enumerate(halves):
            at = pilot.scored & (pilot.label == label) & np.isfinite(variance)
            if at.any():
                # The mean of both halves has half the variance.
                mean = variance[at].mean() / 2.0
                excess[label, half] = mean / (target**2 * np.mean(pilot.sensor_rad[at] ** 2))
    return excess


def _more(
    blocks: Blocks, asked_by: NDArray[np.uint16], excess: Floats, most_paths: int
) -> tuple[NDArray[np.intp], NDArray[np.uint32]]:
    """Entries that get more blocks, and how many: each half as the other half's noise asks for."""
    other = excess[asked_by.ravel()[blocks.pixel], 1 - np.arange(blocks.pixel.size) % 2]
    wanted = blocks.number * np.where(other > 1.0, MORE * other - 1.0, 0.0)
    wanted = np.floor(wanted + GOLDEN * blocks.pixel % 1.0)
    room = most_paths // (2 * blocks.paths) - blocks.number.astype(np.int64)
    more = np.clip(wanted, 0, np.maximum(room, 0)).astype(np.uint32)
    entry = np.flatnonzero(more)
    return entry, more[entry]


def _pilot(
    transport: Transport, varies: Floats, lit: NDArray[np.bool_]
) -> tuple[Pilot, SensorNoise]:
    """What the pilot says of the projector and the axis that measure each pixel, and which they are."""
    strict, sensor = sensor_noise(transport), sensor_noise(transport, SLACK)
    assert strict is not None  # there is a fringe
    assert sensor is not None
    shape = transport.label.shape
    fringes = finest_fringes(transport.scene.patterns, transport.bases)
    phasor, indirect = [], []
    for p, b in enumerate(transport.bases):
        channels = slice(len(b.channels))
        fringe = fringes[sensor.fringe[p]]
        # Few paths know direct light well; half of all light serves where there is hardly any.
        own, all_light = (
            cosine + 1j * sine
            for light in (transport.direct, transport.total)
            for cosine, sine in (fringe.phasor(light[p, channels], p),)
        )
        phasor.append(np.where(np.abs(own) >= np.abs(all_light) / 2.0, own, all_light / 2.0))
        white = white_weights(b)
        indirect.append(
            np.tensordot(white, transport.total[p, channels] - transport.direct[p, channels], 1)
        )

    def pick(images: list[NDArray[Any]]) -> NDArray[Any]:
        return np.asarray(np.take_along_axis(np.stack(images), sensor.projector[None], axis=0)[0])

    direct, later = (
        np.stack([chosen(way.reshape(*way.shape[:2], *shape), sensor) for way in part])
        for part in varies
    )
    counted = lit & np.isfinite(sensor.phase_rad) & np.isfinite(direct[0] + later[0])
    kernel = spread_kernel(transport.scene.sensor)
    sharp: NDArray[np.complex128] = pick(phasor)
    pilot = Pilot(
        transport.label,
        counted & np.isfinite(strict.phase_rad),
        counted,
        sharp,
        sharp if kernel is None else through(sharp, kernel),
        kernel,
        pick(indirect).astype(np.float64),
        sensor.phase_rad,
        later * PILOT_PATHS,
        direct,
    )
    return pilot, sensor


def _unmet(noise: RenderNoise, most: int) -> str:
    worst = {k: v for k, v in noise.reached.items() if v is not None and v > noise.target}
    said = ", ".join(f"{label} {ratio:.2g}" for label, ratio in worst.items())
    return (
        f"noise of light paths over the sensor's: {said}; {noise.target:g} was asked for: raise sampling.most_samples "
        f"({most}), or ask for less"
    )
