"""What a Gerber file paints: apertures flashed and stroked, regions, blocks and repeats of them."""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import shapely

from scenes.board.gerber.apertures import Aperture, AperturePose, Painted, stroked
from scenes.board.gerber.strokes import Point, Segment, valid
from scenes.board.gerber.tokens import Malformed

# Step and repeat and blocks multiply objects; a panel of boards has some hundred thousand.
MAX_OBJECTS = 1_000_000


@dataclass(frozen=True)
class LayerImage:
    """What a file paints."""

    objects: tuple[Painted, ...]
    negative: bool
    """Everything is painted that the objects leave free (deprecated)."""


@dataclass
class _Frame:
    """Objects under construction: the image, a step-and-repeat block, or a block aperture."""

    objects: list[Painted] = field(default_factory=list)
    repeat: tuple[int, int, float, float] | None = None
    block: int | None = None


class Canvas:
    """Apertures, how they are posed, and the objects that were painted with them."""

    def __init__(self) -> None:
        self.dark = True
        self.pose = AperturePose()
        self.function = ""
        self.apertures: dict[int, Aperture] = {}
        self.selected: int | None = None
        self._posed: dict[tuple[int, AperturePose], Aperture] = {}
        self._frames = [_Frame()]

    def image(self, negative: bool, turn_deg: int, offset_mm: Point) -> LayerImage:
        """What was painted, turned or moved as a whole; `Malformed` if a block is still open."""
        self.close_repeat()
        if len(self._frames) > 1:
            raise Malformed("a block aperture is not closed by %AB*%")
        objects = tuple(self._frames[0].objects)
        if turn_deg or offset_mm != (0.0, 0.0):
            if turn_deg and offset_mm != (0.0, 0.0):
                raise Malformed("image rotation (IR) with an offset (OF) is not supported")
            matrix = AperturePose(degrees=float(turn_deg)).matrix
            objects = tuple(item.moved(matrix, offset_mm) for item in objects)
        return LayerImage(objects, negative)

    def attribute(self, text: str) -> None:
        """Take an X2 attribute: the function of apertures defined from now on."""
        if text.startswith("TA.AperFunction,"):
            self.function = text.split(",")[1].strip()
        elif text in ("TD", "TD.AperFunction"):
            self.function = ""

    def define(self, number: int, aperture: Aperture) -> None:
        """Give an aperture its number."""
        self.apertures[number] = replace(aperture, function=self.function)
        self._posed = {key: tool for key, tool in self._posed.items() if key[0] != number}

    def stroke(self, segment: Segment) -> None:
        """Paint along a line or an arc."""
        tool = self._tool()
        if tool.block is not None:
            raise Malformed("a stroke (D01) with a block aperture")
        points, reach = segment.points(), tool.reach
        (x0, y0), (x1, y1) = points.min(axis=0) - reach, points.max(axis=0) + reach
        bounds = (float(x0), float(y0), float(x1), float(y1))
        self._add(Painted(self.dark, bounds, stroked(segment, tool), None, lambda: [points]))

    def region(self, segments: list[list[Segment]]) -> None:
        """Paint the inside of contours."""
        contours = [np.concatenate([s.points() for s in c]) for c in segments if c]
        if not contours:
            return
        if any(len(np.unique(contour, axis=0)) < 3 for contour in contours):
            raise Malformed("a region's contour that cannot be: it has fewer than three points")
        every = np.concatenate(contours)
        (x0, y0), (x1, y1) = every.min(axis=0), every.max(axis=0)
        self._add(
            Painted(
                self.dark,
                (float(x0), float(y0), float(x1), float(y1)),
                lambda: shapely.union_all([valid(shapely.Polygon(c)) for c in contours]),
                None,
                lambda: contours,
            )
        )

    def flash(self, at: Point) -> None:
        """Paint the selected aperture at a place."""
        tool = self._tool()
        if tool.block is not None:
            matrix = self.pose.matrix
            for item in tool.block:
                self._add(item.moved(matrix, at, flip=not self.dark))
            return
        x0, y0, x1, y1 = (0.0,) * 4 if tool.shape.is_empty else tool.shape.bounds
        bounds = (x0 + at[0], y0 + at[1], x1 + at[0], y1 + at[1])
        place = np.asarray(at)
        shape = partial(shapely.transform, tool.shape, lambda xy: xy + place)
        self._add(Painted(self.dark, bounds, shape, at, function=tool.function))

    def open_block(self, number: int) -> None:
        """Collect what follows in an aperture of that number."""
        self._frames.append(_Frame(block=number))

    def close_block(self) -> None:
        """End the open block; `Malformed` if there is none."""
        frame = self._frames.pop() if self._frames[-1].block is not None else None
        if frame is None or frame.block is None:
            raise Malformed("%AB*% closes a block aperture that was not opened")
        self.apertures[frame.block] = Aperture(shapely.Polygon(), None, tuple(frame.objects))

    def open_repeat(self, columns: int, rows: int, step_mm: Point) -> None:
        """Collect what follows, to be painted in columns and rows."""
        self._frames.append(_Frame(repeat=(columns, rows, *step_mm)))

    def close_repeat(self) -> None:
        """Paint what was collected, if a repeat is open."""
        frame = self._frames[-1]
        if frame.repeat is None:
            return
        self._frames.pop()
        columns, rows, step_x, step_y = frame.repeat
        if columns * rows * len(frame.objects) > MAX_OBJECTS:
            raise Malformed(f"step and repeat makes more than {MAX_OBJECTS} objects")
        for column in range(columns):
            for row in range(rows):
                by = (column * step_x, row * step_y)
                for item in frame.objects:
                    self._add(item.moved(np.eye(2), by) if by != (0.0, 0.0) else item)

    def _tool(self) -> Aperture:
        """The selected aperture as mirrored, rotated and scaled."""
        if self.selected is None or self.selected not in self.apertures:
            raise Malformed("an aperture is used before it is defined and selected")
        plain = self.apertures[self.selected]
        if self.pose == AperturePose() or plain.block is not None:
            return plain
        key = (self.selected, self.pose)
        if key not in self._posed:
            matrix, radius = self.pose.matrix, plain.radius
            shape = shapely.transform(plain.shape, lambda xy: xy @ matrix.T)
            radius = None if radius is None else radius * self.pose.scale
            self._posed[key] = Aperture(shape, radius, function=plain.function)
        return self._posed[key]

    def _add(self, item: Painted) -> None:
        if len(self._frames[-1].objects) >= MAX_OBJECTS:
            raise Malformed(f"more than {MAX_OBJECTS} objects")
        self._frames[-1].objects.append(item)
