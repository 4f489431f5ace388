"""The command `decode`: every choice reaches the decoder, and what is not known is said."""

import json
from pathlib import Path

import numpy as np
import pytest

from scenes.acquisition.patterns import PhaseShift
from tests.conftest import Call
from tests.decode.synthetic import calibrated_stack, hills, rig


@pytest.fixture
def stacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stack of two periods and axes, and one of a single period in a volume of three fringes."""
    monkeypatch.chdir(tmp_path)
    both = PhaseShift(periods_px=(16.0, 80.0), axes=("column", "row"))
    calibrated_stack(rig(), hills(), both, sigma_dn=1.0, dtype=np.uint8).write("both.exr")
    deep, one = rig(heights_mm=(-1.0, 12.0)), PhaseShift(periods_px=(40.0,))
    calibrated_stack(deep, hills(), one, sigma_dn=1.0, dtype=np.uint8).write("one.exr")


@pytest.mark.usefixtures("stacks")
def test_every_choice_is_used_and_reported(call: Call) -> None:
    words = "--axis row --anchor volume --saturation ignore --min-modulation-dn 5 --max-order-residual 0.1 --uncertainty by-cause"
    status, out, err = call("decode", "both.exr", *words.split(), "--json")
    assert status == 0, err
    settings = json.loads(out)["settings"]
    asked = {
        "anchor": "volume",
        "saturation": "ignore",
        "min_modulation_dn": 5.0,
        "uncertainty": "by-cause",
    }
    assert asked.items() <= settings.items() and settings["max_order_residual"] == 0.1
    resolved = settings["resolved"]
    assert (resolved["axis"], resolved["order"]) == ("row", "absolute")


@pytest.mark.usefixtures("stacks")
@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--anchor", "grey", "did you mean 'gray'"),
        ("--axis", "columns", "did you mean 'column'"),
        ("--saturation", "rejects", "did you mean 'reject'"),
        ("--max-order-residual", "0.9", "at most 0.5"),
        ("--uncertainty", "by-causes", "did you mean 'by-cause'"),
    ],
)
def test_impossible_choice_is_refused(call: Call, option: str, value: str, said: str) -> None:
    status, _, err = call("decode", "both.exr", option, value)
    assert (status, said in err) == (2, True)
    assert not Path("reconstruction.exr").exists()


@pytest.mark.usefixtures("stacks")
def test_order_up_to_whole_turns_is_reported(call: Call) -> None:
    status, out, _ = call("decode", "one.exr")
    assert (status, "known only up to whole turns" in " ".join(out.split())) == (0, True)
    status, out, _ = call("decode", "one.exr", "--json")
    answer = json.loads(out)
    assert answer["settings"]["resolved"]["order"] == "known only up to whole turns"
    assert answer["reasons"]["order-unknown"] == 1.0
