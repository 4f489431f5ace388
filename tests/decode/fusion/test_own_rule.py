"""The how-to's example, word for word: installed, found, and as good as it says."""

import re
import sys
import tomllib
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decode
from decode import Samples
from decode.device import Device
from decode.phase.n_step import fringe_sets
from evaluation.hdr.strategy_lookup import strategies
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import Emva, SimpleSensor
from scenes.files.stack import Stack
from tests.decode.fusion.test_hdr import all_phases, capture, errors, phases

PAGE = Path(__file__).parents[3] / "docs" / "how-to-own-fusion-rule.md"


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


def test_own_rule_example_is_found_decodes_and_predicts_its_noise(installed: str) -> None:
    assert installed in decode.rules()
    assert strategies([installed])[0].fusion == installed
    phase = all_phases(100, 400)
    # The longest exposure clips everywhere, the middle one peaks at 2700 DN of 4054.
    stack = capture(phase, 220.0, 200.0, (0.8, 6.0, 30.0), Emva(), seed=3)
    rec = phases(stack, installed)
    assert rec.valid.all()
    error = errors(rec, phase)
    ratio = np.sqrt(np.mean(error**2 / rec.sigma_mm.astype(np.float64) ** 2))
    # 40 000 values scatter by 0.35 %; a weight that falls with the peak's own noise moves it by less than 1 %.
    assert ratio == pytest.approx(1.0, abs=0.03)
    assert abs(error.mean()) < 5.0 * error.std() / 200.0


def test_rule_with_neighbours_avoids_exposures_near_saturation() -> None:
    """The second example: 2 px around a clipped pixel, the short exposure is taken; elsewhere the long one."""
    made: dict[str, Any] = {"__name__": "my_neighbours"}
    sys.modules["my_neighbours"] = types.ModuleType("my_neighbours")
    try:
        source = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
        (text,) = [t for t in source if "class AwayFromSaturation" in t]
        exec(text, made)
    finally:
        del sys.modules["my_neighbours"]
    patterns = PhaseShift(periods_px=(16.0,)).frames()
    shift = np.array([f.phase_shift_rad for f in patterns])[:, None, None]
    light = np.full((20, 30), 20.0)
    light[8, 9] = 2000.0
    wave = light * (1.0 + 0.9 * np.cos(shift))
    frames = np.stack([np.clip(np.rint(t * wave), 0, 4095) for t in (1.0, 8.0)]).astype(np.uint16)
    stack = Stack(frames, patterns, (1.0, 8.0), SimpleSensor(sigma_dn=1.0, bits=12))
    rule = made["AwayFromSaturation"]()
    rec = decode.reconstruct(stack, fusion=rule, height="phase", unwrap="row-scan")
    near = np.zeros((20, 30), bool)
    near[6:11, 7:12] = True
    assert ((rec.exposure == 0) == near).all()
    # A part of the pixels reads its own values.
    at = Device.open().types.UInt32([8 * 30 + 9, 0])
    (fringes,) = fringe_sets(patterns, 0)["column"]
    some = Samples.of(Device.open(), stack, fringes, at=at)
    assert some.image(light).numpy().tolist() == [2000.0, 20.0]
