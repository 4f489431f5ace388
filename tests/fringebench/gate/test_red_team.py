"""Cheating, crashing and lying decoders against the gate: none passes, none hangs, none is blamed on the gate."""

import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fringebench.gate.cases import Case, suite
from fringebench.gate.regression_gate import regress
from scenes.files.stack import Stack
from scenes.support.errors import OutsideDecoderError
from tests.commands import finish, start
from tests.fringebench.gate import cheating_decoders

HERE = "tests.fringebench.gate.cheating_decoders"
# Generous for a loaded machine; a decoder that hangs would take 600 s.
LIMIT_S = 300.0
# Their lie is in what their process does; the others lie in numbers, which need no process.
LIE_BY_PROCESS = ("patches_the_gate", "looks_for_the_truth")
ODD_AND_HONEST = ("is_a_class_of_its_own", "leaves_the_process_changed")


@pytest.fixture(scope="module")
def baseline(sweep: tuple[Case, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("gate") / "honest.json"
    regress(cheating_decoders.honest, file, update=True, cases=sweep, seeds=range(4))
    return file


@pytest.fixture(autouse=True)
def own_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("FRINGEBENCH_RED_TEAM", str(tmp_path))


# A process of two seconds each: one of every kind is quick.
NO_ANSWER = [
    ("kills_itself", "killed by signal 9"),
    ("kills_its_supervisor", "process that supervises it"),
    ("interrupts", "raised KeyboardInterrupt"),
    ("prints_without_end", "printed more than 64 MB"),
    ("forges_an_answer", "wrote into the gate's own pipe"),
    ("gives_objects", "object"),
    ("allocates_without_end", "raised .*MemoryError"),
    ("answers_by_a_pipe", "not a plain file"),
]
FURTHER = [
    ("leaves_politely", r"called sys\.exit\(0\)"),
    ("leaves_at_once", "ended with status 0 during the stack, without an answer"),
    ("stops_its_supervisor", "longer than|process that supervises it"),
    ("forks_and_leaves", "ended with status 0|status 77"),
    ("closes_every_file", "without an answer|raised OSError|cannot be"),
    ("gives_a_masked_array", "masked array"),
    ("gives_records", "of shape"),
    ("raises_what_cannot_be_said", "text cannot be made"),
    ("raises_a_novel", "raised RuntimeError: x{400}$"),
    ("forbids_itself_files", "without an answer|raised OSError"),
    ("answers_without_end", "claims shape"),
    ("answers_too_deep", "wrote into the gate's own pipe"),
    ("answers_infinitely_often", "damaged its own answer"),
    ("blocks_the_next_stack", "damaged the folder it works in"),
]


@pytest.mark.parametrize(
    ("decoder", "named"),
    [*NO_ANSWER, *(pytest.param(*case, marks=pytest.mark.slow) for case in FURTHER)],
)
def test_decoder_that_gives_no_answer_is_named_as_the_fault(
    sweep: tuple[Case, ...], baseline: Path, decoder: str, named: str
) -> None:
    # Stopping the supervisor is noticed at the end of the time; the others end sooner, also on a loaded machine.
    timeout_s = 20.0 if decoder == "stops_its_supervisor" else 100.0
    started = time.monotonic()
    with pytest.raises(OutsideDecoderError, match=named):
        regress(f"{HERE}:{decoder}", baseline, cases=sweep, seeds=range(4), timeout_s=timeout_s)
    assert time.monotonic() - started < LIMIT_S


@pytest.mark.parametrize(
    ("decoder", "named"),
    [
        (cheating_decoders.masks_by_a_fifth, r"mask holds 0\.2"),
        (cheating_decoders.masks_by_nan, "mask holds nan"),
        (cheating_decoders.claims_a_negative_sigma, "sigma is negative"),
        (cheating_decoders.gives_complex, "complex128"),
    ],
)
def test_answer_of_another_kind_is_refused(
    sweep: tuple[Case, ...], decoder: Callable[[Stack], Any], named: str
) -> None:
    with pytest.raises(OutsideDecoderError, match=named):
        regress(decoder, cases=sweep, seeds=range(3))


@pytest.mark.parametrize(
    "decoder", ["hangs", pytest.param("hangs_in_many_threads", marks=pytest.mark.slow)]
)
def test_decoder_that_hangs_is_ended_with_all_it_started(
    sweep: tuple[Case, ...], baseline: Path, decoder: str
) -> None:
    with pytest.raises(OutsideDecoderError, match="took longer than 8 s"):
        regress(f"{HERE}:{decoder}", baseline, cases=sweep, seeds=range(4), timeout_s=8.0)
    assert not processes_with("fringebench-red-team")


@pytest.mark.parametrize(
    ("decoder", "metric"),
    [
        ("moves_a_third_and_claims_everything", "wrong_order_fraction"),
        ("claims_infinite_sigma", "excess_sigma_mm"),
        ("claims_sigma_of_one_pixel", "excess_sigma_mm"),
        ("claims_three_times_its_sigma", "excess_sigma_mm"),
        ("claims_half_its_sigma", "beyond_1_sigma_fraction"),
        ("errs_by_two_and_a_half_sigmas", "beyond_2_sigma_fraction"),
        ("errs_by_four_sigmas", "beyond_3_sigma_fraction"),
        ("wrong_orders_in_one_percent", "wrong_order_fraction"),
        ("gives_nothing", "missing_fraction"),
        ("gives_what_is_easy", "missing_fraction"),
        ("remembers_the_first", "systematic_mm"),
        ("patches_the_gate", "bias_mm"),
        ("subtracts_the_noise", "missing_fraction"),
        ("looks_for_the_truth", "missing_fraction"),
    ],
)
def test_lying_decoder_fails_by_the_figure_made_for_it(
    sweep: tuple[Case, ...], baseline: Path, decoder: str, metric: str
) -> None:
    apart = decoder in LIE_BY_PROCESS
    spec = f"{HERE}:{decoder}" if apart else getattr(cheating_decoders, decoder)
    found = regress(spec, baseline, cases=sweep, seeds=range(4))
    assert metric in {row.metric for row in found.failed if row.comparison.verdict == "worse"}


def test_baseline_is_read_before_the_decoder_runs(
    sweep: tuple[Case, ...], baseline: Path, tmp_path: Path
) -> None:
    own = tmp_path / "baseline.json"
    own.write_bytes(baseline.read_bytes())
    found = regress(f"{HERE}:rewrites_the_baseline", own, cases=sweep, seeds=range(4))
    assert "bias_mm" in {row.metric for row in found.failed}


@pytest.mark.parametrize(
    "decoder",
    [
        "decode:reconstruct",
        *(pytest.param(f"{HERE}:{name}", marks=pytest.mark.slow) for name in ODD_AND_HONEST),
    ],
)
def test_honest_decoder_passes(sweep: tuple[Case, ...], baseline: Path, decoder: str) -> None:
    found = regress(decoder, baseline, cases=sweep, seeds=range(4))
    assert found.passed, found.describe()
    assert not processes_with("fringebench-red-team")


@pytest.mark.slow
def test_unseen_heights_made_up_fail(tmp_path: Path) -> None:
    """Of a case with shadow: a height where no light falls is an invention, however modest its sigma."""
    cases = suite(("highlight",))
    file = tmp_path / "honest.json"
    regress("decode:reconstruct", file, update=True, cases=cases, seeds=range(3))
    found = regress(f"{HERE}:guesses_a_plane", file, cases=cases, seeds=range(3))
    assert ("unlit", "invented_fraction") in {(row.region, row.metric) for row in found.failed}


PROGRAMS = {
    "empty": ("open(out + '.npy', 'wb').close()", "empty, damaged or no NPY"),
    "lying": (
        "import numpy as np; from numpy.lib import format as f; file = open(out + '.npy', 'wb'); "
        "f.write_array_header_1_0(file, dict(descr='<f8', fortran_order=False, shape=(10**6, 10**6)))",
        "claims shape",
    ),
    "pickle": (
        "import numpy as np; np.save(out + '.npy', np.array([print], object), allow_pickle=True)",
        "not a pickle",
    ),
    "fifo": ("import os; os.mkfifo(out + '.npy')", "a link, a pipe, a device"),
    "bare fifo": ("import os; os.mkfifo(out)", "wrote 0"),
    "device": ("import os; os.symlink('/dev/zero', out + '.npy')", "a link, a pipe, a device"),
    "too large": ("open(out + '.tif', 'wb').truncate(1 << 31)", "bytes"),
    "text": ("open(out + '.tif', 'w').write('heights')", "no readable TIFF"),
    "chatter": (
        "import os\nfor _ in range(700): os.write(1, b'x' * (1 << 20))",
        "printed more than 64 MB",
    ),
    "two files": ("open(out + '.npy', 'w'); open(out + '.exr', 'w')", "wrote 2"),
    "exit": ("raise SystemExit(0)", "wrote 0"),
    "grandchild": (
        "import subprocess, sys, time\nsubprocess.Popen([sys.executable, '-c', "
        "'import time; time.sleep(600)  # fringebench-red-team-program'], start_new_session=True)\ntime.sleep(600)",
        "longer than 4 s",
    ),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_program_that_misbehaves_is_named_as_the_fault(
    sweep: tuple[Case, ...], baseline: Path, tmp_path: Path, name: str
) -> None:
    body, named = PROGRAMS[name]
    program = tmp_path / "program.py"
    program.write_text(f"import sys\nout = sys.argv[2]\n{body}\n")
    command = f"{sys.executable} {program} {{manifest}} {{output}}"
    with pytest.raises(OutsideDecoderError, match=named):
        # Only one of them uses up its time: the others have enough on a loaded machine.
        timeout_s = 4.0 if "longer" in named else 100.0
        regress(command, baseline, cases=sweep, seeds=range(3), timeout_s=timeout_s)
    assert not processes_with("fringebench-red-team-program")


LEAVING = {
    "sys.exit": ("import sys\nsys.exit(0)\n", r"called sys\.exit\(0\)"),
    "os._exit": ("import os\nos._exit(0)\n", "ended with status 0"),
    "fork": ("import os\nif os.fork():\n    os._exit(0)\n", "has no 'decode'|ended with status"),
    "closed": ("import os\nos.closerange(0, 256)\nos._exit(0)\n", "ended with status|without"),
}


@pytest.mark.parametrize(
    "way",
    ["sys.exit", *(pytest.param(w, marks=pytest.mark.slow) for w in LEAVING if w != "sys.exit")],
)
def test_module_that_leaves_at_import_ends_with_status_two(tmp_path: Path, way: str) -> None:
    """The gate once ended with status 0 and no verdict."""
    code, named = LEAVING[way]
    (tmp_path / "leaving.py").write_text(code)
    status, out, err = finish(start("regress", "leaving:decode", folder=tmp_path))
    assert (status, out) == (2, "")
    assert re.search(named, err), err
    assert "Traceback" not in err


def test_prints_of_a_decoder_stay_out_of_the_answer(
    sweep: tuple[Case, ...], capfd: pytest.CaptureFixture[str]
) -> None:
    regress(f"{HERE}:prints_a_line", cases=sweep, seeds=range(3))
    assert capfd.readouterr().out == ""


def processes_with(marker: str) -> list[str]:
    """Command lines of running processes that hold a marker."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            line = (entry / "cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue
        if marker in line:
            found.append(line)
    return found
