"""CSV tables of pads: what is written is read back, and judged the same."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import scenes
from evaluation.inspection.pad_limits import confusion
from evaluation.inspection.pad_measurement import PadMeasure
from evaluation.inspection.spi_csv import MACHINE_COLUMNS, read_spi_csv, write_spi_csv
from scenes.labels.pad_truth import BoardTruth
from scenes.support.errors import FileError, ScoreError


@pytest.fixture(scope="module")
def board() -> BoardTruth:
    """A board with each kind of defect."""
    kinds = ("missing", "insufficient", "excess", "offset", "bridge", "peak")
    defects = {name: {"probability": 0.15} for name in kinds}
    return scenes.board_truth(scenes.load("spi", {"board.defects": defects}))


def measured(board: BoardTruth) -> list[PadMeasure]:
    """Noisy figures of every pad; some pads were not measured."""
    rng = np.random.default_rng(2)
    pads = []
    for pad in board.pads:
        noise = 1.0 + 0.05 * rng.standard_normal(3)
        found = PadMeasure(
            pad.pad,
            pad.name,
            float(rng.uniform(0.5, 1.0)),
            0.04,
            pad.volume_mm3 * noise[0],
            pad.area_mm2 * noise[1],
            pad.mean_height_mm,
            pad.peak_height_mm * noise[2],
            pad.offset_x_mm,
            pad.offset_y_mm,
            pad.bridged_to,
        )
        if pad.pad % 10 == 0:
            found = PadMeasure(pad.pad, pad.name, 0.1, None, bare=pad.pad % 20 == 0)
        pads.append(found)
    return pads


def test_file_gives_the_same_confusion_as_the_figures(board: BoardTruth, tmp_path: Path) -> None:
    pads = measured(board)
    write_spi_csv(pads, board, tmp_path / "measured.csv", panel="P1")
    again = read_spi_csv(tmp_path / "measured.csv")
    assert confusion(again, board) == confusion(pads, board)
    for one, other in zip(pads, again, strict=True):
        assert (one.pad, one.name, one.bridged_to, one.bare) == (
            *(other.pad, other.name, other.bridged_to, other.bare),
        )
        for name in ("volume_mm3", "area_mm2", "peak_height_mm", "offset_x_mm", "reference_mm"):
            a, b = getattr(one, name), getattr(other, name)
            # Twelve digits.
            assert (a is None and b is None) or a == pytest.approx(b, rel=1e-10, abs=1e-12)


def test_truth_judged_against_itself_is_free_of_errors(board: BoardTruth, tmp_path: Path) -> None:
    write_spi_csv(board.pads, board, tmp_path / "truth.csv")
    table = confusion(read_spi_csv(tmp_path / "truth.csv"), board)
    assert table.gates["any"].caught > 10
    assert all(gate.escaped == gate.false_calls == 0 for gate in table.gates.values())


def test_columns_are_those_of_machines_in_their_units(board: BoardTruth, tmp_path: Path) -> None:
    write_spi_csv(board.pads, board, tmp_path / "truth.csv", panel="P7")
    with (tmp_path / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0])[: len(MACHINE_COLUMNS)] == MACHINE_COLUMNS
    for row, pad in zip(rows, board.pads, strict=True):
        assert (row["PanelID"], row["PadID"]) == ("P7", str(pad.pad))
        assert f"{row['ComponentID']}-{row['PinNumber']}" == pad.name
        assert float(row["Volume(um3)"]) == pytest.approx(1e9 * pad.volume_mm3)
        assert float(row["Volume(%)"]) == pytest.approx(
            100 * pad.volume_mm3 / pad.nominal_volume_mm3
        )
        assert float(row["Area(um2)"]) == pytest.approx(1e6 * pad.area_mm2)
        assert float(row["Height(um)"]) == pytest.approx(1e3 * pad.mean_height_mm)
        assert (row["OffsetX(mm)"] == "") == (pad.offset_x_mm is None)
        assert (row["Result"] == "GOOD") == (row["Defect"] == "")


def test_csv_of_a_machine_needs_only_pad_and_figures(board: BoardTruth, tmp_path: Path) -> None:
    path = tmp_path / "machine.csv"
    header = "PadID,Volume(um3),Area(um2),Height(um),OffsetX(mm),OffsetY(mm)"
    rows = [f"{pad.pad},1e7,1e5,100,0.01,-0.01" for pad in board.pads]
    path.write_text("\ufeff" + "\n".join([header, *rows]) + "\n", "utf-8")
    first = read_spi_csv(path)[0]
    assert first.volume_mm3 == pytest.approx(0.01)
    for figure in (first.area_mm2, first.mean_height_mm, first.peak_height_mm):
        assert figure == pytest.approx(0.1)
    assert first.coverage == 1.0
    confusion(read_spi_csv(path), board)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no pads"),
        ("PadID,Volume(um3)\n1,2\n", r"lacks the columns Area\(um2\)"),
        (
            "PadID,Volume(um3),Area(um2),Height(um),OffsetX(mm),OffsetY(mm)\n1,much,1,1,1,1\n",
            r"line 2: Volume\(um3\) is 'much'",
        ),
        (
            "PadID,Volume(um3),Area(um2),Height(um),OffsetX(mm),OffsetY(mm)\nx,1,1,1,1,1\n",
            "line 2: PadID",
        ),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "other.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=message):
        read_spi_csv(path)
    with pytest.raises(FileError, match="cannot be read"):
        read_spi_csv(tmp_path / "nowhere.csv")


def test_pad_of_another_board_is_refused(board: BoardTruth, tmp_path: Path) -> None:
    pad = replace(measured(board)[0], pad=10_000)
    with pytest.raises(ScoreError, match="pad 10000 is not on this board"):
        write_spi_csv([pad], board, tmp_path / "measured.csv")
    assert not (tmp_path / "measured.csv").exists()
