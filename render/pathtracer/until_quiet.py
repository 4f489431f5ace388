"""Light traced until the noise of its paths is below a share of the sensor's, in each label.

A pilot of few paths finds what each pixel needs (`render.pathtracer.path_budget`) and is thrown away; then half as many are
traced, in independent blocks, whose scatter says how many more are needed, pixel by pixel. Stopping where the noise looks
small would bias the light: bright paths are rare, so light that has met none looks both dark and quiet. Therefore blocks are
traced in two halves, and one half decides how many more blocks the other gets. What decides is never averaged with what it
decides; the mean of both halves has no bias.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from render.fringe_phasor import FinestFringe, finest_fringes
from render.light_noise import render_to_sensor_noise
from render.pathtracer.block_light import BlockLight, Blocks, add, phasor_variance, trace_blocks
from render.pathtracer.cut_light import cut_to_sensor_noise, judged_pixels
from render.pathtracer.one_pass import check, require_finite, set_up
from render.pathtracer.path_budget import blocks_needed, pilot_blocks
from render.pathtracer.path_kernel import DEEPEST_CUT, Pass
from render.pathtracer.pilot import first_pilot, mean_images, more_of_halves
from render.pathtracer.pixel_centres import label_map, lit
from render.pathtracer.tile_survey import TileGrid
from render.plugins.shared_surfaces import Surfaces, shared
from render.plugins.variant import use
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
# Shares of the work, for progress.
PILOT_SHARE, FIRST_SHARE = 0.05, 0.5
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
        (4 * (5 * images + 9 * len(bases) * len(fringes)) + PIXEL_BYTES) * width * height
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
        per_pixel = max(round(paths / label.size), 1)
        return Transport(
            *mean_images(found, label.shape),
            label,
            scene.labels,
            bases,
            scene,
            seed,
            per_pixel,
            pass_.depth,
            identity=identity(scene),
        )

    indirect = pass_.depth > 1 or pass_.ambient is not None
    most = scene.sampling.most_samples
    first = pilot_blocks(label, pass_.lens)
    quick = light(first, seed ^ PILOT_STREAM, done(0.0, PILOT_SHARE), direct=True)
    rough = transport(quick, first.total_paths)
    pilot, sensor = first_pilot(quick, first, rough, lit_px)
    # Direct light alone is a choice; deeper paths end by chance, which cuts nothing.
    cut: Mapping[int, float] = {}
    if 1 < pass_.depth < DEEPEST_CUT:
        deep = replace(pass_, depth=DEEPEST_CUT)
        pixels = judged_pixels(pilot)
        if pixels.size:
            stream = seed ^ PILOT_STREAM
            again = trace_blocks(deep, width, first.of(pixels), channels, fringes, stream)
            cut = cut_to_sensor_noise(quick, again, first, pixels, pilot, sensor)
    del quick, rough
    blocks = blocks_needed(pilot, targets, most, indirect, pass_.lens).halved()
    final = light(blocks, seed, done(PILOT_SHARE, FIRST_SHARE))
    number, paths = blocks.number, blocks.total_paths
    traced = [(np.repeat(np.arange(number.size), number), final.phasor[0])]
    more = more_of_halves(
        final, phasor_variance(traced, number, 1)[:2], blocks, targets, most, lit_px, transport
    )
    entry = np.flatnonzero(more)
    more = more[entry]
    if entry.size:
        extra = blocks.more(entry, more)
        new = light(extra, seed, done(PILOT_SHARE + FIRST_SHARE, 1.0 - PILOT_SHARE - FIRST_SHARE))
        number, paths = add(final, number, new, more, entry), paths + extra.total_paths
        traced.append((np.repeat(entry, more), new.phasor[0]))
        del new
    known = (len(fringes), len(bases), height, width)
    phase, along, both = (v.reshape(known) for v in phasor_variance(traced, number, 2))
    result = replace(
        transport(final, paths),
        noise_rad=np.sqrt(phase),
        amplitude_noise=np.sqrt(along),
        noise_correlation=both,
    )
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


def _unmet(noise: RenderNoise, most: int) -> str:
    worst = {k: v for k, v in noise.reached.items() if v is not None and v > noise.target}
    said = ", ".join(f"{label} {ratio:.2g}" for label, ratio in worst.items())
    return (
        f"noise of light paths over the sensor's: {said}; {noise.target:g} was asked for: raise sampling.most_samples "
        f"({most}), or ask for less"
    )
