"""Pads as CSV in the columns that inspection machines export, written and read."""

import csv
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from evaluation.inspection.pad_limits import PadLimits, judge
from evaluation.inspection.pad_measurement import PadMeasure
from scenes.labels.pad_truth import BoardTruth, PadTruth
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError, ScoreError

MACHINE_COLUMNS = (
    *("PanelID", "Board", "ComponentID", "PadID", "PinNumber", "Type", "PosX(mm)", "PosY(mm)"),
    *("SizeX(mm)", "SizeY(mm)", "Volume(%)", "Volume(um3)", "Height(um)", "Area(%)", "Area(um2)"),
    *("OffsetX(mm)", "OffsetY(mm)", "OffsetX(%)", "OffsetY(%)", "Shape(um)", "Result", "Defect"),
)
# What machines do not export and a second judgement needs.
OWN_COLUMNS = ("BridgedTo", "Coverage(%)", "Reference(mm)", "Bare", "NumberOnBoard")
COLUMNS = (*MACHINE_COLUMNS, *OWN_COLUMNS)
# Needed to read a file; the others may be absent.
NEEDED = ("PadID", "Volume(um3)", "Area(um2)", "Height(um)", "OffsetX(mm)", "OffsetY(mm)")
# What machines call the number of a board in its panel.
BOARD_COLUMNS = ("Board", "BoardID", "FigureID", "ArrayID", "Array")


def write_spi_csv(
    pads: Sequence[PadMeasure] | Sequence[PadTruth],
    board: BoardTruth,
    path: str | Path,
    limits: PadLimits | None = None,
    panel: str = "",
    restart_pad_ids: bool = False,
) -> None:
    """Write pads, measured or true, one row each.

    Parameters
    ----------
    pads
        From `measure_pads`, or the truth's own.
    board
        The board, for positions and nominal figures.
    path
        The CSV file.
    limits
        What is accepted, for ``Result`` and ``Defect``; by default `PadLimits()`.
    panel
        Text of ``PanelID``.
    restart_pad_ids
        Whether ``PadID`` restarts on each board of a panel, as on some machines, whose key is ``Board`` and ``PadID``.

    Raises
    ------
    ScoreError
        For a pad that the board lacks.
    FileError
        For a file that cannot be written.

    Notes
    -----
    Percentages are of the aperture's area, of aperture area x stencil thickness, and of the aperture's size. ``Height``
    is volume over area, and ``Shape`` is the peak's height above it. A figure that was not measured is empty. ``PadID``,
    unless restarted, and ``BridgedTo`` are unique in a panel; a pad's number on its ``Board`` is ``NumberOnBoard``.
    """
    nominal = {pad.pad: pad for pad in board.pads}
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for pad in pads:
        if pad.pad not in nominal:
            raise ScoreError(f"pad {pad.pad} is not on this board: use the board's own truth")
        row = _row(pad, nominal[pad.pad], limits or PadLimits(), panel)
        writer.writerow(row | ({"PadID": row["NumberOnBoard"]} if restart_pad_ids else {}))
    with replacing(path) as staged:
        staged.write_text(text.getvalue(), "utf-8")


def read_spi_csv(path: str | Path, board: BoardTruth | None = None) -> tuple[PadMeasure, ...]:
    """Read pads from a machine's CSV file.

    Parameters
    ----------
    path
        A file of `write_spi_csv`, or one with at least its ``PadID``, ``Volume(um3)``, ``Area(um2)``, ``Height(um)``,
        ``OffsetX(mm)`` and ``OffsetY(mm)``.
    board
        The board or panel that was measured, for files whose ``PadID`` restarts on each board: the key is then ``PadID`` with
        ``Board`` (or ``BoardID``, ``FigureID``, ``ArrayID``, ``Array``).

    Returns
    -------
    tuple of PadMeasure
        mm, mm2 and mm3. Without ``Shape(um)`` the peak is taken as high as the mean.

    Raises
    ------
    FileError
        For a file that cannot be read, lacks a column, has a value that is not a number, or rows that may be of more
        than one pad.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(Path(path).read_text("utf-8-sig"))))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"'{path}' cannot be read as CSV: {error}") from error
    if not rows:
        raise FileError(f"'{path}' has no pads: give a CSV file with a header and a row per pad")
    lacking = [name for name in NEEDED if name not in rows[0]]
    if lacking:
        raise FileError(f"'{path}' lacks the columns {', '.join(lacking)}")
    pads = [_measure(row, f"'{path}', line {i}") for i, row in enumerate(rows, start=2)]
    boards = [next((row[k].strip() for k in BOARD_COLUMNS if row.get(k)), "") for row in rows]
    ids = _ids(list(zip(boards, (pad.pad for pad in pads), strict=True)), board)
    if len({row.get("PanelID") for row in rows}) > 1:
        ids = "it has rows of several panels; give one file for each PanelID"
    if isinstance(ids, str):
        raise FileError(f"'{path}' does not say which pads its rows are of: {ids}")
    return tuple(replace(pad, pad=number) for pad, number in zip(pads, ids, strict=True))


def _ids(keys: list[tuple[str, int]], truth: BoardTruth | None) -> list[int] | str:
    """Ids in the panel of rows with these boards and `PadID`, or what is missing to tell them."""
    first: dict[tuple[str, int], int] = {}
    for line, key in enumerate(keys, start=2):
        if first.setdefault(key, line) < line:
            return (
                f"lines {first[key]} and {line} both have PadID {key[1]}; where it restarts on each board of a panel, "
                "a column Board must tell them apart"
            )
    ids = [number for _, number in keys]
    if truth is None:
        again = len(set(ids)) < len(ids)
        return "PadID restarts on each board; give the panel's truth as well" if again else ids
    boards = {str(pad.board) for pad in truth.pads}
    if len(boards) == 1:  # However it is called.
        keys = [(board, number) for board in boards for number in ids]
    known = {(str(pad.board), pad.pad) for pad in truth.pads}
    restarted = {(str(pad.board), pad.number or pad.pad): pad.pad for pad in truth.pads}
    if not known.issuperset(keys) and restarted.keys() >= set(keys):
        ids = [restarted[key] for key in keys]
    elif not known.issuperset(keys):
        board, number = next(key for key in keys if key not in known)
        return (
            f"PadID {number} of board '{board}' is neither an id in the panel nor, in all rows, a number on its board; "
            "give the truth of the panel that was measured"
        )
    if len(set(ids)) < len(ids):
        return "it has several boards and the truth has one; give the panel's truth"
    return ids


def _row(
    pad: PadMeasure | PadTruth, nominal: PadTruth, limits: PadLimits, panel: str
) -> dict[str, str]:
    component, _, pin = nominal.name.rpartition("-")
    verdicts = judge(pad, nominal, limits)
    measured = pad.volume_mm3 is not None
    volume, area = pad.volume_mm3 or 0.0, pad.area_mm2 or 0.0
    mean, peak = pad.mean_height_mm or 0.0, pad.peak_height_mm or 0.0
    figures: dict[str, float | None] = {
        "PosX(mm)": nominal.x_mm,
        "PosY(mm)": nominal.y_mm,
        "SizeX(mm)": nominal.size_mm[0],
        "SizeY(mm)": nominal.size_mm[1],
        "Volume(%)": 100.0 * volume / nominal.nominal_volume_mm3 if measured else None,
        "Volume(um3)": 1e9 * volume if measured else None,
        "Height(um)": 1e3 * mean if measured else None,
        "Area(%)": 100.0 * area / nominal.aperture_area_mm2 if measured else None,
        "Area(um2)": 1e6 * area if measured else None,
        "OffsetX(mm)": pad.offset_x_mm,
        "OffsetY(mm)": pad.offset_y_mm,
        "OffsetX(%)": _share(pad.offset_x_mm, nominal.size_mm[0]),
        "OffsetY(%)": _share(pad.offset_y_mm, nominal.size_mm[1]),
        "Shape(um)": 1e3 * (peak - mean) if measured else None,
    }
    if isinstance(pad, PadMeasure):
        figures |= {"Coverage(%)": 100.0 * pad.coverage, "Reference(mm)": pad.reference_mm}
    passed = verdicts == ("pass",)
    words = {
        "PanelID": panel,
        "Board": str(nominal.board),
        "ComponentID": component,
        "PadID": str(pad.pad),
        "PinNumber": pin if component else "",
        "Type": "pad",
        "Result": "GOOD" if passed else "NG",
        "Defect": "" if passed else ";".join(verdicts),
        "BridgedTo": ";".join(map(str, pad.bridged_to)),
        "Bare": str(int(pad.bare)) if isinstance(pad, PadMeasure) else "",
        "NumberOnBoard": str(nominal.number or nominal.pad),
    }
    # Twelve digits: nothing that a limit could see is lost.
    return words | {k: "" if v is None else f"{v:.12g}" for k, v in figures.items()}


def _measure(row: dict[str, str], where: str) -> PadMeasure:
    def figure(name: str, scale: float = 1.0) -> float | None:
        text = (row.get(name) or "").strip()
        try:
            return float(text) * scale if text else None
        except ValueError:
            raise FileError(f"{where}: {name} is '{text[:40]}', which is not a number") from None

    try:
        number = int(row["PadID"])
        bridged = tuple(int(n) for n in (row.get("BridgedTo") or "").split(";") if n)
    except (TypeError, ValueError):
        raise FileError(f"{where}: PadID and BridgedTo must be whole numbers") from None
    mean, shape = figure("Height(um)", 1e-3), figure("Shape(um)", 1e-3)
    coverage = figure("Coverage(%)", 0.01)
    return PadMeasure(
        number,
        "-".join(filter(None, (row.get("ComponentID"), row.get("PinNumber")))) or f"P{number}",
        1.0 if coverage is None else coverage,
        figure("Reference(mm)"),
        figure("Volume(um3)", 1e-9),
        figure("Area(um2)", 1e-6),
        mean,
        None if mean is None else mean + (shape or 0.0),
        figure("OffsetX(mm)"),
        figure("OffsetY(mm)"),
        bridged,
        row.get("Bare") == "1",
    )


def _share(offset_mm: float | None, size_mm: float) -> float | None:
    return None if offset_mm is None else 100.0 * offset_mm / size_mm
