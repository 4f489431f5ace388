"""The pipeline stage by stage: render, expose, decode, evaluate."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from fringebench.cli import shared_options as opt
from fringebench.cli.outputs import check_outputs
from fringebench.cli.overrides import override_exposed, parse_overrides
from fringebench.cli.registration import command
from fringebench.cli.terminal import (
    answer,
    answer_console,
    print_figures,
    print_json,
    progress_steps,
    say,
)
from fringebench.progress import Mode

app = typer.Typer()


@command(app, "fringebench render step -o transport.exr --truth truth.exr")
def render_scene(
    scene: opt.SceneName,
    output: Path = Path("transport.exr"),
    truth: Path | None = None,
    settings: opt.Settings = [],  # noqa: B006
    phase_error: opt.PhaseError = None,
    render_noise: opt.RenderNoise = None,
    seed: opt.Seed = 0,
    samples: opt.CountOrNone = None,
    depth: opt.CountOrNone = None,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Trace a scene's light transport, once, for all its patterns.

    output: Transport file.
    truth: Also write the truth maps to this file.
    samples: As sampling.samples of the scene; with --phase-error, of each pass.
    depth: Maximum number of surfaces on a light path; 1: direct light.
    """
    check_outputs({"-o": output, "--truth": truth}, [scene])
    import render
    import scenes
    from fringebench.experiments.noise_summary import describe, figures

    loaded = scenes.load(scene, parse_overrides(settings, phase_error, render_noise))
    steps = progress_steps(progress)
    with steps.step("trace light") as done:
        surfaces = render.surfaces(loaded)
        transport = render.trace(
            loaded,
            seed=seed,
            samples=samples,
            depth=depth,
            progress=done,
            phase_error_rad=phase_error,
            render_noise=render_noise,
            surfaces=surfaces,
        )
        transport.write(output)
    if truth:
        with steps.step("truth"):
            render.truth(loaded, transport, surfaces).write(truth)
    if as_json:
        written = {"transport": str(output), "truth": str(truth) if truth else None}
        traced = {"samples": transport.samples, "depth": transport.depth}
        light = figures(transport)
        print_json(written | traced | ({"light": light} if light else {}))
        return
    channels = sum(len(basis.channels) for basis in transport.bases)
    rows, columns = transport.ambient.shape
    say(
        f"{output}: {columns} x {rows} px, {channels} channels, {transport.samples} samples per pixel"
    )
    if truth:
        say(f"{truth}: {', '.join(transport.labels)}")
    if light := figures(transport):
        say(describe(light))


@command(app, "fringebench expose transport.exr -o stack.exr --exposure-ms 2 --exposure-ms 8")
def expose(
    transport: Path,
    output: Path = Path("stack.exr"),
    exposure_ms: list[float] = [],  # noqa: B006
    settings: opt.Settings = [],  # noqa: B006
    seed: opt.Seed = 0,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Turn transport into frames of digital numbers: exposures, noise, clipping.

    transport: A transport EXR, written by render.
    output: Stack file.
    exposure_ms: Exposure time; may be repeated. Default: the scene's own.
    settings: Override a key of sensor, exposures or patterns; may be repeated.
    seed: Seed of sensor noise.
    """
    check_outputs({"-o": output}, [transport])
    import render

    light = render.Transport.read(transport)
    scene = override_exposed(light.scene, settings)
    with progress_steps(progress).step("expose") as done:
        stack = render.expose(
            light,
            seed=seed,
            sensor=scene.sensor,
            exposures=exposure_ms or scene.exposures,
            patterns=scene.patterns,
            progress=done,
        )
        stack.write(output)
    levels = {"exposure_ms": stack.exposure_ms, "saturation_dn": stack.saturation_dn}
    times = ", ".join(f"{time:.4g}" for time in stack.exposure_ms)
    frames, rows, columns = stack.frames.shape[1:]
    said = f"{output}: {frames} frames at {times} ms, {columns} x {rows} px"
    answer(as_json, {"stack": str(output), "shape": stack.frames.shape} | levels, said)


@command(app, "fringebench decode stack.exr -o reconstruction.exr --fusion single")
def decode_stack(
    stack: Path,
    output: Path = Path("reconstruction.exr"),
    fusion: opt.Fusion = "max-modulation",
    unwrap: str | None = None,
    height: str | None = None,
    projector: Annotated[int | None, typer.Option(min=0)] = None,
    known_point: Annotated[
        tuple[int, int, float] | None, typer.Option(metavar="ROW COL MM")
    ] = None,
    c_px_per_mm: float | None = None,
    gamma: str | None = None,
    roi: opt.Region = None,
    anchor: str | None = None,
    axis: str | None = None,
    saturation: str = "reject",
    min_modulation_dn: float | None = None,
    max_order_residual: float = 0.25,
    uncertainty: str = "sensor",
    matcher: str | None = None,
    progress: opt.ShowProgress = Mode.AUTO,
    as_json: opt.AsJson = False,
) -> None:
    """Reconstruct heights from a stack.

    stack: A stack EXR, written by expose or import.
    output: Reconstruction file.
    unwrap: Unwrapping: temporal, row-scan, quality-guided.
    height: Height: triangulation, reference-plane, linear; phase: none, phases only. With a screen: two-positions, integration.
    projector: Use this projector, or screen position, alone; counted from 0.
    known_point: With one position of a screen: height of the surface at a pixel.
    c_px_per_mm: Fringe shift per mm of height, for a linear height without calibration.
    gamma: Correct the phase for this gamma; 'estimate': from harmonics.
    roi: Decode only this region.
    anchor: What fixes the coarsest order: gray, volume, field; spatial: nothing measured.
    axis: Projector axis that measures height: column, row.
    saturation: reject; or ignore: clipped samples count as good.
    min_modulation_dn: Modulation below which a pixel is dark, DN.
    max_order_residual: Largest distance of a predicted order from a whole number, periods.
    uncertainty: sensor; by-cause: predict blur, mixed pixels and indirect light too, and reject what they spoil.
    matcher: Two cameras without fringes: sgbm, bm.
    """
    check_outputs({"-o": output}, [stack])
    import decode
    import scenes
    from scenes.support.errors import DecodeError

    number: float | str | None = gamma
    if gamma is not None and gamma != "estimate":
        try:
            number = float(gamma)
        except ValueError:
            raise DecodeError(f"--gamma '{gamma}': give a number, or 'estimate'") from None
    options = decode.Options.of(
        {
            "fusion": fusion,
            "unwrap": unwrap,
            "height": height,
            "projector": projector,
            "known_point": known_point,
            "c_px_per_mm": c_px_per_mm,
            "gamma": number,
            "roi": roi,
            "anchor": anchor,
            "axis": axis,
            "saturation": saturation,
            "min_modulation_dn": min_modulation_dn,
            "max_order_residual": max_order_residual,
            "uncertainty": uncertainty,
            "matcher": matcher,
        }
    )
    with progress_steps(progress).step("decode"):
        reconstruction = decode.reconstruct_with(scenes.Stack.read(stack), options)
        reconstruction.write(output)
    if as_json:
        found = {"reasons": reconstruction.reason_fractions(), "settings": reconstruction.settings}
        print_json({"reconstruction": str(output)} | found)
        return
    shares = dict(reconstruction.reason_fractions())
    measured = f"{shares.pop('ok'):.1%} of the pixels measured"
    rejected = "".join(f"; {reason} {share:.2%}" for reason, share in shares.items())
    say(f"{output}: {measured}{rejected}")
    if not reconstruction.order_known:
        say(
            "the fringe order is known only up to whole turns: heights may be off by whole fringes; a coarser period, Gray "
            "code or smaller height range fixes it"
        )


@command(app, "fringebench evaluate reconstruction.exr truth.exr --json")
def evaluate(
    reconstruction: Path,
    truth: Path,
    output: Path | None = None,
    force: bool = False,
    as_json: opt.AsJson = False,
) -> None:
    """Score a reconstruction against the truth.

    reconstruction: A reconstruction EXR, written by decode.
    truth: A truth EXR, written by render --truth.
    output: Also write the scores to this JSON file.
    force: Score even if the truth is of another scene or rig.
    """
    check_outputs({"-o": output}, [reconstruction, truth])
    import decode
    import evaluation
    import scenes

    score = evaluation.score(
        decode.Reconstruction.read(reconstruction), scenes.Truth.read(truth), force=force
    )
    if output:
        score.write(output)
    if as_json:
        print_json(score.to_dict())
        return
    from fringebench.experiments.noise_summary import describe_regions
    from fringebench.pages.score_tables import extra_tables, outliers_in_words, score_table

    print_figures([score_table(score, escape(str(reconstruction))), *extra_tables(score)])
    if said := describe_regions(score):
        answer_console().print(said, soft_wrap=True)
    if beyond := outliers_in_words(score):
        answer_console().print(beyond, soft_wrap=True)
