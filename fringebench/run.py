"""The whole way: a scene becomes light, a stack, heights, and a score; every step leaves its file."""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import decode
import evaluation
import render
import scenes
from fringebench.alone import alone
from fringebench.light import figures
from fringebench.progress import Steps
from scenes.errors import FileError

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
# The chapter's warning: one exposure, and a mask that only asks for modulation.
NAIVE = {"fusion": "single", "saturation": "ignore"}


@dataclass(frozen=True)
class Run:
    """What a run made."""

    folder: Path
    scene: scenes.Scene
    stack: scenes.Stack
    truth: scenes.Truth
    reconstruction: decode.Reconstruction
    fusion: str
    score: evaluation.Score
    naive: evaluation.Score
    """The same stack decoded as the chapter does: one exposure, saturation ignored."""
    seconds: dict[str, float]
    """Time each step took; writing of all files but the report is one."""


def run(
    scene: scenes.Scene,
    folder: str | Path,
    seed: int = 0,
    fusion: str = "max-modulation",
    steps: Steps | None = None,
) -> Run:
    """Render, expose, decode and score a scene, writing every file into `folder`.

    Files are written beside and renamed one by one: an interrupted run leaves each file either old or new, never half.
    An earlier run in `folder` is replaced once this one has succeeded; until then it stays as it is.
    Raises `FringebenchError` for whatever the scene or the folder does not allow.
    """
    # A misspelt rule is told before light is traced, not after.
    decode.Options(fusion=fusion).rule()
    out = prepare(folder)
    steps = steps or Steps()
    step = steps.step
    with keeping(out, FILES) as keep:

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
            naive = evaluation.score(decode.reconstruct(middle_exposure(stack), **NAIVE), truth)
        write("scores.json", score.write)
        write("cloud.ply", lambda path: evaluation.write_cloud(path, reconstruction, truth))
        result = Run(out, scene, stack, truth, reconstruction, fusion, score, naive, steps.seconds)
        with step("report"):
            from fringebench.run_report import run_report

            keep("report.html", run_report(result, dict(steps.seconds)).write)
    return result


def middle_exposure(stack: scenes.Stack) -> scenes.Stack:
    """The stack's middle exposure alone: what one would have taken without several."""
    middle = decode.middle_exposure(stack.exposure_ms)
    return scenes.Stack(
        stack.frames[middle : middle + 1],
        stack.patterns,
        stack.exposure_ms[middle : middle + 1],
        stack.sensor,
        stack.calibration,
        stack.scene,
        stack.seed,
    )


@contextmanager
def keeping(
    folder: Path, files: Collection[str] = ()
) -> Iterator[Callable[[str, Callable[[Path], None]], None]]:
    """Give a function that writes a file of that name into `folder`; a `KeyboardInterrupt` says which were written.

    Where one of `files` stands already, all are written when the block has succeeded, not before: files of two runs, each
    whole, would be wrong together. Raises `FileError` while another run writes there.
    """
    written: list[str] = []
    later: list[tuple[str, Callable[[Path], None]]] = []

    def put(name: str, write: Callable[[Path], None]) -> None:
        write(folder / name)
        written.append(name)

    try:
        with alone(folder):
            earlier = any((folder / name).exists() for name in files)
            yield (lambda name, write: later.append((name, write))) if earlier else put
            for name, write in later:
                put(name, write)
    except KeyboardInterrupt:
        kept = ", ".join(written) or "nothing new"
        raise KeyboardInterrupt(f"whole and kept in {folder}: {kept}") from None
    except FileError as error:
        if not later or not written:
            raise
        raise FileError(
            f"{error}; {', '.join(written)} in '{folder}' are this run's, the rest an earlier one's: run again"
        ) from error


def prepare(folder: str | Path) -> Path:
    """The output folder, made if need be; `FileError` if it cannot be."""
    out = Path(folder)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"cannot make the folder '{out}': {error.strerror or error}; choose another with -o"
        ) from error
    return out
