"""A fixed layout: the world file lists all boxes and circles."""

from math import radians
from typing import ClassVar, Literal

import numpy as np

from nnql_bullet.config import options
from nnql_bullet.geometry import Circle, OrientedBox, Shape
from nnql_bullet.types import Positive
from nnql_bullet.worlds.layouts.base import Arena


@options
class Box:
    """A box: its centre and sides [m], and the yaw of its length [degrees]."""

    x: float
    y: float
    length: Positive
    width: Positive
    yaw_degrees: float = 0.0


@options
class Disc:
    """A circle: its centre and radius [m]."""

    x: float
    y: float
    radius: Positive


@options
class Boxes:
    """Options of a fixed layout."""

    is_random: ClassVar[bool] = False
    kind: Literal["boxes"]
    boxes: tuple[Box, ...] = ()
    circles: tuple[Disc, ...] = ()

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[Shape, ...]:
        """The boxes and circles of the world file."""
        del arena, rng
        boxes = [OrientedBox(b.x, b.y, b.length / 2, b.width / 2, radians(b.yaw_degrees)) for b in self.boxes]
        return *boxes, *(Circle(c.x, c.y, c.radius) for c in self.circles)
