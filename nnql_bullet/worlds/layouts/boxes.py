"""Explicit boxes: the world says where each one stands."""

from math import radians
from typing import Literal

import numpy as np

from nnql_bullet.config import options
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.types import Positive
from nnql_bullet.worlds.layouts.base import Arena


@options
class Box:
    """One box: centre and sides [m], yaw of its length in degrees."""

    x: float
    y: float
    length: Positive
    width: Positive
    yaw_degrees: float = 0.0


@options
class Boxes:
    """A fixed layout."""

    kind: Literal["boxes"]
    boxes: tuple[Box, ...]

    @property
    def is_random(self) -> bool:
        """A fixed layout has one world."""
        return False

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """The boxes as they are given."""
        del arena, rng
        return tuple(OrientedBox(b.x, b.y, b.length / 2, b.width / 2, radians(b.yaw_degrees)) for b in self.boxes)
