"""The whole pipeline: a scene is traced, exposed, decoded and scored; each step writes its file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import decode
import evaluation
import render
import scenes
from evaluation.output.report import Report
from fringebench.experiments.noise_summary import figures
from fringebench.output_folder import one_run, prepare
from fringebench.progress import Steps

FILES = (
    "scene.toml",
    "transport.exr",
    "truth.exr",
    "stack.exr",
    "reconstruction.exr",
    "scores.json",
    "cloud.ply",
    "report.html",
)


@dataclass(frozen=True)
class Run:
    """Results of a run."""

    folder: Path
    scene: scenes.Scene
    stack: scenes.Stack
    truth: scenes.Truth
    reconstruction: decode.Reconstruction
    fusion: str
    score: evaluation.Score
    naive: evaluation.Score
    """Score of the same stack decoded naively: one exposure, saturation ignored."""
    seconds: dict[str, float]
    """Time each step took; writing of all files but the report is one."""


Page = Callable[[Run, Mapping[str, float]], Report]
"""Makes the report of a run from its results and the time of each step in s."""


def run(
    scene: scenes.Scene,
    folder: str | Path,
    seed: int = 0,
    fusion: str = "max-modulation",
    steps: Steps | None = None,
    page: Page | None = None,
) -> Run:
    """Render, expose, decode and score a scene, writing every file into `folder`; `page` makes its report, if given.

    Each file is written under a temporary name and renamed: an interrupted run leaves no half-written file. An earlier run
    in `folder` is replaced once this one has succeeded. Raises `FringebenchError` for an invalid scene or folder.
    """
    if len(scene.screens) == 1:
        raise scenes.DecodeError(
            "one position of the screen leaves the height open: add a second one, or use render, expose, decode --known-point "
            "and evaluate"
        )
    # A misspelt rule is reported before light is traced, not after.
    decode.Options(fusion=fusion).rule()
    out = prepare(folder)
    steps = steps or Steps()
    step = steps.step
    with one_run(out, FILES) as keep:

        def write(name: str, how: Callable[[Path], None]) -> None:
            def timed(path: Path) -> None:
                with step("write"):
                    how(path)

            keep(name, timed)

        write("scene.toml", lambda path: scenes.save(scene, path))
        with step("trace light") as done:
            surfaces = render.surfaces(scene)
            transport = render.trace(scene, seed=seed, progress=done, surfaces=surfaces)
        write("transport.exr", transport.write)
        with step("truth"):
            truth = render.truth(scene, transport, surfaces)
        write("truth.exr", truth.write)
        with step("expose") as done:
            stack = render.expose(transport, seed=seed, progress=done)
        write("stack.exr", stack.write)
        with step("decode"):
            reconstruction = decode.reconstruct(stack, fusion=fusion)
        write("reconstruction.exr", reconstruction.write)
        with step("score"):
            score = replace(evaluation.score(reconstruction, truth), light=figures(transport))
            # A naive decoder: one exposure, and a mask by modulation only.
            alone = decode.reconstruct(
                middle_exposure_alone(stack), fusion="single", saturation="ignore"
            )
            naive = evaluation.score(alone, truth)
        write("scores.json", score.write)
        write("cloud.ply", lambda path: evaluation.write_cloud(path, reconstruction, truth))
        result = Run(out, scene, stack, truth, reconstruction, fusion, score, naive, steps.seconds)
        if page is not None:
            with step("report"):
                keep("report.html", page(result, dict(steps.seconds)).write)
    return result


def middle_exposure_alone(stack: scenes.Stack) -> scenes.Stack:
    """The stack with its middle exposure (`decode.middle_exposure`) only."""
    at = decode.middle_exposure(stack.exposure_ms)
    return replace(
        stack, frames=stack.frames[at : at + 1], exposure_ms=stack.exposure_ms[at : at + 1]
    )
