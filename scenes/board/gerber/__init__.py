"""Gerber files as polygons: paste openings, painted areas and board outlines, in mm.

An interpreter of the Gerber Layer Format (Ucamco, revision 2024.05), with the deprecated commands that CAD tools still
write. What it does not know it refuses, so that no pad is lost without a message. Round shapes become polygons of equal
area.
"""

from scenes.board.gerber.drill_layers import drill_files, read_drills
from scenes.board.gerber.layer_names import ROLES, Role, Side, layer_files
from scenes.board.gerber.openings import read_area, read_fiducials, read_pads
from scenes.board.gerber.profile import read_outline

__all__ = [
    "ROLES",
    "Role",
    "Side",
    "drill_files",
    "layer_files",
    "read_area",
    "read_drills",
    "read_fiducials",
    "read_outline",
    "read_pads",
]
