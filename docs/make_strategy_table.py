"""The tables of docs/which-strategy.md and of codings in docs/comparing.md: runs each command whose answer is missing in a
folder, and writes commands and tables into the pages.

python docs/make_strategy_table.py FOLDER
"""

import json
import shlex
import subprocess
import sys
from math import floor, hypot, log10
from pathlib import Path
from textwrap import wrap
from typing import Any

from fringebench.pages.surface_strategies import best_strategies

DOCS = Path(__file__).parent
LADDER = (
    "single,auto-exposure,max-modulation,masked-least-squares,censored-ml,inverted,complementary,2n-step,more-steps,"
    "unsaturated-steps,planned,clustered,intensity-ladder,adaptive-projection"
)
CODINGS = "n-step,heterodyne,gray-code,xor-gray-code,micro-phase-shift,modulated-phase-shift,embedded-phase-shift"
PROJECTORS = "one-projector,every-projector,max-modulation,planned,adaptive-projection"
# Asked for with room: of 0.3, two labels of `bench` reach 0.31 and 0.35.
ROOM = "--render-noise 0.25 --repeats 3 --budget cycle-time --set acquisition.overhead_ms=1.0 --set camera.resolution=[160,120]"
SMALL = f"{ROOM} --strategies {LADDER}"
INDIRECT = "--render-noise 0.3 --repeats 4 --budget equal-time --set sensor.psf=none"
# A strip through the middle of the scene: quiet light of all of it would take an hour or more. So would the thickest plate's.
RESIN_STRIP = (
    "--set camera.resolution=[288,8] --set camera.calibrated_at=[288,8] --set camera.fx_px=2400 --set camera.fy_px=2400 "
    "--set camera.cx_px=144 --set camera.cy_px=4 --set sampling.most_samples=1000000"
)
RESIN_LABELS = """--set sampling.labels='["base","thin","medium"]'"""
GRAINS_STRIP = (
    "--set camera.resolution=[400,6] --set camera.field_width_mm=3.2 --set sampling.most_samples=1000000 "
    """--set sampling.labels='["type-3","type-4","type-5"]' --set exposures.auto.level_dn=400"""
)
DIM = "--set exposures.auto.level_dn=140"
STRATEGY_RUNS = {
    "bench": f"bench {SMALL}",
    "ink-solder": f"ink-solder {SMALL}",
    # Quiet light of its metal pads would take hours.
    "spi-four": f"""spi-four {ROOM} --set sampling.labels='["base","mask","paste"]' --strategies {PROJECTORS}""",
    "interreflection": f"interreflection {INDIRECT} --strategies {CODINGS}",
}
CODING_RUNS = {
    "interreflection": STRATEGY_RUNS["interreflection"],
    "translucent": f"translucent {INDIRECT} {RESIN_STRIP} {RESIN_LABELS} --strategies {CODINGS}",
    "translucent-dim": f"translucent {INDIRECT} {RESIN_STRIP} {DIM} --strategies {CODINGS}",
    "solder-grains": f"solder-grains --seed 1 {INDIRECT} {GRAINS_STRIP} --strategies {CODINGS}",
}
# Surface, run, region, strategy it is compared with.
ROWS = (
    ("grey paint, flat", "bench", "base", "max-modulation"),
    ("grey paint, step", "bench", "step", "max-modulation"),
    ("black ink among paint", "bench", "ink", "max-modulation"),
    ("solder balls among paint", "bench", "solder", "max-modulation"),
    ("black ink next to solder", "ink-solder", "ink", "max-modulation"),
    ("solder on ink", "ink-solder", "solder", "max-modulation"),
    ("board, four projectors", "spi-four", "base", "one-projector"),
    ("solder mask, four projectors", "spi-four", "mask", "one-projector"),
    ("solder paste, four projectors", "spi-four", "paste", "one-projector"),
    ("metal groove, dim side", "interreflection", "left", "n-step"),
    ("metal groove, bright side", "interreflection", "right", "n-step"),
)


def answer(folder: Path, run: str) -> dict[str, Any]:
    """The run's compare.json, made if it is missing."""
    path = folder / run / "compare.json"
    if not path.exists():
        command = (STRATEGY_RUNS | CODING_RUNS)[run]
        call = f"{shlex.quote(sys.executable)} -m fringebench compare {command} -o {shlex.quote(str(path.parent))}"
        subprocess.run(shlex.split(call), check=True)
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def figures(entry: dict[str, Any], label: str) -> str:
    """Median and RMS error in µm, and coverage."""
    region = entry["regions"][label]
    median, rms = (1e3 * region[name] for name in ("median_abs_mm", "rms_mm"))
    return f"{median:.2f}, {rms:.2f} µm of {100 * region['coverage']:.1f} %"


def strategy_table(folder: Path) -> list[str]:
    """One row per surface: the smallest median error of those that cover within 1 % of the most."""
    lines = [
        "| surface (scene, region) | strategy | median, RMS error of covered | instead of | its figures |",
        "|---|---|---|---|---|",
    ]
    for surface, run, label, usual in ROWS:
        entries = {e["name"]: e for e in answer(folder, run)["strategies"]}
        best, *tied = best_strategies(list(entries.values()), label)
        others = f" (tied: {', '.join(f'`{n}`' for n in tied)})" if tied else ""
        lines.append(
            f"| {surface} (`{run}`, `{label}`) | `{best}`{others} | {figures(entries[best], label)} | `{usual}` | "
            f"{figures(entries[usual], label)} |"
        )
    return lines


def coding_table(folder: Path) -> list[str]:
    """One row per region: coverage over median error in 1/µm with its half width, and the coverage."""
    names = CODINGS.split(",")
    lines = [
        f"| scene, region | light's noise | {' | '.join(f'`{n}`' for n in names)} |",
        "|---" * (len(names) + 2) + "|",
    ]
    for run in CODING_RUNS:
        found = answer(folder, run)
        entries = {e["name"]: e["regions"] for e in found["strategies"]}
        for label, noise in found["light"]["reached"].items():
            if noise is None:
                continue
            scores = [_score(entries[name][label]) for name in names]
            lowest = max(score - half for score, half in scores)
            digits = -floor(log10(max(max(scores)[1], 1e-6)))
            cells = []
            for name, (score, half) in zip(names, scores, strict=True):
                mark = "**" if score + half >= lowest else ""
                covered = 100.0 * entries[name][label]["coverage"]
                cells.append(f"{mark}{score:.{digits}f} ± {half:.{digits}f}{mark}, {covered:.1f} %")
            scene = f"`{run}`".replace("-dim`", "`, dim")
            lines.append(f"| {scene}, `{label}` | {noise:.2f} | {' | '.join(cells)} |")
    return lines


def _score(region: dict[str, Any]) -> tuple[float, float]:
    """Coverage over median error, 1/µm, and its half width: relative ones of both add up in squares."""
    names = ("coverage", "median_abs_mm")
    if not region["median_abs_mm"]:
        return 0.0, 0.0
    score = 1e-3 * region["coverage"] / region["median_abs_mm"]
    return score, score * hypot(*(region["half_width"][name] / region[name] for name in names))


def commands(runs: dict[str, str]) -> list[str]:
    """What the page says to run, with long lines broken."""
    lines = ["```console"]
    for run in runs.values():
        parts = wrap(
            f"$ fringebench compare {run}", 110, break_long_words=False, break_on_hyphens=False
        )
        lines.append(" \\\n    ".join(parts))
    return [*lines, "```"]


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for page, part, inside in (
        ("which-strategy", "table", strategy_table(folder)),
        ("which-strategy", "commands", commands(STRATEGY_RUNS)),
        ("comparing", "codings", coding_table(folder)),
        ("comparing", "coding commands", commands(CODING_RUNS)),
    ):
        path = DOCS / f"{page}.md"
        before, rest = path.read_text("utf-8").split(f"<!-- {part} -->")
        after = rest.split(f"<!-- end of {part} -->")[1]
        made = "\n".join(inside)
        text = f"{before}<!-- {part} -->\n\n{made}\n\n<!-- end of {part} -->{after}"
        path.write_text(text, "utf-8")
