"""A random layout: upright poles of random diameter, some distance apart."""

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import COLUMNS, Array, Circle
from nnql_bullet.types import Extent, NonNegative
from nnql_bullet.worlds.layouts.base import Arena, as_rounded, placed

MOST_POLES = 2000
TRIES_PER_POLE = 100
"""Largest number of candidates for each pole."""


@options
class Poles:
    """Options of a field of poles: trees, posts, legs of racks and tables."""

    is_random: ClassVar[bool] = True
    kind: Literal["poles"]
    count: Annotated[int, Field(ge=0, le=MOST_POLES)]
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

    def denser(self, share: float) -> "Poles":
        """Returns the layout with more poles; the first ones stay where they are."""
        return replace(self, count=round(self.count + share * (MOST_POLES - self.count)))

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[Circle, ...]:
        """Draws poles one by one, and rejects those that are too near another, the walls, the start or the target.

        Raises:
            UserError: If the arena has no room for them.
        """
        size, keep_free = arena.limits
        tried = self.count + self.count // 2
        candidates = self._draw(arena, rng, tried)
        while True:
            rows = np.zeros((len(candidates), COLUMNS))
            rows[:, [0, 1, 6]], rows[:, 4] = candidates, 1.0
            ones = np.ones(len(rows))
            chosen, count = placed(rows, ones, self.count, size, keep_free, self.clear_radius, self.spacing)
            if count >= self.count:
                return tuple(Circle(*pole) for pole in candidates[chosen].tolist())
            more = min(tried, TRIES_PER_POLE * self.count - tried)
            if more == 0:
                break
            candidates = np.concatenate([candidates[chosen], self._draw(arena, rng, more)])
            tried += more
        raise UserError(f"layout: no room for {self.count} poles; lower 'count', 'spacing' or 'clear_radius'")

    def _draw(self, arena: Arena, rng: np.random.Generator, count: int) -> Array:
        """Draws candidates (count, 3): centre and radius [m], rounded so that all machines draw the same."""
        low, high = (0.0, 0.0, self.min_diameter), (arena.width, arena.depth, self.max_diameter)
        drawn = rng.uniform(low, high, (count, 3))
        return np.column_stack([as_rounded(drawn[:, :2], 3), as_rounded(drawn[:, 2] / 2, 4)])
