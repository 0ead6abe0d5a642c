"""A random layout of warehouse racks in rows, with aisles between the rows and cross aisles through them."""

from itertools import pairwise
from math import hypot
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows, bearing, ray_distances, squared_distance
from nnql_bullet.types import Extent, NonNegative, UnitInterval
from nnql_bullet.worlds.layouts.base import Arena

Span = tuple[float, float]
"""Lower and upper end [m]."""
Wide = Annotated[float, Field(ge=0.1, le=1000)]
MOST_TRIES = 200
MOST_RACKS = 10_000
"""Of a hall; each try draws all of them."""


@options
class Aisles:
    """Options of a hall of racks.

    Rows of racks run from wall to wall along y. Cross aisles go through all rows at the same places; the last may run
    along the wall. Some racks are missing, and some aisles are blocked. The shipped vehicle cannot turn round in an
    aisle while it drives. A rack is not longer than its sensors' range, so it can see a block before it enters.
    """

    is_random: ClassVar[bool] = True
    kind: Literal["aisles"]
    min_aisle: Wide = 3.0
    """Width of aisles and cross aisles [m]."""
    max_aisle: Wide = 4.0
    """[m]"""
    min_rack: Wide = 6.0
    """Length of a rack [m]; the last rack of a row is cut at the wall."""
    max_rack: Wide = 9.0
    """[m]"""
    rack_depth: Wide = 2.4
    """Depth of two racks back to back [m]."""
    dock: NonNegative = 9.0
    """Width of the free strips before the first and after the last row, along x [m]."""
    gap_chance: UnitInterval = 0.1
    """Probability that a rack is missing."""
    block_chance: UnitInterval = 0.15
    """Probability that an aisle along a rack, or a cross aisle through a row, is blocked."""
    block_length: Extent = 1.2
    """Length of a block along an aisle [m]; the block of a cross aisle is as deep as the racks."""
    clear_radius: NonNegative = 4.0
    """Smallest distance of racks and blocks from the start and the target; nearer ones are left out [m]."""

    def __post_init__(self) -> None:
        """Refuses ranges in the wrong order."""
        refuse_crossed_ranges(self, "aisle", "rack")

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """Draws halls until a rack stands across the straight line from start to target.

        Racks and blocks begin and end at whole centimetres, so that all machines draw the same hall.

        Raises:
            UserError: If there would be too many racks, or none stands across the line in any of `MOST_TRIES` halls.
        """
        most = arena.width / (self.rack_depth + self.min_aisle) * arena.depth / (self.min_rack + self.min_aisle)
        if most > MOST_RACKS:
            raise UserError(f"layout: {most:.0f} racks are more than {MOST_RACKS}; make them or the aisles wider")
        for _ in range(MOST_TRIES):
            boxes = tuple(_box(*spans) for spans in self._hall(arena, rng))
            rows = as_rows(boxes)
            free = [i for i, row in enumerate(rows) if self._leaves_free(row, arena)]
            if _stands_across(rows[free], arena):
                return tuple(boxes[i] for i in free)
        raise UserError(
            "layout: no rack stands between start and target; move them to opposite ends of the hall, or lower 'dock'"
        )

    def _hall(self, arena: Arena, rng: np.random.Generator) -> list[tuple[Span, Span]]:
        """Draws the racks and blocks: their spans along x and along y."""
        rows = self._spans(self.dock, arena.width - self.dock, (self.rack_depth, self.rack_depth), rng)
        rows = [row for row in rows if row[1] - row[0] > self.rack_depth - 0.01]  # the last may be cut
        racks = self._spans(0.0, arena.depth, (self.min_rack, self.max_rack), rng)
        aisles = [(before[1], after[0]) for before, after in pairwise(rows)]
        crossings = [(before[1], after[0]) for before, after in pairwise(racks)]
        if racks[-1][1] < arena.depth:
            crossings.append((racks[-1][1], arena.depth))
        standing = [(row, rack) for row in rows for rack in racks if rng.random() >= self.gap_chance]
        closed = [(row, crossing) for row in rows for crossing in crossings if rng.random() < self.block_chance]
        stretches = [(aisle, rack) for aisle in aisles for rack in racks if rng.random() < self.block_chance]
        return standing + closed + [(aisle, self._block(rack, rng)) for aisle, rack in stretches]

    def _spans(self, begin: float, end: float, length: Span, rng: np.random.Generator) -> list[Span]:
        """Draws spans from `begin` to `end`, an aisle apart; the last one is cut."""
        spans = []
        while begin < end:
            after = min(round(begin + rng.uniform(*length), 2), end)
            spans.append((begin, after))
            begin = round(after + rng.uniform(self.min_aisle, self.max_aisle), 2)
        return spans

    def _block(self, rack: Span, rng: np.random.Generator) -> Span:
        """Draws the span of a block in the aisle along a rack."""
        length = min(self.block_length, rack[1] - rack[0])
        begin = round(rng.uniform(rack[0], rack[1] - length), 2)
        return begin, begin + length

    def _leaves_free(self, row: Array, arena: Arena) -> bool:
        return all(squared_distance(*point, row) >= self.clear_radius**2 for point in arena.keep_free)


def _box(along_x: Span, along_y: Span) -> OrientedBox:
    """The box of two spans."""
    (left, right), (low, high) = along_x, along_y
    x, y, half_length, half_width = (left + right) / 2, (low + high) / 2, (right - left) / 2, (high - low) / 2
    return OrientedBox(round(x, 3), round(y, 3), round(half_length, 3), round(half_width, 3))


def _stands_across(rows: Array, arena: Arena) -> bool:
    """Whether a box of rows (n, 7) of `as_rows` stands across the straight line from start to target."""
    (x, y), *_, (target_x, target_y) = arena.keep_free
    length = hypot(target_x - x, target_y - y)
    toward = bearing(Pose(x, y, 0.0), target_x, target_y)
    return bool(ray_distances((x, y), np.array([toward]), rows, length)[0] < length)
