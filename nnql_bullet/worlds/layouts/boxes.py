"""A fixed layout: the world file lists all boxes."""

from math import radians
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options
from nnql_bullet.geometry import OrientedBox
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
class Boxes:
    """Options of a fixed layout."""

    is_random: ClassVar[bool] = False
    kind: Literal["boxes"]
    boxes: Annotated[tuple[Box, ...], Field(max_length=MOST_BOXES)]

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """The boxes of the world file."""
        del arena, rng
        return tuple(OrientedBox(b.x, b.y, b.length / 2, b.width / 2, radians(b.yaw_degrees)) for b in self.boxes)
