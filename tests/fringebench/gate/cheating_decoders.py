"""Decoders that cheat, crash and lie, one way each."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.files.stack import Stack

Image = NDArray[np.floating]


def honest(stack: Stack) -> tuple[Image, NDArray[np.bool_], Image]:
    # Most decoders here need none: their process starts faster without.
    import decode

    rec = decode.reconstruct(stack)
    return rec.height_mm.copy(), rec.valid.copy(), rec.sigma_mm.copy()


def _child_that_stays(session: bool) -> None:
    """A process that would outlive the run; its marker is in its command line."""
    code = "import time; time.sleep(600)  # fringebench-red-team"
    subprocess.Popen([sys.executable, "-c", code], start_new_session=session)


def leaves_politely(stack: Stack) -> Any:
    sys.exit(0)


def leaves_at_once(stack: Stack) -> Any:
    os._exit(0)


def kills_itself(stack: Stack) -> Any:
    os.kill(os.getpid(), signal.SIGKILL)


def kills_its_supervisor(stack: Stack) -> Any:
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(600)


def stops_its_supervisor(stack: Stack) -> Any:
    os.kill(os.getppid(), signal.SIGSTOP)
    os._exit(0)


def interrupts(stack: Stack) -> Any:
    raise KeyboardInterrupt


def forks_and_leaves(stack: Stack) -> Any:
    """The copy answers, the process that was asked does not."""
    if os.fork():
        os._exit(0)
    return honest(stack)


def closes_every_file(stack: Stack) -> Any:
    os.closerange(0, 256)
    return honest(stack)


def hangs(stack: Stack) -> Any:
    _child_that_stays(session=True)
    time.sleep(600)


def hangs_in_many_threads(stack: Stack) -> Any:
    for _ in range(8):
        threading.Thread(target=time.sleep, args=(600,)).start()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    time.sleep(600)


def prints_without_end(stack: Stack) -> Any:
    for _ in range(700):
        os.write(1, b"x" * (1 << 20))
    return honest(stack)


def forges_an_answer(stack: Stack) -> Any:
    """Writes nonsense into every pipe it holds."""
    for descriptor in range(3, 64):
        try:
            os.write(descriptor, b'["passed"]\n')
        except OSError:
            continue
    return honest(stack)


def gives_a_masked_array(stack: Stack) -> Any:
    height, valid, _ = honest(stack)
    return np.ma.masked_array(height, ~valid)


def masks_by_a_fifth(stack: Stack) -> Any:
    height, valid, sigma = honest(stack)
    return height, np.where(valid, 0.2, 0.0), sigma


def masks_by_nan(stack: Stack) -> Any:
    height, valid, sigma = honest(stack)
    mask = valid.astype(np.float32)
    mask[0] = np.nan
    return height, mask, sigma


def gives_objects(stack: Stack) -> Any:
    return honest(stack)[0].astype(object)


def claims_a_negative_sigma(stack: Stack) -> Any:
    height, valid, sigma = honest(stack)
    return height, valid, -sigma


def gives_complex(stack: Stack) -> Any:
    return honest(stack)[0].astype(complex)


def gives_records(stack: Stack) -> Any:
    return np.zeros(stack.frames.shape[2:], [("height", float), ("valid", bool)])


def raises_what_cannot_be_said(stack: Stack) -> Any:
    class Silent(Exception):
        def __str__(self) -> str:
            raise ValueError("no words")

    raise Silent


def raises_a_novel(stack: Stack) -> Any:
    raise RuntimeError("x" * (1 << 20))


def allocates_without_end(stack: Stack) -> Any:
    kept = []
    while True:
        kept.append(np.zeros(1 << 30, np.uint8))


def forbids_itself_files(stack: Stack) -> Any:
    import resource

    resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    return np.zeros(stack.frames.shape[2:])


def _answer_folder() -> tuple[Path, int]:
    """Where the gate looks for the answer, and the pipe that says that it is there; any code in the process can find them."""
    frame = sys._getframe()
    while frame.f_back is not None and "answers" not in frame.f_locals:
        frame = frame.f_back
    return Path(frame.f_locals["folder"]), int(frame.f_locals["answers"])


def answers_by_a_pipe(stack: Stack) -> Any:
    folder, answers = _answer_folder()
    os.mkfifo(folder / "heights.npy")
    os.write(answers, b'{"parts": 1}\n')
    time.sleep(600)


def answers_without_end(stack: Stack) -> Any:
    """A file of 2^40 bytes that takes no room, as its header says."""
    folder, answers = _answer_folder()
    with (folder / "heights.npy").open("wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": (1 << 37,)}
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(file.tell() + (1 << 40))
    os.write(answers, b'{"parts": 1}\n')
    time.sleep(600)


def answers_too_deep(stack: Stack) -> Any:
    os.write(_answer_folder()[1], b"[" * 4000 + b"\n")
    time.sleep(600)


def answers_infinitely_often(stack: Stack) -> Any:
    os.write(_answer_folder()[1], b'{"parts": 1e999}\n')
    time.sleep(600)


def blocks_the_next_stack(stack: Stack) -> Any:
    """Leaves a pipe, then a folder, where the gate writes the next stack."""
    place = _answer_folder()[0] / "stack"
    place.unlink()
    place.mkdir()
    return honest(stack)


# What follows answers, and lies.


def patches_the_gate(stack: Stack) -> Any:
    """Replaces the judge by one that finds no fault, and says that it has passed."""
    import evaluation.gate.equivalence
    import evaluation.gate.regression
    import fringebench.gate.regression_gate

    def harmless(*_: Any, **__: Any) -> dict[str, Any]:
        return {}

    for module in (evaluation.gate.regression, fringebench.gate.regression_gate):
        module.measure = harmless  # type: ignore[attr-defined]
    evaluation.gate.equivalence.EquivalenceTest.passed = True  # type: ignore[assignment, method-assign]
    print('{"passed": true}\ndecode compared with default: passed, 59 figures', flush=True)
    height, valid, sigma = honest(stack)
    return 1.01 * height, valid, sigma


def rewrites_the_baseline(stack: Stack) -> Any:
    """Lowers what it is compared with, to its own figures."""
    place = Path(os.environ["FRINGEBENCH_RED_TEAM"])
    for file in (place / "baseline.json", place / "baseline.json.maps.npz"):
        file.write_text("{}")
    height, valid, sigma = honest(stack)
    return 1.01 * height, valid, sigma


def subtracts_the_noise(stack: Stack) -> Any:
    """Makes the noise again from the seed, if it is given one, and leaves it out; else gives up."""
    return honest(stack) if stack.seed is not None else np.full(stack.frames.shape[2:], np.nan)


def looks_for_the_truth(stack: Stack) -> Any:
    """Gives the truth, if its process or its folder holds one."""
    import gc

    shape = stack.frames.shape[2:]
    for thing in gc.get_objects():
        if type(thing).__name__ in ("Truth", "Case", "Baseline"):
            return thing.height_mm
    for file in _answer_folder()[0].iterdir():
        if file.name not in ("stack", "heights.npy"):
            return np.load(file)
    return np.full(shape, np.nan)


# What follows is odd, and honest.


def is_a_class_of_its_own(stack: Stack) -> Any:
    """An array that says it has another shape and other numbers."""

    class Odd(np.ndarray[Any, Any]):
        shape = (1, 1)  # type: ignore[override]

        def __array_function__(self, *_: Any, **__: Any) -> Any:
            raise RuntimeError("not with me")

    height, valid, sigma = honest(stack)
    height.flags.writeable = False
    return height.view(Odd), np.asfortranarray(valid), sigma[::-1][::-1]


def leaves_the_process_changed(stack: Stack) -> Any:
    """Other folder, umask, locale, signals and number format; standard output closed; a thread that goes on."""
    import locale

    found = honest(stack)
    os.chdir("/")
    os.umask(0o777)
    locale.setlocale(locale.LC_ALL, "C")
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    np.set_printoptions(threshold=0)
    os.dup2(2, 1)
    os.close(1)
    _child_that_stays(session=True)
    threading.Thread(target=time.sleep, args=(600,)).start()
    return found


def moves_a_third_and_claims_everything(stack: Stack) -> Any:
    """30 % of the pixels are 50 mm off, behind a sigma of a thousand kilometres."""
    height, valid, sigma = honest(stack)
    wrong = np.random.default_rng(int(stack.frames.sum())).random(height.shape) < 0.3
    return np.where(wrong, height + 50.0, height), valid, np.full_like(sigma, 1e9)


def claims_infinite_sigma(stack: Stack) -> Any:
    height, valid, sigma = honest(stack)
    return height, valid, np.full_like(sigma, np.inf)


def claims_sigma_of_one_pixel(stack: Stack) -> Any:
    """Unknown almost everywhere."""
    height, valid, sigma = honest(stack)
    unknown = np.full_like(sigma, np.nan)
    unknown[0, 0] = 1.0
    return height, valid, unknown


def claims_three_times_its_sigma(stack: Stack) -> Any:
    height, valid, sigma = honest(stack)
    return height, valid, 3.0 * sigma


def claims_half_its_sigma(stack: Stack) -> Any:
    height, valid, sigma = honest(stack)
    return height, valid, 0.5 * sigma


def errs_by_two_and_a_half_sigmas(stack: Stack) -> Any:
    """In 8 % of the pixels: more errors beyond 2 sigmas, few beyond 3."""
    return _off_by(stack, 2.5, 0.08)


def errs_by_four_sigmas(stack: Stack) -> Any:
    """In 4 % of the pixels: errors that are not silent, since 5 sigmas cover them."""
    return _off_by(stack, 4.0, 0.04)


def _off_by(stack: Stack, sigmas: float, share: float) -> tuple[Image, NDArray[np.bool_], Image]:
    height, valid, sigma = honest(stack)
    some = np.random.default_rng(int(stack.frames.sum())).random(height.shape) < share
    return height + np.where(some, sigmas * sigma, 0.0), valid, sigma


def wrong_orders_in_one_percent(stack: Stack) -> Any:
    """One order off in 1 % of the pixels, honestly claimed as unknown."""
    height, valid, sigma = honest(stack)
    wrong = np.random.default_rng(int(stack.frames.sum())).random(height.shape) < 0.01
    assert stack.calibration is not None
    low, high = stack.calibration.height_range_mm
    return np.where(wrong, height + (high - low), height), valid, np.where(wrong, 1e3, sigma)


def gives_nothing(stack: Stack) -> Any:
    return np.full(stack.frames.shape[2:], np.nan)


def gives_what_is_easy(stack: Stack) -> Any:
    """Only the pixels it is surest of."""
    height, valid, sigma = honest(stack)
    return height, valid & (sigma < np.median(sigma)), sigma


def guesses_a_plane(stack: Stack) -> Any:
    """Inpaints: what it cannot see it makes up."""
    height, valid, sigma = honest(stack)
    middle = float(np.median(height[valid]))
    return np.full_like(height, middle), np.ones_like(valid), sigma


def remembers_the_first(stack: Stack) -> Any:
    """Decodes once and repeats that answer: its noise never changes."""
    place = Path(os.environ["FRINGEBENCH_RED_TEAM"]) / f"{stack.frames.shape}.npz"
    if not place.exists():
        height, valid, sigma = honest(stack)
        np.savez(place, height=height, valid=valid, sigma=sigma)
    kept = np.load(place)
    return kept["height"], kept["valid"], kept["sigma"]


def prints_a_line(stack: Stack) -> Any:
    """Honest, but talkative."""
    print("decoding")
    return honest(stack)
