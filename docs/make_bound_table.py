"""How near fusion comes to the Cramer-Rao bound, by distance from clipping: the table of docs/comparing.md.

    python docs/make_bound_table.py

Light of `chapter-trap` is exposed with many seeds, at the four exposures that `compare` gives this scene. The exact maximum of the
likelihood is found in float64 by Newton's method, with SciPy's normal distribution, independently of `censored-ml`.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

import decode
import render
import scenes
from decode.phase import wrap
from evaluation import scored
from evaluation.theory.cramer_rao import FringeLight, efficiency, phase_bound_rad2
from fringebench.experiments.hdr_comparison import LADDER, MARGIN_PX

RULES = ("masked-least-squares", "censored-ml")
LABELS = ("base", "step", "cap", "highlight")
SEEDS, PIXELS = 48, 4000
# Distance in sigma of the expected sample nearest to saturation.
CLASSES = ((0.0, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, np.inf))
Floats = NDArray[np.float64]


def most_likely(dn: Floats, time: Floats, wave: Floats, sigma2: float, start: Floats) -> Floats:
    """Offset and phasor (3, problem) that make samples (exposure, step, problem) most likely; those at 0 and 255 are clipped."""
    found, sigma = start.copy(), np.sqrt(sigma2)
    design = (time[:, None, None] * wave).reshape(-1, 3)
    values = dn.reshape(len(design), -1)
    high, low = values >= 255, values <= 0
    for _ in range(60):
        mu = design @ found
        z = np.where(high, mu - 254.5, 0.5 - mu) / sigma
        ratio = np.exp(-0.5 * z**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(z))
        score = np.where(high, ratio, np.where(low, -ratio, (values - mu) / sigma)) / sigma
        bend = np.where(high | low, ratio * (z + ratio), 1.0) / sigma2
        normal = np.einsum("ia,ip,ib->pab", design, bend, design)
        change = np.linalg.solve(normal, (design.T @ score).T[..., None])[..., 0].T
        found += change
        if np.abs(change).max() < 1e-9 * np.abs(found).max():
            break
    return found


def main() -> None:
    """Print one row for each class."""
    scene = scenes.load("chapter-trap", {"sampling.samples": 4})
    light = render.trace(scene)
    truth = render.truth(scene, light)
    times_ms = tuple(render.expose(light, noise=False).exposure_ms[0] * r for r in LADDER)
    period = min(f.period_px for f in scene.frames)
    shifts = np.array([f.phase_shift_rad for f in scene.frames if f.period_px == period])
    fringe = FringeLight.of(render.through_lens(light).frames(), scene.frames, "column", period)
    bound = phase_bound_rad2(fringe, shifts.tolist(), times_ms, scene.sensor)
    means = np.stack([[scene.sensor.mean_dn(fringe.at(s), t) for s in shifts] for t in times_ms])
    sigma2 = float(scene.sensor.variance_dn2(means[0, 0], times_ms[0]).max())
    nearest = np.abs(254.5 - means).min(axis=(0, 1)) / np.sqrt(sigma2)
    region = np.any([scored(truth, label, MARGIN_PX) for label in LABELS], axis=0)
    rng = np.random.default_rng(0)
    chosen = []
    for least, most in CLASSES:
        at = np.flatnonzero(region & (nearest >= least) & (nearest < most))
        chosen.append(np.sort(rng.choice(at, min(PIXELS, at.size), replace=False)))
    mine = [i for i, f in enumerate(scene.frames) if f.period_px == period]
    wave = np.stack([np.ones(4), np.cos(shifts), -np.sin(shifts)], axis=1)
    relative = np.array(times_ms) / times_ms[-1]
    true_rad = fringe.phase_rad.ravel()
    errors: dict[str, list[list[Floats]]] = {n: [[] for _ in CLASSES] for n in (*RULES, "exact")}
    for seed in range(SEEDS):
        stack = render.expose(light, seed=seed, exposures=times_ms)
        for rule in RULES:
            phase = decode.reconstruct(stack, fusion=rule).wrapped_rad.ravel()
            for k, at in enumerate(chosen):
                errors[rule][k].append(wrap(phase[at] - true_rad[at]))
        for k, at in enumerate(chosen):
            dn = stack.frames[:, mine].reshape(len(times_ms), len(mine), -1)[..., at]
            slope = float(scene.sensor.mean_dn(1.0, times_ms[-1]))
            start = slope * np.stack(
                [x.ravel()[at] for x in (fringe.offset, fringe.cosine, fringe.sine)]
            )
            best = most_likely(dn.astype(np.float64), relative, wave, sigma2, start)
            errors["exact"][k].append(wrap(np.arctan2(best[2], best[1]) - true_rad[at]))
    print(
        "| nearest sample to saturation, sigma | pixels | masked-least-squares | censored-ml | exact maximum |"
    )
    print("|---|--:|--:|--:|--:|")
    for k, ((least, most), at) in enumerate(zip(CLASSES, chosen, strict=True)):
        share = np.mean((nearest[region] >= least) & (nearest[region] < most))
        cells = []
        for name in (*RULES, "exact"):
            found = efficiency(np.stack(errors[name][k]), bound.ravel()[at])
            assert found is not None
            cells.append(f"{found.value:.4f} ± {found.half_width:.4f}")
        title = f"{least:g} to {most:g}" if np.isfinite(most) else f"above {least:g}"
        print(f"| {title} | {share:.0%} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
