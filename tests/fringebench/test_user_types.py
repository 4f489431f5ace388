"""Types reach the user: mypy and pyright accept a user script, and see its mistakes."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = Path(__file__).with_name("user_script.py")
# A mistake in each way of use, which only types can show before the script runs.
MISTAKES = {
    'saturation="ignore"': 'saturation="ignored"',
    "result.folder": "result.directory",
    "seeds=range(3)": "seeds=3",
    ".stack)": ".stacks)",
}

pytestmark = pytest.mark.slow


def _mypy(script: Path) -> str:
    words = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", str(script)]
    words += ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(script.parent)]
    env = os.environ | {"MYPYPATH": str(ROOT)}
    return subprocess.run(
        words, cwd=ROOT, env=env, capture_output=True, text=True, check=False
    ).stdout


def _pyright(script: Path) -> str:
    program = shutil.which("basedpyright", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("basedpyright is not installed")
    config = {"include": [script.name], "typeCheckingMode": "standard", "extraPaths": [str(ROOT)]}
    (script.parent / "pyrightconfig.json").write_text(json.dumps(config))
    words = [
        program,
        "--project",
        str(script.parent),
        "--pythonpath",
        sys.executable,
        "--level",
        "error",
    ]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else done.stdout


@pytest.mark.parametrize("check", [_mypy, _pyright], ids=["mypy", "pyright"])
def test_user_script_is_accepted_and_each_mistake_is_detected(
    check: object, tmp_path: Path
) -> None:
    assert callable(check)
    script = tmp_path / "script.py"
    text = SCRIPT.read_text("utf-8")
    script.write_text(text)
    assert check(script) == ""
    for right, wrong in MISTAKES.items():
        assert right in text
        text = text.replace(right, wrong)
    script.write_text(text)
    found = check(script)
    lines = [line for line in found.splitlines() if "error" in line]
    assert len(lines) >= len(MISTAKES), found


def test_every_package_says_that_it_is_typed() -> None:
    for package in ("scenes", "render", "decode", "evaluation", "fringebench"):
        assert (ROOT / package / "py.typed").is_file()
