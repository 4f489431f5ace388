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

NEEDED = "PadID,Volume(um3),Area(um2),Height(um),OffsetX(mm),OffsetY(mm)"


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
    header = NEEDED
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


def machine_csv(path: Path, keys: list[tuple[str, ...]], columns: str = "Board") -> Path:
    """A file of equal deposits, with these columns before `NEEDED`."""
    rows = [f"{','.join(key)},1e7,1e5,100,0.01,-0.01" for key in keys]
    path.write_text("\n".join([f"{columns},{NEEDED}", *rows]) + "\n", "utf-8")
    return path


@pytest.fixture(scope="module")
def panel() -> BoardTruth:
    """Two boards of the same pads, each with its own print and defects."""
    missing = {"missing": {"probability": 0.3}}
    return scenes.board_truth(
        scenes.load("spi", {"board.defects": missing, "board.panel": {"columns": 2}})
    )


def test_ids_that_restart_give_the_same_confusion(panel: BoardTruth, tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    for restart in (False, True):
        write_spi_csv(panel.pads, panel, path, restart_pad_ids=restart)
        again = read_spi_csv(path, panel)
        assert [pad.pad for pad in again] == [pad.pad for pad in panel.pads]
        table = confusion(again, panel)
        assert table == confusion(measured_exactly(panel), panel)
        assert table.gates["missing"].caught > 2
    with path.open(newline="") as file:
        ids = [(row["Board"], row["PadID"]) for row in csv.DictReader(file)]
    n = len(panel.pads) // 2
    assert ids == [(b, str(k)) for b in "12" for k in range(1, n + 1)]
    with pytest.raises(FileError, match="PadID restarts on each board; give the panel's truth"):
        read_spi_csv(path)


def measured_exactly(board: BoardTruth) -> list[PadMeasure]:
    return [
        PadMeasure(
            *(p.pad, p.name, 1.0, None, p.volume_mm3, p.area_mm2, p.mean_height_mm),
            *(p.peak_height_mm, p.offset_x_mm, p.offset_y_mm, p.bridged_to),
        )
        for p in board.pads
    ]


@pytest.mark.parametrize("column", ["BoardID", "FigureID", "ArrayID"])
def test_rows_of_one_board_of_a_panel_are_that_boards(
    panel: BoardTruth, tmp_path: Path, column: str
) -> None:
    path = machine_csv(tmp_path / "m.csv", [("2", "3"), ("2", "1")], column)
    n = len(panel.pads) // 2
    assert [pad.pad for pad in read_spi_csv(path, panel)] == [n + 3, n + 1]
    assert [pad.pad for pad in read_spi_csv(path)] == [3, 1]


def test_a_board_measured_alone_may_have_any_number(board: BoardTruth, tmp_path: Path) -> None:
    path = machine_csv(tmp_path / "m.csv", [("A7", "2"), ("A7", "1")])
    assert [pad.pad for pad in read_spi_csv(path, board)] == [2, 1]


@pytest.mark.parametrize(
    ("columns", "keys", "message"),
    [
        ("Board", [("1", "4"), ("2", "4"), ("1", "4")], "lines 2 and 4 both have PadID 4"),
        ("Type", [("pad", "4"), ("pad", "4")], "a column Board must tell them apart"),
        # 1 is no id of the second board, and the last is no number on it.
        ("Board", [("2", "1"), ("2", "ID")], "PadID 1 of board '2' is neither"),
        ("Board", [("3", "1")], "PadID 1 of board '3' is neither"),
        ("PanelID", [("A", "1"), ("B", "2")], "rows of several panels"),
    ],
)
def test_rows_that_may_be_of_more_than_one_pad_are_refused(
    panel: BoardTruth, tmp_path: Path, columns: str, keys: list[tuple[str, str]], message: str
) -> None:
    last = str(len(panel.pads))
    path = machine_csv(tmp_path / "m.csv", [(b, p.replace("ID", last)) for b, p in keys], columns)
    with pytest.raises(FileError, match=message):
        read_spi_csv(path, panel)


def test_several_boards_are_not_one(board: BoardTruth, tmp_path: Path) -> None:
    path = machine_csv(tmp_path / "m.csv", [("1", "1"), ("2", "1")])
    with pytest.raises(FileError, match="several boards and the truth has one"):
        read_spi_csv(path, board)


def test_pad_of_another_board_is_refused(board: BoardTruth, tmp_path: Path) -> None:
    pad = replace(measured(board)[0], pad=10_000)
    with pytest.raises(ScoreError, match="pad 10000 is not on this board"):
        write_spi_csv([pad], board, tmp_path / "measured.csv")
    assert not (tmp_path / "measured.csv").exists()
