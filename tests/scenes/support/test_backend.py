"""The choice of LLVM: never one that aborts the process, always the user's word first."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

from scenes.support import backend
from scenes.support.errors import BackendError


def test_llvm_of_the_user_is_preferred(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    mine = tmp_path / "libLLVM-19.so"
    mine.touch()
    monkeypatch.setenv(backend.VARIABLE, str(mine))
    assert backend.find_llvm() == backend.Llvm(mine, 19, "user")


def test_old_system_llvm_is_never_chosen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    old = [tmp_path / "libLLVM-14.so", tmp_path / "libLLVM-15.so.1"]
    monkeypatch.delenv(backend.VARIABLE, raising=False)
    monkeypatch.setattr(backend, "_of_environment", list)
    monkeypatch.setattr(backend, "_of_system", lambda: old)
    assert backend.find_llvm() is None
    new = tmp_path / "libLLVM.so.18.1"
    monkeypatch.setattr(backend, "_of_system", lambda: [*old, new, tmp_path / "libLLVM-16.so"])
    assert backend.find_llvm() == backend.Llvm(new, 18, "system")


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM.so.22.1", 22),
        ("libLLVM-15.so.1", 15),
        ("libLLVM-14.0.6.so.1", 14),
        ("libLLVM.so", 0),
    ],
)
def test_version_is_read_from_the_file_name(tmp_path: Path, name: str, version: int) -> None:
    assert backend.version_of(tmp_path / name) == version


@pytest.mark.parametrize(
    ("path", "said"),
    [("/nowhere/libLLVM.so", "does not exist"), ("libLLVM-15.so", "needs 16 or newer")],
)
def test_unusable_llvm_of_the_user_is_refused_with_the_fix(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, path: str, said: str
) -> None:
    (tmp_path / "libLLVM-15.so").touch()
    monkeypatch.setenv(backend.VARIABLE, str(tmp_path / path))
    with pytest.raises(BackendError, match=said):
        backend.select()


def test_missing_llvm_is_an_error_and_not_a_crash() -> None:
    # Dr.Jit left alone would search the system and may abort or raise SIGFPE: only a process of its own can show that.
    code = (
        "import scenes.support.backend as b\n"
        "b._of_environment = lambda: []\n"
        "b._of_system = lambda: []\n"
        "try: print('chose', b.select().name)\n"
        "except b.BackendError as e: print('refused', e)\n"
    )
    done = fresh(code, None)
    assert done.returncode == 0, done.stderr
    assert (
        done.stdout.startswith("chose cuda")
        or "pip install karellen-llvm-core" in done.stdout
        or (sys.platform == "darwin" and "brew install llvm" in done.stdout)
    )


@pytest.mark.skipif(
    importlib.util.find_spec("drjit") is None, reason="drjit is not installed on this machine"
)
def test_this_machine_has_a_backend() -> None:
    assert backend.select().name in {"llvm", "cuda"}


TRACE = (
    "import render, scenes\n"
    "light = render.trace(scenes.load('step', {'camera.resolution': [8, 6]}), samples=2)\n"
    "print('traced', light.total.mean())\n"
)
FIRST = {
    "drjit": "import drjit\n",
    "mitsuba": "import mitsuba\n",
    "a variant without drjit's types": "import mitsuba as mi; mi.set_variant('scalar_rgb')\n",
}
# A program takes four seconds each.
firsts = pytest.mark.parametrize(
    "first", ["drjit", *(pytest.param(n, marks=pytest.mark.slow) for n in list(FIRST)[1:])]
)


def fresh(code: str, llvm: str | None) -> subprocess.CompletedProcess[str]:
    """A program of its own, with the variable set to `llvm` or not at all."""
    environment = {k: v for k, v in os.environ.items() if k != backend.VARIABLE}
    if llvm is not None:
        environment[backend.VARIABLE] = llvm
    return subprocess.run(
        [sys.executable, "-W", "default", "-c", code],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )


@firsts
def test_good_llvm_is_used_although_drjit_was_imported_first(first: str) -> None:
    found = backend.find_llvm()
    if found is None:
        pytest.skip("no LLVM on this machine")
    done = fresh(FIRST[first] + TRACE, str(found.path))
    assert done.returncode == 0, done.stderr
    assert "traced" in done.stdout


@firsts
def test_importing_drjit_first_works_or_is_refused_without_a_crash(first: str) -> None:
    # What it loads depends on the machine: none, one that works, or one that aborts at the first kernel.
    done = fresh(FIRST[first] + TRACE, None)
    if done.returncode == 0:
        assert "traced" in done.stdout
    else:
        assert done.returncode == 1, "it died of a signal"
        assert "BackendError: drjit or mitsuba was imported first" in done.stderr


def test_importing_drjit_first_without_llvm_is_refused_with_the_fix() -> None:
    if backend.find_llvm() is None:
        pytest.skip("no LLVM on this machine")
    done = fresh(
        "import os, drjit\n"
        f"del os.environ['{backend.VARIABLE}']\n"
        "import scenes.support.backend as b\n"
        "try: print('chose', b.select().name)\n"
        "except b.BackendError as e: print('refused', e)\n",
        os.devnull,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("chose cuda") or (
        "loaded no LLVM" in done.stdout and f"{backend.VARIABLE}=" in done.stdout
    )


@pytest.mark.parametrize(
    ("wanted", "said"), [("gpu", "set it to llvm or cuda"), ("cuda", "finds no CUDA device")]
)
def test_unavailable_backend_asked_for_is_refused(
    monkeypatch: pytest.MonkeyPatch, wanted: str, said: str
) -> None:
    if wanted == "cuda" and backend.select().name == "cuda":
        pytest.skip("there is a CUDA device")
    monkeypatch.setenv(backend.WANTED, wanted)
    with pytest.raises(BackendError, match=said):
        backend.select()


def test_llvm_can_be_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(backend.WANTED, "llvm")
    assert backend.select().variant == "llvm_ad_mono"
