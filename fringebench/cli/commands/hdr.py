"""Commands that compare strategies: on one scene, and by surface."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from fringebench.cli import shared_options as opt
from fringebench.cli.overrides import parse_overrides
from fringebench.cli.registration import command
from fringebench.cli.terminal import answer_console, print_figures, print_json, progress_steps, say
from fringebench.progress import Mode

app = typer.Typer()

SURFACES = ["bench", "ink-solder", "interreflection"]


@command(
    app,
    "fringebench compare bench --strategies max-modulation,censored-ml --set camera.resolution=[320,240] -o comparison",
)
def compare(
    scene: opt.SceneName = "bench",
    strategies: opt.Listed = None,
    repeats: opt.Count = 5,
    output: Path | None = None,
    budget: Annotated[str, typer.Option(metavar="LIST")] = "equal-time,equal-frames",
    pareto: bool = False,
    decoder: list[str] = [],  # noqa: B006
    settings: opt.Settings = [],  # noqa: B006
    phase_error: opt.PhaseError = None,
    render_noise: opt.RenderNoise = None,
    seed: opt.Seed = 0,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Compare HDR strategies on one rendering, at equal exposure time, number of frames or cycle time.

    repeats: Captures of each strategy; 2 or more give intervals.
    output: Also write compare.json, figures and report.html here.
    budget: What is equal, separated by commas: equal-time, equal-frames, cycle-time.
    pareto: Also error by cycle time, from 1/4 to 4 times the scene's.
    decoder: A whole decoder to compare too, package.module:callable or a command with {stack} and {output}; repeat for several.
    """
    import scenes
    from evaluation.hdr.light_budget import known_budgets
    from fringebench import verbs
    from fringebench.experiments.noise_summary import describe
    from fringebench.pages.comparison_tables import pareto_tables, tables

    loaded = scenes.load(scene, parse_overrides(settings, phase_error, render_noise))
    result = verbs.compare(
        loaded,
        None if strategies is None else _names(strategies),
        repeats,
        seed,
        output,
        progress_steps(progress),
        known_budgets(_names(budget)),
        pareto,
        decoder,
    )
    if as_json:
        print_json(result.to_dict())
        return
    console = answer_console()
    print_figures(tables(result, narrow=True) + pareto_tables(result))
    for name, at, reason in result.left_out:
        console.print(f"[yellow]left out:[/] {name}, {at}: {escape(reason)}")
    if result.light:
        console.print(describe(result.light), soft_wrap=True)
    if output:
        say(f"files in {output}")


@command(app, "fringebench strategies bench ink-solder --set camera.resolution=[160,120]")
def strategies_by_surface(
    scene: Annotated[list[str], typer.Argument(autocompletion=opt.scene_names)] = SURFACES,
    strategies: opt.Listed = None,
    repeats: opt.Count = 3,
    budget: str = "cycle-time",
    settings: opt.Settings = [],  # noqa: B006
    phase_error: opt.PhaseError = None,
    render_noise: opt.RenderNoise = None,
    seed: opt.Seed = 0,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Show which strategy errs least on which surface: the median height error of every strategy on every region.

    scene: Shipped scenes' names, or TOML files.
    repeats: Captures of each strategy; 2 or more give intervals.
    budget: What is equal: equal-time, equal-frames or cycle-time.
    """
    import scenes
    from evaluation.hdr.light_budget import known_budgets
    from fringebench import verbs
    from fringebench.pages.surface_strategies import best_strategies, strategy_table, surfaces

    (equal,) = known_budgets([budget])
    steps = progress_steps(progress)
    overrides = parse_overrides(settings, phase_error, render_noise)
    chosen = None if strategies is None else _names(strategies)
    # All are read before the first is traced.
    loaded = {name: scenes.load(name, overrides) for name in scene}
    found, left_out = {}, []
    for word, one in loaded.items():
        result = verbs.compare(one, chosen, repeats, seed, None, steps, [equal])
        found[word] = result.to_dict()["strategies"]
        left_out += [(word, name, reason) for name, _, reason in result.left_out]
    if as_json:
        best = [
            {"scene": name, "region": label, "best": best_strategies(found[name], label)}
            for name, label in surfaces(found)
        ]
        lost = [dict(zip(("scene", "name", "reason"), one, strict=True)) for one in left_out]
        print_json({"budget": equal, "surfaces": best, "strategies": found, "left_out": lost})
        return
    title = f"median height error, {equal}; = smallest of those that cover most, or tied with it; (share measured)"
    print_figures([strategy_table(found, title)])
    for name, strategy, reason in left_out:
        say(f"left out: {strategy} on {name}: {reason}")


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]
