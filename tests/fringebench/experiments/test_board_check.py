"""A board's files read by two readers."""

from pathlib import Path

import pytest
from PIL import Image

from tests.conftest import Call

HEAD = "%FSLAX46Y46*%%MOMM*%%TF.FileFunction,{},Top*%\n"
FLASHES = (
    "%ADD10R,1.0X0.5*%%ADD11C,0.4*%\n{}D10*\nX2000000Y2000000D03*\nD11*\nX4000000Y{}D03*\nM02*\n"
)
OUTLINE = """%FSLAX46Y46*%%MOMM*%%TF.FileFunction,Profile,NP*%
%ADD10C,0.1*%
D10*
G01*
X0Y0D02*
X6000000Y0D01*
X6000000Y5000000D01*
X0Y5000000D01*
X0Y0D01*
M02*
"""


@pytest.mark.parametrize(
    ("scale", "y", "status", "said"),
    [
        ("", "3000000", 0, "True"),
        # Load scaling, which the second reader leaves out.
        ("%LS2.0*%\n", "3000000", 1, "False"),
        ("", "9000000", 1, "outside the outline, not printed: P2"),
    ],
    ids=["both agree", "readers differ", "pad outside"],
)
def test_layers_are_read_twice_and_drawn(
    call: Call, tmp_path: Path, scale: str, y: str, status: int, said: str
) -> None:
    pytest.importorskip("gerbonara")
    body = FLASHES.format(scale, y)
    (tmp_path / "paste.gbr").write_text(HEAD.format("Paste") + body)
    (tmp_path / "outline.gbr").write_text(OUTLINE)
    picture = tmp_path / "out.png"
    found, output, _ = call("board", "check", str(tmp_path), "-o", str(picture))
    assert found == status, output
    assert said in output
    with Image.open(picture) as image:
        assert min(image.size) > 500
