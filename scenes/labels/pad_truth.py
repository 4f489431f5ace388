"""Truth per pad: volume, area, heights, offset, bridges and defects, from the deposits' own triangles, never an image.

Every figure is an exact integral over a surface that is linear on each triangle. Heights count from the pad's surface.
Paste of a bridge or a smear is counted separately from its deposits.
"""

from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import ValidationError

from scenes.board.defects import DefectClass
from scenes.board.deposits import Deposit, Print
from scenes.board.pad_layout import Area, DamageClass
from scenes.board.printing import printed
from scenes.scene import Scene
from scenes.support.atomic_file import replacing
from scenes.support.distribution import Range
from scenes.support.errors import FileError, SceneError
from scenes.support.frozen import Frozen
from scenes.support.validation_words import in_words

TRUTH_FORMAT = 1


class PadTruth(Frozen):
    """One pad as printed; positions in the world, mm."""

    pad: int
    """Id, as in per-pixel truth; the same in every region of a board, and unique in a panel."""
    name: str
    board: int = 1
    """Which of a panel's boards it is on."""
    number: int | None = None
    """Its id if that board were alone; None in older files."""
    x_mm: float
    """Centroid of the nominal aperture."""
    y_mm: float
    size_mm: Range
    """Width and height of the nominal aperture's bounds."""
    aperture_area_mm2: float
    aperture_mm: tuple[Range, ...]
    """Corners of the nominal aperture."""
    area_ratio: float
    transfer_efficiency: float
    """Expected by the area ratio."""
    nominal_volume_mm3: float
    """Aperture area x stencil thickness: what 100 % means on an inspection machine."""
    volume_mm3: float
    area_mm2: float
    """Of the footprint."""
    mean_height_mm: float
    """Volume over area; 0 where nothing was printed."""
    peak_height_mm: float
    offset_x_mm: float | None
    """Centre of volume against the aperture's centroid; None where nothing was printed."""
    offset_y_mm: float | None
    smear_volume_mm3: float
    """Of a smear's part beyond the deposit; not in `volume_mm3`."""
    bridged_to: tuple[int, ...]
    defects: tuple[DefectClass, ...]


class BridgeTruth(Frozen):
    """Paste that joins two deposits, or two deposits that touch (volume 0)."""

    pads: tuple[int, int]
    volume_mm3: float
    """Of the part between the deposits."""


class AreaTruth(Frozen):
    """Something flat on the board, world mm."""

    x_mm: float
    """Centroid."""
    y_mm: float
    area_mm2: float


class HoleTruth(AreaTruth):
    """A hole or slot."""

    size_mm: Range
    """Width and height of its bounds."""
    plated: bool
    tented: bool
    """Closed by solder mask, and so without the label `hole`."""


class FiducialTruth(AreaTruth):
    """A fiducial's bare copper."""

    diameter_mm: float
    """Of the circle of its area."""


class DamageTruth(AreaTruth):
    """What shows of a fault of the bare board, paste left out."""

    name: DamageClass
    pad: int
    """Near which it is; 0 for none."""


class BoardTruth(Frozen):
    """All pads of a scene's region."""

    format: int = TRUTH_FORMAT
    stencil_mm: float
    pad_surface_mm: float
    """World z that heights count from."""
    mask_surface_mm: float
    """World z of the mask over laminate."""
    copper_mm: float
    """The mask over copper is this much higher."""
    origin_mm: Range | None = None
    """Board coordinates of the world's origin; None in older files."""
    pads: tuple[PadTruth, ...]
    bridges: tuple[BridgeTruth, ...]
    cut: tuple[int, ...] = ()
    """Ids of pads that the region's edge cuts: not printed, to be ignored."""
    holes: tuple[HoleTruth, ...] = ()
    """Those in or partly in the region."""
    fiducials: tuple[FiducialTruth, ...] = ()
    """Those wholly in the region, where the artwork has them: the print's registration errors are relative to them."""
    mask_shift_mm: Range = (0.0, 0.0)
    """How far the mask's openings are off the copper."""
    damage: tuple[DamageTruth, ...] = ()
    """Scratches, residue, and copper that a shifted mask covers."""

    def write(self, path: str | Path) -> None:
        """Write as JSON, atomically."""
        with replacing(path) as staged:
            staged.write_text(self.model_dump_json(indent=1), "utf-8")

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read what `write` wrote; raises `FileError` on anything else."""
        try:
            truth = cls.model_validate_json(Path(path).read_text("utf-8"))
        except (OSError, UnicodeDecodeError, ValidationError) as error:
            raise FileError(f"'{path}' is not a board truth file: {in_words(error)}") from error
        if truth.format != TRUTH_FORMAT:
            raise FileError(
                f"'{path}' has format {truth.format}; this version reads {TRUTH_FORMAT}: write it again"
            )
        return truth


def board_truth(scene: Scene) -> BoardTruth:
    """What was printed on every pad of a scene's board.

    Parameters
    ----------
    scene
        A scene with a board.

    Returns
    -------
    BoardTruth
        Exact integrals over the deposits' triangles; mm, mm2 and mm3, heights from the pad's surface.

    Raises
    ------
    SceneError
        For a scene without a board.

    Examples
    --------
    >>> import scenes
    >>> truth = scenes.board_truth(scenes.load("spi"))
    >>> len(truth.pads)
    102
    """
    if scene.seen_board is None:
        raise SceneError(f"scene '{scene.name}' has no board: only boards have pads to label")
    return truth_of(printed(scene.seen_board))


def truth_of(print_: Print) -> BoardTruth:
    """The truth of a print."""
    origin_x, origin_y = print_.layout.centre_mm

    def place(area: Area) -> dict[str, Any]:
        middle = area.centroid
        return {"x_mm": middle.x - origin_x, "y_mm": middle.y - origin_y, "area_mm2": area.area}

    bridges = tuple(
        BridgeTruth(pads=bridge.pads, volume_mm3=bridge.volume_mm3) for bridge in print_.bridges
    )
    partners: dict[int, list[int]] = {}
    for bridge in bridges:
        a, b = bridge.pads
        partners.setdefault(a, []).append(b)
        partners.setdefault(b, []).append(a)
    pads = tuple(
        _pad(deposit, print_.stencil_mm, tuple(sorted(partners.get(deposit.pad.id, ()))))
        for deposit in print_.deposits
    )
    return BoardTruth(
        stencil_mm=print_.stencil_mm,
        pad_surface_mm=print_.stackup.pad_mm,
        mask_surface_mm=print_.stackup.mask_mm,
        copper_mm=print_.stackup.copper_mm,
        origin_mm=print_.layout.centre_mm,
        pads=pads,
        bridges=bridges,
        cut=tuple(pad.id for pad in print_.layout.cut),
        holes=tuple(
            HoleTruth(
                **place(hole.outline),
                size_mm=(
                    float(np.ptp(hole.outline.bounds[::2])),
                    float(np.ptp(hole.outline.bounds[1::2])),
                ),
                plated=hole.plated,
                tented=hole.tented,
            )
            for hole in print_.layout.holes
        ),
        fiducials=tuple(
            FiducialTruth(**place(copper), diameter_mm=2.0 * float(np.sqrt(copper.area / np.pi)))
            for copper in print_.layout.fiducials
        ),
        mask_shift_mm=print_.stackup.mask_shift_mm,
        damage=tuple(
            DamageTruth(**place(mark.outline), name=mark.name, pad=mark.pad)
            for mark in print_.layout.damage
        ),
    )


def _pad(deposit: Deposit, stencil_mm: float, partners: tuple[int, ...]) -> PadTruth:
    aperture, field = deposit.aperture, deposit.field
    centre = aperture.centroid
    x0, y0, x1, y1 = aperture.bounds
    sizes = ("volume_mm3", "area_mm2", "mean_height_mm", "peak_height_mm")
    measured: dict[str, Any] = dict.fromkeys(sizes, 0.0)
    measured |= {"offset_x_mm": None, "offset_y_mm": None}
    if field is not None:
        x, y = field.centroid_mm
        volume, area = field.volume_mm3, field.area_mm2
        measured = {
            "volume_mm3": volume,
            "area_mm2": area,
            "mean_height_mm": volume / area,
            "peak_height_mm": float(field.height_mm.max()),
            "offset_x_mm": x - centre.x,
            "offset_y_mm": y - centre.y,
        }
    bridged: tuple[DefectClass, ...] = ("bridge",) if partners else ()
    return PadTruth(
        pad=deposit.pad.id,
        name=deposit.pad.name,
        board=deposit.pad.board,
        number=deposit.pad.number or deposit.pad.id,
        x_mm=centre.x,
        y_mm=centre.y,
        size_mm=(x1 - x0, y1 - y0),
        aperture_area_mm2=aperture.area,
        aperture_mm=tuple((x, y) for x, y in aperture.exterior.coords[:-1]),
        area_ratio=deposit.area_ratio,
        transfer_efficiency=deposit.efficiency,
        nominal_volume_mm3=aperture.area * stencil_mm,
        smear_volume_mm3=deposit.tail_volume_mm3,
        bridged_to=partners,
        defects=(*deposit.defects.classes, *bridged),
        **measured,
    )
