"""Light traced until its own noise moves phases less than asked for: independent passes, averaged, their scatter watched.

What counts is the phase of the finest fringe, for it sets the height; coarser ones only number it. A fringe's phasor
``Z = (C, S) = B (cos phi, sin phi)`` is linear in the basis channels, and to first order a deviation ``(dC, dS)`` of it is
one of phase by ``(C dS - S dC) / B^2``.

How far the mean of n passes is off is seen from what it would be with half of the passes counted negative: such a sum,
``(Z_1 - Z_2 + Z_3 - ...) / n``, has no signal left, and the noise of the mean to the last of its even moments. Passes come
in stages of eight, of which there are seven orthogonal such halvings (balanced half-samples: McCarthy 1969). Their squares'
mean is the usual variance of the mean between passes; but their sizes, over all pixels, are drawn from the very
distribution whose 95th percentile is wanted. Standard errors of pixels would have to be turned into it by a normal law,
which is wrong where light comes by rare bright paths: on solder it gave three quarters of the true percentile.

Stopping as soon as a noisy estimate falls below the target would stop too early on average. So a stage is planned from
the scatter before it (Stein 1945); its end alone is looked at; there an upper confidence bound must be below the target;
and the k-th look may err with probability 0.05 / 2^k only, all looks together with 0.05.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard
from scipy.stats import norm

from render.fringe_phasor import FinestFringe, finest_fringes
from render.pathtracer.one_pass import trace as one_pass
from render.pathtracer.until_quiet import trace as until_quiet
from render.plugins.shared_surfaces import Surfaces, shared
from render.transport import PhaseError, Transport
from scenes.acquisition.fringe_fit import STRAY_FRACTION
from scenes.acquisition.pattern_basis import Basis, basis
from scenes.acquisition.patterns import Patterns
from scenes.scene import MIN_PHASE_ERROR_RAD, Scene
from scenes.scene_identity import identity
from scenes.support.errors import FringebenchWarning, RenderError
from scenes.support.memory import room_for

Floats = NDArray[np.float64]

# Passes between two looks.
STAGE = 8
HALVINGS = hadamard(STAGE)[1:].astype(np.float64)
# Passes from which the bar's forecast is fair.
FORECAST = 4
# The share of pixels that must stay below the error, and the risk that they do not although the bound says so.
SHARE = 0.95
RISK = 0.05
# More samples by this than the scatter asks for, since it is itself an estimate; and never more than so many times those
# taken: what the first passes say of rare bright paths is not to be trusted further.
MARGIN = 1.1
GROWTH = 4.0
# Pixels whose phase is watched, drawn at random where there are more: 95 % of them are 95 +- 0.09 % of all.
WATCHED = 1 << 16


def trace(
    scene: Scene,
    seed: int = 0,
    samples: int | None = None,
    depth: int | None = None,
    footprint: float = 1.0,
    progress: Callable[[float], None] | None = None,
    phase_error_rad: float | None = None,
    surfaces: Surfaces | None = None,
    render_noise: float | None = None,
) -> Transport:
    """Trace the scene's light transport, for all its patterns, once or until the phase is known well enough.

    The same seed gives the same bits on one machine.

    Parameters
    ----------
    scene
        The scene.
    seed
        Seed of the light paths, 0 or more.
    samples
        As `scenes.Sampling.samples`, of one pass; None: the scene's.
    depth
        Largest number of surfaces that light meets; None: the scene's; 1: direct light only.
    footprint
        Width of the area that a pixel sees relative to the pixel, 0 to 1; 0: a point.
    progress
        Called about every second with the fraction done; its method ``detail``, if any, gets the number of the pass.
    phase_error_rad
        Passes are averaged until the render noise of the finest fringe's phase is below this in 95 % of the lit pixels,
        rad; None: the scene's ``sampling.phase_error_rad``, unless `samples` is given. A pixel lit by several projectors
        counts with the one of largest modulation; of two fringe axes the worse counts.
    surfaces
        Geometry from `render.surfaces`, to reuse it across calls.
    render_noise
        Stop when each label of ``sampling.labels`` has at most this share of the sensor's noise in the height, both as RMS
        over lit pixels; None: the scene's ``sampling.render_noise``, unless `samples` is given.

    Returns
    -------
    Transport
        Radiance (projector, channel, row, col), and in `phase_error` what was reached; in `second` that of a second camera.

    Raises
    ------
    RenderError
        For impossible arguments, patterns without fringes with `phase_error_rad`, or light beyond float32.
    TooLargeError
        If there are more pixels and channels than memory holds.

    Warns
    -----
    FringebenchWarning
        If ``sampling.most_samples`` are not enough, or no pixel shows a fringe.

    Notes
    -----
    Only noise is measured. An error that all passes share (too small a `depth`, a pixel's width) is not included, nor is a
    path so rare that no pass has found it.

    Examples
    --------
    >>> import scenes, render
    >>> scene = scenes.load("step", {"camera.resolution": [32, 24], "sampling.samples": 8})
    >>> light = render.trace(scene, phase_error_rad=0.05)
    >>> light.phase_error.met, light.phase_error.bound_rad < 0.05
    (True, True)
    """
    if scene.second_camera is not None:
        limits = samples, depth, footprint, progress, phase_error_rad
        alone = scene.model_copy(update={"second_camera": None})
        views = [
            trace(view, number, *limits, shared(scene, surfaces), render_noise)
            for view, number in ((alone, seed), (scene.second_view(), second_seed(seed)))
        ]
        return replace(views[0], scene=scene, second=views[1], identity=identity(scene))
    target = phase_error_rad
    if target is None and render_noise is None and samples is None:
        target, render_noise = scene.sampling.phase_error_rad, _wanted_noise(scene)
    if target is None and render_noise is not None:
        if samples is not None:
            raise RenderError(
                f"samples = {samples} and render_noise = {render_noise:g}: give one of the two; with render_noise, paths are as "
                "many as it takes"
            )
        return until_quiet(scene, render_noise, seed, depth, footprint, progress, surfaces)
    if target is None:
        return one_pass(scene, seed, samples, depth, footprint, progress, surfaces)
    if not MIN_PHASE_ERROR_RAD <= target <= 1.0:
        raise RenderError(
            f"phase_error_rad = {target!r}: needs a number from {MIN_PHASE_ERROR_RAD:g} (float32 holds no finer phase) to 1"
        )
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise RenderError(f"seed = {seed!r}: needs a whole number from 0 up")
    size = scene.sampling.samples if samples is None else samples
    most = scene.sampling.most_samples
    if STAGE * size > most:
        raise RenderError(
            f"sampling.most_samples = {most} has no room for the {STAGE} passes of {size} samples from which the phase error "
            f"is first judged: lower sampling.samples to {max(most // STAGE, 1)}, or raise most_samples"
        )

    def one(number: int, paths: int, shown: Callable[[float], None] | None) -> Transport:
        # Drawn at random, not counted up: neighbouring seeds of a hash or a generator need not be independent.
        own = np.random.SeedSequence(int(seed), spawn_key=(number,)).generate_state(1, np.uint32)
        return one_pass(scene, int(own[0]), paths, depth, footprint, shown, found)

    width, height = scene.camera.resolution
    bases = [basis(scene.patterns, p, p.resolution) for p in scene.projectors]
    images = 2 * len(bases) * max(len(b.channels) for b in bases) + 1
    with room_for(
        2 * 4 * images * width * height,
        f"averaging passes of {width} x {height} pixels of {images} channels",
        "lower camera.resolution, or trace fewer periods or axes at a time",
    ):
        found = shared(scene, surfaces)
        watch = _watches(scene.patterns, bases, width * height, int(seed))
        return _refined(one, watch, target, (size, most), progress, int(seed))


def second_seed(seed: int) -> int:
    """Seed of the second camera's light paths: noise that both cameras share would look like texture."""
    return seed ^ 0x9E3779B9


def _wanted_noise(scene: Scene) -> float | None:
    """The scene's own `render_noise`, where its patterns have a phase to judge by."""
    fringes = any(frame.kind == "fringe" for frame in scene.patterns.frames())
    return scene.sampling.render_noise if fringes else None


def _refined(
    one: Callable[[int, int, Callable[[float], None] | None], Transport],
    watch: "Sequence[_Watch]",
    target: float,
    limits: tuple[int, int],
    progress: Callable[[float], None] | None,
    seed: int,
) -> Transport:
    first, most = limits
    size, look = first, 0
    mean = None
    shown = _Shown(progress, target, most)
    while True:
        shown.stage(watch[0].weight + STAGE * size)
        for _ in range(STAGE):
            number, before = watch[0].passes, watch[0].weight
            shown.starts(number, before, size, _worst(watch, RISK) if number >= FORECAST else None)
            new = one(number, size, shown.within if progress else None)
            for axis in watch:
                axis.add(new, size)
            mean = new if mean is None else _averaged(mean, new, size / watch[0].weight)
        look += 1
        found = _worst(watch, RISK / 2.0**look)
        weight = watch[0].weight
        wanted = weight * GROWTH
        if found is not None:
            wanted = min(wanted, weight * (found[1] / target) ** 2 * MARGIN)
        size = min(max(first, _even((wanted - weight) / STAGE)), (most - weight) // STAGE)
        if found is None or found[1] <= target or size < first:
            break
    assert mean is not None
    reached, bound, pixels = found or (None, None, 0)
    error = PhaseError(target, reached, bound, watch[0].passes, pixels)
    if not error.met:
        warnings.warn(_unmet(error, weight, most), FringebenchWarning, stacklevel=3)
    if progress:
        progress(1.0)
    return replace(mean, seed=seed, samples=weight, phase_error=error)


def _unmet(error: PhaseError, samples: int, most: int) -> str:
    if error.reached_rad is None:
        return (
            "no pixel shows a fringe, so there is no phase error to bring down: traced "
            f"{samples} samples; see that the projectors light what the camera sees"
        )
    return (
        f"phase error {error.reached_rad:.2g} rad (95 % sure: below {error.bound_rad:.2g}) after {samples} samples per pixel, "
        f"{error.target_rad:.2g} were asked for: raise sampling.most_samples ({most}), or ask for less"
    )


def _even(samples: float) -> int:
    return 2 * int(np.ceil(samples / 2.0))


def _averaged(mean: Transport, new: Transport, share: float) -> Transport:
    """`mean` moved by `share` towards `new`, in place, image by image: memory for one pass more, however many there are."""
    for have, more in (
        (mean.total, new.total),
        (mean.direct, new.direct),
        (mean.ambient[None, None], new.ambient[None, None]),
    ):
        for p in range(have.shape[0]):
            for c in range(have.shape[1]):
                have[p, c] += np.float32(share) * (more[p, c] - have[p, c])
    (phase, along, both), (other, beside, rest) = _noise(mean, 1.0 - share), _noise(new, share)
    noise, amplitude = np.hypot(phase, other), np.hypot(along, beside)
    with np.errstate(divide="ignore", invalid="ignore"):
        shared_part = (both * phase * along + rest * other * beside) / (noise * amplitude)
    correlation = np.nan_to_num(shared_part)
    return replace(mean, noise_rad=noise, amplitude_noise=amplitude, noise_correlation=correlation)


def _noise(light: Transport, share: float) -> list[NDArray[np.float32]]:
    """Deviations of the phase and of the modulation of this share of the light, and their correlation."""
    assert light.noise_rad is not None  # there is a fringe to watch
    assert light.amplitude_noise is not None
    assert light.noise_correlation is not None
    return [share * light.noise_rad, share * light.amplitude_noise, light.noise_correlation]


class _Watch:
    """Phasor of one axis's finest fringe at the watched pixels: its mean over passes, and its halvings."""

    def __init__(self, fringe: FinestFringe, pixels: NDArray[np.intp]) -> None:
        self.passes, self.weight = 0, 0
        self._fringe, self._pixels = fringe, pixels
        projectors = len(fringe.terms)
        self._sum = np.zeros((projectors, 2, pixels.size))
        self._halved = np.zeros((projectors, len(HALVINGS), 2, pixels.size))

    def add(self, light: Transport, samples: int) -> None:
        """Take in a pass."""
        signs = samples * HALVINGS[:, self.passes % STAGE]
        self.passes += 1
        self.weight += samples
        for p, own in enumerate(light.bases):
            channels = light.total[p, : len(own.channels)].reshape(len(own.channels), -1)
            phasor = self._fringe.phasor(channels[:, self._pixels], p)
            self._sum[p] += samples * phasor
            self._halved[p] += signs[:, None, None] * phasor

    def errors_rad(self) -> Floats:
        """(halving, pixel) estimate of the error of the mean's phase, at every watched pixel that shows a fringe."""
        power = (self._sum**2).sum(axis=1)
        best = power.argmax(axis=0)
        c, s = np.take_along_axis(self._sum, best[None, None], axis=0)[0]
        halved = np.take_along_axis(self._halved, best[None, None, None], axis=0)[0]
        modulation = np.hypot(c, s)
        shows = modulation > 0.0
        if shows.any():
            shows &= modulation >= STRAY_FRACTION * np.median(modulation[shows])
        c, s, halved = c[shows], s[shows], halved[..., shows]
        return np.asarray(np.abs(c * halved[:, 1] - s * halved[:, 0]) / (c * c + s * s))


def _watches(
    patterns: Patterns, bases: Sequence[Basis], pixels: int, seed: int
) -> tuple[_Watch, ...]:
    """The finest fringe of each axis; `RenderError` where there is none."""
    fringes = finest_fringes(patterns, bases)
    if not fringes:
        raise RenderError(
            f"{patterns.kind} patterns have no fringes, so there is no phase error: leave out phase_error_rad, and give "
            "sampling.samples"
        )
    chosen = np.arange(pixels)
    if pixels > WATCHED:
        chosen = np.sort(np.random.default_rng(seed).choice(pixels, WATCHED, replace=False))
    return tuple(_Watch(fringe, chosen) for fringe in fringes)


def _worst(watch: Sequence[_Watch], risk: float) -> tuple[float, float, int] | None:
    """Error of the axis with the greatest bound: error, bound, pixels; None where one shows no fringe."""
    errors = [axis.errors_rad() for axis in watch]
    if any(error.size == 0 for error in errors):
        return None
    return max(
        ((*percentile(error, risk), error.shape[1]) for error in errors), key=lambda found: found[1]
    )


def percentile(errors: Floats, risk: float) -> tuple[float, float]:
    """Size that 95 % of the errors (halving, pixel) stay below, and its upper bound at that risk; infinite for too few.

    Pixels are independent, the halvings of one are not: the share of errors beyond is a mean over pixels, and has the
    standard error of one. The bound is the percentile of the share that is so much smaller.
    """
    size = float(np.quantile(errors, SHARE))
    beyond = (errors > size).mean(axis=0)
    surely = SHARE + float(norm.isf(risk)) * float(np.std(beyond)) / np.sqrt(beyond.size)
    return size, float(np.quantile(errors, surely)) if surely < 1.0 else np.inf


@dataclass
class _Shown:
    """Progress to show: the share of the samples that will probably be needed."""

    progress: Callable[[float], None] | None
    target: float
    most: int
    _end: float = 0.0
    _before: int = 0
    _size: int = 0
    _share: float = 0.0

    def stage(self, end: int) -> None:
        """A stage begins that goes up to so many samples."""
        self._end = float(end)

    def starts(
        self, number: int, before: int, size: int, found: tuple[float, float, int] | None
    ) -> None:
        """A pass begins, after what was found so far: no look, only a forecast."""
        self._before, self._size = before, size
        if found is not None:
            self._end = max(self._end, min(before * (found[1] / self.target) ** 2, self.most))
        detail = getattr(self.progress, "detail", None)
        if detail is not None:
            detail(f"pass {number + 1}, {before} of about {self._end:.0f} samples")

    def within(self, share: float) -> None:
        """The pass is so far; a forecast that grew does not turn the bar back."""
        assert self.progress is not None
        self._share = max(self._share, (self._before + share * self._size) / self._end)
        self.progress(min(self._share, 0.999))
