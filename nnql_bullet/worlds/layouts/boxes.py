"""A fixed layout: the world file lists all boxes and circles."""

from collections.abc import Sequence
from math import degrees, radians
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options
from nnql_bullet.geometry import Circle, OrientedBox, Shape
from nnql_bullet.types import Extent, Number
from nnql_bullet.worlds.layouts.base import MOST_BOXES, Arena


@options
class Box:
    """A box: its centre and sides [m], and the yaw of its length [degrees]."""

    x: Number
    y: Number
    length: Extent
    width: Extent
    yaw_degrees: Number = 0.0


@options
class Disc:
    """A circle: its centre and radius [m]."""

    x: Number
    y: Number
    radius: Extent


@options
class Boxes:
    """Options of a fixed layout."""

    is_random: ClassVar[bool] = False
    kind: Literal["boxes"]
    boxes: Annotated[tuple[Box, ...], Field(max_length=MOST_BOXES)] = ()
    circles: Annotated[tuple[Disc, ...], Field(max_length=MOST_BOXES)] = ()

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[Shape, ...]:
        """The boxes and circles of the world file."""
        del arena, rng
        boxes = [OrientedBox(b.x, b.y, b.length / 2, b.width / 2, radians(b.yaw_degrees)) for b in self.boxes]
        return *boxes, *(Circle(c.x, c.y, c.radius) for c in self.circles)


def boxes_of(shapes: Sequence[Shape]) -> Boxes:
    """The fixed layout of shapes."""
    boxes, circles = [], []
    for its in shapes:
        if isinstance(its, OrientedBox):
            yaw = round(degrees(its.yaw), 9) + 0.0
            boxes.append(Box(x=its.x, y=its.y, length=2 * its.half_length, width=2 * its.half_width, yaw_degrees=yaw))
        else:
            circles.append(Disc(x=its.x, y=its.y, radius=its.radius))
    return Boxes(kind="boxes", boxes=tuple(boxes), circles=tuple(circles))
