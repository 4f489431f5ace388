"""The how-to's example, word for word: installed, found, and as good as it says."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import decode
from evaluation.strategies import strategies
from scenes.sensor import Emva
from tests.decode.test_hdr import all_phases, capture, errors, phases

PAGE = Path(__file__).parents[2] / "docs" / "how-to-own-fusion-rule.md"


def block(language: str) -> str:
    """The first block of that language on the page."""
    found = re.search(rf"```{language}\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert found
    return found[1]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The example laid out as an installed distribution; its rule's name."""
    project = tomllib.loads(block("toml"))
    points = project["project"]["entry-points"]["fringebench.fusion"]
    info = tmp_path / "my_fusion-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-fusion\nVersion: 1.0\n")
    lines = [f"{name} = {value}" for name, value in points.items()]
    (info / "entry_points.txt").write_text("[fringebench.fusion]\n" + "\n".join(lines) + "\n")
    (module,) = project["tool"]["setuptools"]["py-modules"]
    (tmp_path / f"{module}.py").write_text(block("python"), "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    (name,) = points
    return str(name)


def test_the_example_is_found_decodes_and_predicts_its_noise(installed: str) -> None:
    assert installed in decode.rules()
    assert strategies([installed])[0].fusion == installed
    phase = all_phases(100, 400)
    # the longest exposure clips everywhere, the middle one peaks at 2700 DN of 4054
    stack = capture(phase, 220.0, 200.0, (0.8, 6.0, 30.0), Emva(), seed=3)
    rec = phases(stack, installed)
    assert rec.valid.all()
    error = errors(rec, phase)
    ratio = np.sqrt(np.mean(error**2 / rec.sigma_mm.astype(np.float64) ** 2))
    # 40 000 values scatter by 0.35 %; a weight that falls with the peak's own noise moves it by less than 1 %
    assert ratio == pytest.approx(1.0, abs=0.03)
    assert abs(error.mean()) < 5.0 * error.std() / 200.0
