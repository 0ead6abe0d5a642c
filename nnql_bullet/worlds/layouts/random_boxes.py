"""A random layout: boxes of random size, place and yaw that do not overlap and cover a share of the arena."""

from dataclasses import replace
from math import pi
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox
from nnql_bullet.types import Extent, NonNegative
from nnql_bullet.worlds.layouts.base import Arena, as_rounded, placed

MOST_COVER = 0.4
MOST_RANDOM = 5_000
"""Largest number of boxes."""
MOST_TRIES = 20_000
"""Largest number of candidates."""
FIRST_TRIES = 32
"""Number of candidates in the first batch."""


@options
class RandomBoxes:
    """Options of "obstacles randomly scattered in the environment" (IV); the paper does not state their sizes."""

    is_random: ClassVar[bool] = True
    kind: Literal["random_boxes"]
    cover: Annotated[float, Field(ge=0, le=MOST_COVER)]
    """Share of the arena's area under boxes."""
    min_side: Extent = 2.0
    """Length of a side [m]."""
    max_side: Extent = 8.0
    """[m]"""
    clear_radius: NonNegative = 4.0
    """Smallest distance of boxes from the start and the target [m]."""

    def __post_init__(self) -> None:
        """Refuses sides in the wrong order."""
        refuse_crossed_ranges(self, "side")

    def denser(self, share: float) -> "RandomBoxes":
        """Returns the layout with more cover; the first boxes stay where they are."""
        return replace(self, cover=self.cover + share * (MOST_COVER - self.cover))

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """Draws boxes one by one, and rejects those that overlap another, leave the arena, or are near start or target.

        Raises:
            UserError: If the arena has no room for this cover.
        """
        most = self.cover * arena.width * arena.depth / ((self.min_side + self.max_side) / 2) ** 2
        if most > MOST_RANDOM:
            raise UserError(f"layout: {most:.0f} boxes are more than {MOST_RANDOM}; raise 'min_side' and 'max_side'")
        mean_area = ((self.min_side + self.max_side) / 2) ** 2
        wanted = self.cover * arena.width * arena.depth - mean_area / 2
        size, keep_free = arena.limits
        candidates = self._draw(arena, rng, FIRST_TRIES)
        while True:
            rows = _rows(candidates)
            areas = 4.0 * rows[:, 2] * rows[:, 3]
            chosen, area = placed(rows, areas, wanted, size, keep_free, self.clear_radius, 0.0)
            if area >= wanted:
                return tuple(OrientedBox(*box) for box in candidates[chosen].tolist())
            more = min(len(candidates) // 2, MOST_TRIES - len(candidates))
            if more == 0:
                break
            candidates = np.concatenate([candidates, self._draw(arena, rng, more)])
        raise UserError(
            f"layout: no room for boxes over {self.cover:.0%} of the arena; lower 'cover', 'max_side' or 'clear_radius'"
        )

    def _draw(self, arena: Arena, rng: np.random.Generator, count: int) -> Array:
        """Draws candidates (count, 5): centre, half length, half width [m] and yaw [rad], rounded as by `rounded`."""
        low = (0.0, 0.0, self.min_side, self.min_side, -pi / 2)
        high = (arena.width, arena.depth, self.max_side, self.max_side, pi / 2)
        drawn = rng.uniform(low, high, (count, 5))
        drawn[:, 2:4] /= 2
        return np.column_stack([as_rounded(drawn[:, :4], 3), as_rounded(drawn[:, 4], 4)])


def _rows(candidates: Array) -> Array:
    """Candidates as the rows (n, 7) of `geometry.as_rows`."""
    yaw = candidates[:, 4]
    return np.column_stack([candidates[:, :4], np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
