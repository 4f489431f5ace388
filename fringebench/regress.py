"""A gate for decoders: run one over the suite, hold its figures against a stored baseline, and say what got worse."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.equivalence import Estimate
from evaluation.regression import Figures, Margins, Row, against, measure
from fringebench.decoders import TIMEOUT_S, Decoder, resolve
from fringebench.progress import Report, Steps
from fringebench.suite import CASES, Case, fingerprint, suite
from scenes import Stack
from scenes.errors import DecoderError, FileError, FringebenchError
from scenes.foreign_text import parse_json
from scenes.frozen import in_words
from scenes.replace_file import replacing

VERSION = 1
SEEDS = tuple(range(16))
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Baseline:
    """Figures of an earlier run, by case."""

    decoder: str
    suite: str
    """Fingerprint of the cases."""
    figures: dict[str, Figures]
    seeds: tuple[int, ...] = ()
    """Of the noise; none: not known."""

    def write(self, path: str | Path) -> None:
        """Write as JSON, beside and renamed."""
        tree = {"format": "fringebench-baseline", "version": VERSION, **asdict(self)}
        with replacing(path) as beside:
            beside.write_text(json.dumps(tree, indent=1, allow_nan=False) + "\n", "utf-8")

    @classmethod
    def read(cls, path: Path) -> "Baseline":
        """Read a baseline; raises `FileError` on anything but a whole one of this version."""
        try:
            tree = parse_json(path.read_text("utf-8"))
            if tree["format"] != "fringebench-baseline" or tree["version"] != VERSION:
                raise FileError(
                    f"baseline '{path}' has format {tree['format']} {tree['version']}, not fringebench-baseline {VERSION}: "
                    "make it again with --update"
                )
            figures = {
                case: {
                    region: {metric: _estimate(estimate) for metric, estimate in metrics.items()}
                    for region, metrics in regions.items()
                }
                for case, regions in tree["figures"].items()
            }
            seeds = tuple(int(seed) for seed in tree.get("seeds", ()))
            return cls(str(tree["decoder"]), str(tree["suite"]), figures, seeds)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileError(f"baseline '{path}' cannot be read: {in_words(error)}") from error


@dataclass(frozen=True)
class Regression:
    """What a run of the gate found."""

    decoder: str
    baseline: str
    """Whose figures these were held against."""
    rows: tuple[Row, ...]
    figures: dict[str, Figures] = field(repr=False)
    updated: bool = False
    """Whether the figures were stored as the new baseline."""

    @property
    def failed(self) -> tuple[Row, ...]:
        """Figures that got worse, or are not shown to have stayed."""
        return tuple(row for row in self.rows if not row.comparison.passed)

    @property
    def improved(self) -> tuple[Row, ...]:
        """Figures that got better by more than the margin."""
        return tuple(row for row in self.rows if row.comparison.verdict == "better")

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return not self.failed

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "decoder": self.decoder,
            "baseline": self.baseline,
            "passed": self.passed,
            "updated": self.updated,
            "rows": [_plain(row) for row in self.rows],
        }

    def describe(self) -> str:
        """One line for each figure that failed: case, region, by how much."""
        return "\n".join(told(row) for row in self.failed)


def _plain(row: Row) -> dict[str, Any]:
    tree = asdict(row)
    for side in ("new", "old"):
        del tree[side]["values"]
    return tree


def told(row: Row) -> str:
    """A comparison in words."""
    c = row.comparison
    scale, unit = (1000.0, " um") if row.metric.endswith("_mm") else (100.0, " %")
    name = row.metric.removesuffix("_mm").removesuffix("_fraction")
    return (
        f"{row.case} / {row.region}: {name} {row.old.mean * scale:.3g} -> {row.new.mean * scale:.3g}{unit}, "
        f"{c.verdict}: by {c.difference * scale:+.3g}{unit} (at most {c.upper * scale:+.3g}, margin "
        f"{c.margin * scale:.3g})" + ("; give more seeds" if c.verdict == "undecided" else "")
    )


def regress(
    decoder: str | Callable[[Stack], Any],
    baseline: str | Path | None = None,
    *,
    update: bool = False,
    seeds: Sequence[int] = SEEDS,
    cases: Sequence[Case] | None = None,
    margins: Margins | None = None,
    confidence: float = CONFIDENCE,
    timeout_s: float = TIMEOUT_S,
    steps: Steps | None = None,
) -> Regression:
    """Run a decoder over the suite and compare it with a baseline (None: the one shipped, of our own decoder).

    `decoder` is what `fringebench.decoders.resolve` takes. Each case is decoded once a seed of noise. Passed `cases` save
    preparing them again. With `update` the figures become the new baseline, unless the decoder got worse: a baseline that
    follows every fall guards nothing (delete the file to start again).

    Raises `DecoderError` when the decoder cannot be run, `FileError` for an unusable baseline.
    """
    steps = steps or Steps()
    name = decoder if isinstance(decoder, str) else getattr(decoder, "__qualname__", repr(decoder))
    run = resolve(decoder, timeout_s)
    target = None if baseline is None else Path(baseline)
    if update and target is None:
        raise FileError("--update needs --baseline FILE to write to: the shipped one stays")
    old = None
    if target is None or target.exists() or not update:
        old = _load(target)
    cases = suite(steps=steps) if cases is None else cases
    names = tuple(case.name for case in cases)
    mark = fingerprint(names)
    figures = {}
    for case in cases:
        with steps.step(f"decode {case.name}") as done:
            figures[case.name] = _figures(case, run, seeds, done)
    if old is None:
        assert target is not None  # only then is there nothing to compare with
        Baseline(name, mark, figures, tuple(seeds)).write(target)
        return Regression(name, f"{target} (new)", (), figures, updated=True)
    if names == CASES and old.suite != mark:
        raise FileError(
            f"the baseline of '{old.decoder}' was made with other cases than this version has: make it again with "
            "--update and a new file"
        )
    rows = [
        row
        for case in cases
        for row in against(
            case.name,
            figures[case.name],
            old.figures.get(case.name, {}),
            case.mm_per_rad,
            margins or Margins(),
            confidence,
            paired=old.seeds == tuple(seeds),
        )
    ]
    found = Regression(name, old.decoder if target is None else str(target), tuple(rows), figures)
    if not (update and found.passed):
        return found
    assert target is not None
    Baseline(name, mark, figures, tuple(seeds)).write(target)
    return Regression(name, found.baseline, found.rows, figures, updated=True)


def _figures(case: Case, run: Decoder, seeds: Sequence[int], done: Report) -> Figures:
    heights, sigmas = [], []
    for i, seed in enumerate(seeds):
        done(i / len(seeds))
        try:
            answer = run(case.stack(seed))
        except FringebenchError as error:
            raise DecoderError(f"case '{case.name}', seed {seed}: {error}") from error
        heights.append(answer.height_mm)
        sigmas.append(case.sigma_mm if answer.sigma_mm is None else answer.sigma_mm)
    return measure(
        np.stack(heights),
        np.stack(sigmas),
        case.height_mm,
        case.regions,
        case.unlit,
        case.mm_per_rad,
    )


def _estimate(tree: dict[str, Any]) -> Estimate:
    values = tree.get("values")
    return Estimate(**tree | {"values": None if values is None else tuple(map(float, values))})


def _load(path: Path | None) -> Baseline:
    if path is not None:
        if not path.is_file():
            raise FileError(f"baseline '{path}' does not exist: make it with --update")
        return Baseline.read(path)
    with resources.as_file(resources.files("fringebench") / "baselines" / "default.json") as file:
        return Baseline.read(file)
