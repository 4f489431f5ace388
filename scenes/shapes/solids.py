"""The shapes scenes are built of, each as a triangle mesh in its own frame (mm, Z up, resting on z = 0).

Round shapes are tessellated, and the tessellation is the truth: rays are cast against the same triangles that are
rendered.
"""

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.shapes.grains import Grains
from scenes.shapes.mesh_files import read_mesh
from scenes.support.errors import MeshError
from scenes.support.frozen import Frozen

Size = tuple[PositiveFloat, PositiveFloat]
Segments = Annotated[int, Field(ge=8, le=4096)]
# Radii closer than this are the same.
SAME_MM = 1e-9


class Hole(Frozen):
    """An opening in a plate: a rectangle, or a disk where `radius_mm` is given."""

    centre_mm: tuple[float, float]
    size_mm: Size | None = None
    radius_mm: PositiveFloat | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.size_mm is None) == (self.radius_mm is None):
            raise ValueError("a hole needs either size_mm = [x, y] or radius_mm")
        return self

    def outline(self, segments: int) -> shapely.Polygon:
        """The opening as a polygon."""
        x, y = self.centre_mm
        if self.size_mm is not None:
            return _rectangle(x, y, self.size_mm)
        assert self.radius_mm is not None
        return shapely.Polygon(_circle(self.radius_mm, segments) + np.array([x, y]))


class Plate(Frozen):
    """A flat rectangle at z = 0 facing up, with holes; centred on the origin."""

    kind: Literal["plate"] = "plate"
    size_mm: Size
    holes: tuple[Hole, ...] = ()
    segments: Segments = 128
    """Corners of a round hole; give a disk that fills it the same number."""

    def mesh(self) -> trimesh.Trimesh:
        """The plate as triangles."""
        area = _rectangle(0.0, 0.0, self.size_mm)
        for hole in self.holes:
            area = area.difference(hole.outline(self.segments))
        if area.is_empty:
            raise MeshError(
                f"plate {self.size_mm} mm: its holes leave nothing of it; make them smaller"
            )
        return _flat(area)


class Disk(Frozen):
    """A flat disk at z = 0 facing up."""

    kind: Literal["disk"] = "disk"
    radius_mm: PositiveFloat
    segments: Segments = 128

    def mesh(self) -> trimesh.Trimesh:
        """The disk as triangles."""
        return _flat(shapely.Polygon(_circle(self.radius_mm, self.segments)))


class Box(Frozen):
    """A block on z = 0: a step."""

    kind: Literal["box"] = "box"
    size_mm: tuple[PositiveFloat, PositiveFloat, PositiveFloat]

    def mesh(self) -> trimesh.Trimesh:
        """The block as triangles, without a bottom: it rests on something."""
        box = trimesh.creation.box(extents=self.size_mm)
        box.apply_translation([0.0, 0.0, self.size_mm[2] / 2])
        box.update_faces(box.face_normals[:, 2] > -0.5)
        box.remove_unreferenced_vertices()
        return box


class Cap(Frozen):
    """A cap over z = 0, parabolic ``h (1 - r^2/R^2)`` or spherical; `between_mm` keeps a ring of it.

    A ring shares its tessellation with the whole cap's, so that rings of different material meet without a seam.
    """

    kind: Literal["cap"] = "cap"
    radius_mm: PositiveFloat
    """Radius of the rim at z = 0."""
    height_mm: PositiveFloat
    profile: Literal["parabolic", "spherical"] = "parabolic"
    between_mm: tuple[NonNegativeFloat, PositiveFloat] | None = None
    """Keep only radii from, to."""
    rings: Annotated[int, Field(ge=4, le=4096)] = 128
    """Steps of equal radius from the apex to the rim."""
    segments: Segments = 256

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.between_mm and not self.between_mm[0] < self.between_mm[1] <= self.radius_mm:
            raise ValueError(
                f"between_mm {list(self.between_mm)}: needs 0 <= from < to <= radius_mm = {self.radius_mm}"
            )
        if self.profile == "spherical" and self.height_mm > self.radius_mm:
            raise ValueError(
                f"a spherical cap higher ({self.height_mm} mm) than its rim's radius ({self.radius_mm} mm) overhangs: "
                "lower it or use profile = 'parabolic'"
            )
        return self

    def height_at(self, radius_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height of the ideal surface.

        Parameters
        ----------
        radius_mm
            Distances from the axis (...), mm.

        Returns
        -------
        ndarray of float64, (...)
            Heights, mm.
        """
        if self.profile == "parabolic":
            return self.height_mm * (1.0 - (radius_mm / self.radius_mm) ** 2)
        sphere = (self.radius_mm**2 + self.height_mm**2) / (2.0 * self.height_mm)
        inside = np.maximum(sphere**2 - radius_mm**2, 0.0)
        return np.sqrt(inside) - (sphere - self.height_mm)

    def mesh(self) -> trimesh.Trimesh:
        """The cap, or its ring, as triangles; vertices are on the ideal surface."""
        inner, outer = self.between_mm or (0.0, self.radius_mm)
        radii = np.linspace(0.0, self.radius_mm, self.rings + 1)
        radii = np.concatenate([[inner], radii[(radii > inner) & (radii < outer)], [outer]])
        # A ring's own radii may equal the cap's, except for rounding.
        radii = radii[np.diff(radii, prepend=-np.inf) > SAME_MM]
        points = radii[:, None, None] * _circle(1.0, self.segments)
        heights = np.broadcast_to(self.height_at(radii)[:, None], points.shape[:2])
        vertices = np.concatenate([points, heights[..., None]], axis=-1).reshape(-1, 3)
        number = np.arange(len(vertices)).reshape(points.shape[:2])
        apex = inner < SAME_MM
        if apex:
            # The innermost circle is one vertex.
            vertices = np.delete(vertices, np.s_[1 : self.segments], axis=0)
            number = np.maximum(number - (self.segments - 1), 0)
        a, c = number[:-1], number[1:]
        b, d = np.roll(a, -1, axis=1), np.roll(c, -1, axis=1)
        towards, back = np.stack([a, c, d], axis=-1), np.stack([a, d, b], axis=-1)[int(apex) :]
        faces = np.concatenate([towards.reshape(-1, 3), back.reshape(-1, 3)])
        return trimesh.Trimesh(vertices, faces, process=False)


class Tiles(Frozen):
    """The cells of a flat chart at z = 0 that have one mark, facing up: a checkerboard's black squares, say.

    Two objects with the same `chart` and different marks make a printed board; their edges meet exactly.
    """

    kind: Literal["tiles"] = "tiles"
    chart: Annotated[tuple[str, ...], Field(min_length=1)]
    """Rows of cells, one character a cell; the first row is the farthest in y, and the chart is centred on the origin."""
    mark: Annotated[str, Field(min_length=1, max_length=1)]
    """The character of the cells to keep."""
    cell_mm: PositiveFloat

    @model_validator(mode="after")
    def _rectangular(self) -> Self:
        if len({len(row) for row in self.chart}) != 1 or not self.chart[0]:
            raise ValueError("chart: all rows need the same number of cells, 1 or more")
        if not any(self.mark in row for row in self.chart):
            raise ValueError(f"chart: no cell has the mark '{self.mark}'")
        return self

    def mesh(self) -> trimesh.Trimesh:
        """The cells as two triangles each, over the vertices of the whole chart."""
        cells = np.array([list(row) for row in self.chart]) == self.mark
        rows, columns = cells.shape
        y, x = np.mgrid[rows / 2 : -rows / 2 - 0.5 : -1, -columns / 2 : columns / 2 + 0.5]
        vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3) * self.cell_mm
        row, column = np.nonzero(cells)
        a = row * (columns + 1) + column
        b, c, d = a + 1, a + columns + 1, a + columns + 2
        faces = np.concatenate([np.stack([a, c, d], axis=-1), np.stack([a, d, b], axis=-1)])
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        mesh.remove_unreferenced_vertices()
        return mesh


class MeshFile(Frozen):
    """A user's mesh: PLY, STL, OBJ, GLB or any other format that trimesh reads."""

    kind: Literal["file"] = "file"
    path: Path
    """Relative paths are resolved against the scene file's folder."""
    scale: PositiveFloat = 1.0
    """Millimetres per unit of the file: 1000 for metres."""

    def mesh(self) -> trimesh.Trimesh:
        """The file's triangles in mm."""
        mesh = read_mesh(self.path)
        # Not apply_scale, which computes normals: the file's content is not checked yet.
        with np.errstate(over="ignore"):
            return trimesh.Trimesh(mesh.vertices * self.scale, mesh.faces, process=False)


Shape = Annotated[Plate | Disk | Box | Cap | Tiles | Grains | MeshFile, Field(discriminator="kind")]


def _rectangle(x: float, y: float, size_mm: Size) -> shapely.Polygon:
    half_x, half_y = size_mm[0] / 2, size_mm[1] / 2
    return shapely.box(x - half_x, y - half_y, x + half_x, y + half_y)


def _circle(radius_mm: float, segments: int) -> NDArray[np.float64]:
    angle = np.arange(segments) * (2.0 * np.pi / segments)
    return radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _flat(area: shapely.Polygon | shapely.MultiPolygon) -> trimesh.Trimesh:
    """A polygon, with its holes, as upward triangles at z = 0."""
    pieces = []
    for part in shapely.get_parts(area):
        corners, faces = trimesh.creation.triangulate_polygon(part, engine="earcut")
        vertices = np.column_stack([corners, np.zeros(len(corners))])
        a, b, c = (vertices[faces[:, i], :2] for i in range(3))
        ab, ac = b - a, c - a
        downward = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0] < 0
        faces[downward] = faces[downward][:, ::-1]
        pieces.append(trimesh.Trimesh(vertices, faces, process=False))
    mesh: trimesh.Trimesh = trimesh.util.concatenate(pieces)
    return mesh
