"""A random layout: upright poles of random diameter, some distance apart."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Circle, as_rows, clearance
from nnql_bullet.types import Extent, NonNegative
from nnql_bullet.worlds.layouts.base import Arena, leaves_room

TRIES_PER_POLE = 100
"""Largest number of candidates for each pole."""


@options
class Poles:
    """Options of a field of poles: trees, posts, legs of racks and tables."""

    is_random: ClassVar[bool] = True
    kind: Literal["poles"]
    count: Annotated[int, Field(ge=0, le=2000)]
    """Number of poles."""
    min_diameter: Extent = 0.02
    """[m]"""
    max_diameter: Extent = 0.3
    """[m]"""
    spacing: NonNegative = 1.5
    """Smallest distance between poles [m]."""
    clear_radius: NonNegative = 3.0
    """Smallest distance of poles from the start and the target [m]."""

    def __post_init__(self) -> None:
        """Refuses diameters in the wrong order."""
        refuse_crossed_ranges(self, "diameter")

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[Circle, ...]:
        """Draws poles one by one, and rejects those that are too near another, the walls, the start or the target.

        Raises:
            UserError: If the arena has no room for them.
        """
        size, keep_free = arena.limits
        poles: list[Circle] = []
        rows = as_rows([])
        low, high = (0.0, 0.0, self.min_diameter), (arena.width, arena.depth, self.max_diameter)
        for x, y, diameter in rng.uniform(low, high, (TRIES_PER_POLE * self.count, 3)).tolist():
            if len(poles) == self.count:
                break
            pole = Circle(round(x, 3), round(y, 3), round(diameter / 2, 4))
            row = as_rows([pole])[0]
            if leaves_room(row, size, keep_free, self.clear_radius) and clearance(row, rows) >= self.spacing:
                poles.append(pole)
                rows = as_rows(poles)
        if len(poles) < self.count:
            raise UserError(f"layout: no room for {self.count} poles; lower 'count', 'spacing' or 'clear_radius'")
        return tuple(poles)
