"""Captures with planted faults: images of known projector coordinates, and a manifest that is wrong about them.

A fault is harmful if more than 1 % of the valid pixels are beyond ten predicted standard deviations of their coordinate.
`docs/make_fault_table.py` counts how many of the harmful ones `import --check` refuses.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

import decode
from decode.checks.stack_check import CheckReport
from fringebench.exchange.capture_export import export
from fringebench.exchange.capture_import import checked
from scenes.acquisition.patterns import GrayBits, GrayCode, Patterns, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.capture import Capture
from scenes.files.stack import Stack
from scenes.support.errors import FringebenchError
from scenes.support.safe_parse import parse_toml
from tests.decode.synthetic import coordinates, hills, rig

Manifest = dict[str, Any]
Images = NDArray[np.float64]
SIZE, PROJECTOR = (200, 150), (400, 400)
RIG = rig("pinhole", "pinhole", lenses=True, size=SIZE)
HEIGHT_MM = hills(SIZE)
# Without the step on the right.
HEIGHT_MM[:, 174:] = HEIGHT_MM[:, 173:174]
BOTH: Any = ("column", "row")
# Ten standard deviations, and the share of valid pixels beyond them that makes a fault harmful.
SIGMAS, HARMFUL = 10.0, 0.01


@dataclass(frozen=True)
class Shot:
    """What is photographed, and how."""

    patterns: Patterns
    calibrated: bool = True
    sigma_dn: float = 1.0
    white_dn: float = 200.0
    top_dn: float = 255.0
    seed: int = 5
    code_px: float = 0.0
    """Shift of the Gray code against the fringes."""
    gains: tuple[float, ...] = ()
    """Brightness of each frame; empty: all 1."""
    changes: tuple[Callable[[Manifest], None], ...] = field(default=())
    """What is wrong in the manifest."""

    def write(self, folder: Path) -> Path:
        """The images of a smooth, unevenly bright surface, and the manifest's path."""
        rng = np.random.default_rng(self.seed)
        at_px = dict(zip(BOTH, coordinates(RIG, HEIGHT_MM), strict=True))
        reflectance = rng.uniform(0.8, 1.0, HEIGHT_MM.shape) * np.linspace(1.0, 0.7, SIZE[0])
        shown = self.patterns.frames()
        gains = self.gains or (1.0,) * len(shown)
        counts = []
        for frame, gain in zip(shown, gains, strict=True):
            at = at_px[frame.axis] + (self.code_px if frame.kind == "gray" else 0.0)
            white = gain * self.white_dn * reflectance
            light = 10.0 + white * (0.05 + 0.95 * self.patterns.commanded(frame, at))
            noisy = np.round(light + rng.normal(0.0, self.sigma_dn, light.shape))
            counts.append(np.clip(noisy, 0.0, self.top_dn).astype(np.uint8))
        sensor = SimpleSensor(sigma_dn=self.sigma_dn, black_level_dn=10.0)
        stack = Stack(np.stack(counts)[None], shown, (1.0,), sensor, RIG)
        manifest = export(stack, folder)
        # As a user would write it: the program has to find the saturation.
        tree = parse_toml(manifest.read_text())
        del tree["sensor"], tree["saturation_dn"]
        tree["noise_dn"] = float(np.hypot(self.sigma_dn, 12.0**-0.5))
        if not self.calibrated:
            del tree["rig"]
        for change in self.changes:
            change(tree)
        manifest.write_text(tomli_w.dumps(tree))
        return manifest


@dataclass(frozen=True)
class Judged:
    """What became of a capture."""

    refused: bool
    harm: float
    """Share of the valid pixels beyond ten predicted standard deviations; NaN: nothing could be decoded."""
    report: CheckReport | None = None
    error: str = ""

    @property
    def harmful(self) -> bool:
        return not self.harm <= HARMFUL

    def silent(self, part: str) -> bool:
        """Whether it is harmful, not refused, and the part of the manifest is not said to be unverified."""
        named = self.report is not None and part in self.report.not_verified
        return self.harmful and not self.refused and not named


P = PhaseShift
PATTERNS: dict[str, Patterns] = {
    "three periods": P(steps=4, periods_px=(16.0, 64.0, 400.0)),
    "three periods, three steps": P(steps=3, periods_px=(16.0, 64.0, 400.0)),
    "three periods, both axes": P(steps=4, periods_px=(16.0, 64.0, 400.0), axes=BOTH),
    "two periods": P(steps=4, periods_px=(16.0, 400.0)),
    "heterodyne": P(steps=8, periods_px=(400.0 / 21.0, 20.0)),
    "heterodyne, three periods": P(steps=4, periods_px=(400 / 28, 400 / 25, 400 / 24)),
    "cell is half a period": P(steps=3, periods_px=(20.0,), gray=GrayBits(bits=6)),
    "cell is half a period, both axes": P(periods_px=(20.0,), gray=GrayBits(bits=6), axes=BOTH),
    "cell is a period": P(periods_px=(20.0,), gray=GrayBits(bits=5, cell_px=20.0)),
    "cell is a period, both axes": P(periods_px=(20.0,), gray=GrayBits(bits=5, cell_px=20.0), axes=BOTH),
    "code alone": GrayCode(bits=(9,), flat=False),
    "code alone, both axes": GrayCode(bits=(9, 9), axes=BOTH, flat=False),
    "code alone, white and black": GrayCode(bits=(9,), inverted=False),
}  # fmt: skip


def sets(manifest: Manifest, kind: str) -> list[Manifest]:
    """The manifest's entries of one kind."""
    return [shown for shown in manifest["frames"] if shown["kind"] == kind]


def _swapped(rng: np.random.Generator, shot: Shot) -> Shot:
    one, two = rng.choice(len(shot.patterns.frames()), 2, replace=False)

    def change(manifest: Manifest) -> None:
        files = manifest["files"]
        files[one], files[two] = files[two], files[one]

    return replace(shot, changes=(change,))


def _edited(
    kind: str, edit: Callable[[np.random.Generator, Manifest], None], every: bool = False
) -> "Fault":
    """A fault in one entry of a kind, or in each."""

    def plant(rng: np.random.Generator, shot: Shot) -> Shot | None:
        if not any(f.kind == {"fringes": "fringe"}.get(kind, kind) for f in shot.patterns.frames()):
            return None
        state = rng.integers(2**32)

        def change(manifest: Manifest) -> None:
            chosen = np.random.default_rng(state)
            found = sets(manifest, kind)
            for one in found if every else [found[chosen.integers(len(found))]]:
                edit(chosen if not every else np.random.default_rng(state), one)

        return replace(shot, changes=(change,))

    return plant


def _times(key: str, *factors: float) -> Callable[[np.random.Generator, Manifest], None]:
    return lambda rng, one: one.update({key: one[key] * float(rng.choice(factors))})


def _shifted_code(*cells: float) -> "Fault":
    def plant(rng: np.random.Generator, shot: Shot) -> Shot | None:
        code = [f for f in shot.patterns.frames() if f.kind == "gray"]
        if not code or isinstance(shot.patterns, GrayCode):
            return None
        return replace(shot, code_px=float(rng.choice(cells)) * code[0].period_px)

    return plant


def _resized(rng: np.random.Generator, shot: Shot) -> Shot:
    size = [[200, 200], [300, 300], [640, 480], [1600, 1200]][rng.integers(4)]

    def change(manifest: Manifest) -> None:
        manifest["projector_resolution"] = size
        if "rig" in manifest:
            manifest["rig"]["projectors"][0]["resolution"] = size

    return replace(shot, changes=(change,))


def _flickering(sigma_dn: float) -> "Fault":
    def plant(rng: np.random.Generator, shot: Shot) -> Shot | None:
        if isinstance(shot.patterns, GrayCode):
            return None
        gains = 1.0 + 0.05 * rng.choice([-1.0, 1.0], len(shot.patterns.frames()))
        return replace(shot, gains=tuple(gains), sigma_dn=sigma_dn)

    return plant


def _clipped(rng: np.random.Generator, shot: Shot) -> Shot | None:
    if isinstance(shot.patterns, GrayCode):
        return None
    return replace(shot, top_dn=235.0, white_dn=float(rng.choice([250.0, 300.0, 400.0, 500.0])))


def _merged(rng: np.random.Generator, shot: Shot) -> Shot | None:
    if len({f.period_px for f in shot.patterns.frames() if f.kind == "fringe"}) < 2:
        return None

    def change(manifest: Manifest) -> None:
        one, two = sets(manifest, "fringes")[:2]
        two.update(period_px=one["period_px"], repeat=bool(rng.integers(2)))

    return replace(shot, changes=(change,))


def _other_code(rng: np.random.Generator, one: Manifest) -> None:
    key, value = [("code", "plain"), ("order", "fine-first"), ("inverse", "after-all")][
        rng.integers(3)
    ]
    if key == "inverse" and one["inverse"] == "none":
        key, value = "code", "plain"
    one[key] = value


def _first_phase(rng: np.random.Generator, one: Manifest) -> None:
    one["first_phase_deg"] = one.get("first_phase_deg", 0.0) + float(
        rng.choice([-120.0, -90.0, 90.0, 120.0, 180.0])
    )


def _direction(rng: np.random.Generator, one: Manifest) -> None:
    one["direction"] = -1


def _origin(rng: np.random.Generator, one: Manifest) -> None:
    one["origin_px"] = float(rng.choice([-20.0, -8.0, -2.0, 2.0, 8.0, 20.0]))


Fault = Callable[[np.random.Generator, Shot], Shot | None]
# What is wrong, the part of the manifest that is, and how it is planted.
FAULTS: dict[str, tuple[str, Fault]] = {
    "frames swapped": ("files", _swapped),
    "period wrong by 5 % or more": ("fringes.period_px", _edited("fringes", _times("period_px", 0.5, 0.8, 0.95, 1.05, 1.25, 2.0))),
    "period wrong by 1 % or less": ("fringes.period_px", _edited("fringes", _times("period_px", 0.99, 0.995, 1.005, 1.01))),
    "all periods wrong by 5 %": ("fringes.period_px", _edited("fringes", _times("period_px", 0.95, 1.05), every=True)),
    "cell wrong": ("gray.cell_px", _edited("gray", _times("cell_px", 0.5, 0.9, 1.1, 2.0))),
    "all cells wrong": ("gray.cell_px", _edited("gray", _times("cell_px", 0.5, 0.9, 1.1, 2.0), every=True)),
    "code shifted by less than a cell": ("gray.origin_px", _shifted_code(-0.5, -0.25, -0.1, 0.1, 0.25, 0.5)),
    "code shifted by a cell or two": ("gray.origin_px", _shifted_code(-2.0, -1.0, 1.0, 2.0)),
    "other code, or order": ("gray.code", _edited("gray", _other_code)),
    "first phase of a set": ("fringes.origin_px", _edited("fringes", _first_phase)),
    "first phase of all sets": ("fringes.origin_px", _edited("fringes", _first_phase, every=True)),
    "direction of a set": ("fringes.direction", _edited("fringes", _direction)),
    "direction of all sets": ("fringes.direction", _edited("fringes", _direction, every=True)),
    "origin of a set": ("fringes.origin_px", _edited("fringes", _origin)),
    "origin of a code": ("gray.origin_px", _edited("gray", _origin)),
    "projector's size": ("projector_resolution", _resized),
    "flicker of 5 %": ("brightness of the source", _flickering(1.0)),
    "flicker of 5 %, little noise": ("brightness of the source", _flickering(0.3)),
    "clipped at 235": ("saturation_dn", _clipped),
    "sets merged": ("files", _merged),
}  # fmt: skip


def planted(seed: int, patterns: str, fault: str, calibrated: bool) -> Shot | None:
    """One capture with a fault; None where the patterns cannot have it."""
    rng = np.random.default_rng([seed, list(PATTERNS).index(patterns), list(FAULTS).index(fault)])
    return FAULTS[fault][1](rng, Shot(PATTERNS[patterns], calibrated, seed=seed))


def judged(shot: Shot, folder: Path) -> Judged:
    """Check a capture as `import` does, and compare what is decoded with what was photographed."""
    try:
        found = checked(Capture.load(shot.write(folder)))
    except FringebenchError as error:
        return Judged(True, np.nan, error=str(error))
    return Judged(bool(found.report.wrong), _harm(found.stack), found.report)


def _harm(stack: Stack) -> float:
    worst = 0.0
    for axis, true in zip(BOTH, coordinates(RIG, HEIGHT_MM), strict=True):
        mine = [
            f
            for f in stack.patterns
            if f.axis == axis and f.period_px and f.kind in ("fringe", "gray")
        ]
        if not mine:
            continue
        try:
            rec = decode.reconstruct(stack, height="phase", axis=axis)
        except FringebenchError:
            return float("nan")
        if not rec.valid.any():
            return float("nan")
        fringes = [f for f in mine if f.kind == "fringe"]
        if fringes:
            finest = min(f.period_px for f in fringes)
            steps = sum(f.period_px == finest for f in fringes)
            variance = stack.sensor.variance_dn2(rec.offset_dn, 1.0)
            noise = np.sqrt(2.0 * variance / steps) / np.maximum(rec.modulation_dn, 1e-6)
            sigma = finest / (2.0 * np.pi) * noise
        else:
            sigma = np.full(rec.valid.shape, min(f.period_px for f in mine) / np.sqrt(12.0))
        off = np.abs(rec.phases[axis].coordinate_px - true)
        worst = max(worst, float((off > SIGMAS * sigma)[rec.valid].mean()))
    return worst
