"""The decision table of docs/which-strategy.md: runs each command whose answer is missing, and writes the table into the page.

python docs/make_strategy_table.py FOLDER
"""

import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from fringebench.pages.surface_strategies import best_strategies

PAGE = Path(__file__).parent / "which-strategy.md"
START, END = "<!-- table -->", "<!-- end of table -->"
BREAK = " \\\n    --strat"
LADDER = (
    "single,auto-exposure,max-modulation,masked-least-squares,censored-ml,inverted,complementary,2n-step,more-steps,"
    "unsaturated-steps,planned,clustered,intensity-ladder,adaptive-projection"
)
CODINGS = "n-step,heterodyne,gray-code,xor-gray-code,micro-phase-shift,modulated-phase-shift,embedded-phase-shift"
PROJECTORS = "one-projector,every-projector,max-modulation,planned,adaptive-projection"
ROOM = "--render-noise 0.3 --repeats 3 --budget cycle-time --set acquisition.overhead_ms=1.0 --set camera.resolution=[160,120]"
SMALL = f"{ROOM} --strategies {LADDER}"
INDIRECT = f"--render-noise 0.3 --repeats 4 --budget equal-time --set sensor.psf=none --strategies {CODINGS}"
RUNS = {
    "bench": f"bench {SMALL}",
    "ink-solder": f"ink-solder {SMALL}",
    "spi-four": f"spi-four {ROOM} --strategies {PROJECTORS}",
    "interreflection": f"interreflection {INDIRECT}",
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
        command = f"{shlex.quote(sys.executable)} -m fringebench compare {RUNS[run]} -o {shlex.quote(str(path.parent))}"
        subprocess.run(shlex.split(command), check=True)
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def figures(entry: dict[str, Any], label: str) -> str:
    """Median and RMS error in µm, and coverage."""
    region = entry["regions"][label]
    median, rms = (1e3 * region[name] for name in ("median_abs_mm", "rms_mm"))
    return f"{median:.2f}, {rms:.2f} µm of {100 * region['coverage']:.1f} %"


def table(folder: Path) -> str:
    """One row per surface: the smallest median error of those that cover within 1 % of the most."""
    lines = [
        "| surface (scene, region) | strategy | median, RMS error of covered | instead of | its figures |"
    ]
    lines.append("|---|---|---|---|---|")
    for surface, run, label, usual in ROWS:
        entries = {e["name"]: e for e in answer(folder, run)["strategies"]}
        best, *tied = best_strategies(list(entries.values()), label)
        others = f" (tied: {', '.join(f'`{n}`' for n in tied)})" if tied else ""
        lines.append(
            f"| {surface} (`{run}`, `{label}`) | `{best}`{others} | {figures(entries[best], label)} | `{usual}` | "
            f"{figures(entries[usual], label)} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    text = PAGE.read_text("utf-8")
    commands = "\n".join(
        f"$ fringebench compare {run.replace(' --strat', BREAK)}" for run in RUNS.values()
    )
    for start, end, inside in (
        (START, END, table(Path(sys.argv[1]))),
        ("<!-- commands -->", "<!-- end of commands -->", f"```console\n{commands}\n```"),
    ):
        before, after = text.split(start)[0], text.split(end)[1]
        text = f"{before}{start}\n\n{inside}\n\n{end}{after}"
    PAGE.write_text(text, "utf-8")
