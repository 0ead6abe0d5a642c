"""Warehouse aisles: racks in rows, aisles between them and cross aisles through them."""

from itertools import pairwise
from math import hypot
from typing import Literal

import numpy as np

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows, bearing, ray_distances, squared_distance
from nnql_bullet.types import NonNegative, Positive, UnitInterval
from nnql_bullet.worlds.layouts.base import Arena

Span = tuple[float, float]
"""From where to where [m]."""
MOST_TRIES = 200


@options
class Aisles:
    """Options of a hall full of racks.

    Rows of racks run from wall to wall along y; the aisles between them are crossed by cross aisles, which go through
    all rows at the same places, the last of them along the wall perhaps. Here and there a rack is missing, or what was
    put down closes an aisle from rack to rack. The shipped vehicle does not turn round in an aisle: that takes 3.1 m to
    one side of where it drives. But a rack is no longer than its sensors see, so it can tell a blocked aisle before it
    is in.
    """

    kind: Literal["aisles"]
    min_aisle: Positive = 3.0
    """Width of aisles and cross aisles [m]."""
    max_aisle: Positive = 4.0
    """[m]"""
    min_rack: Positive = 6.0
    """Length of a rack [m]; the last of a row is what is left."""
    max_rack: Positive = 9.0
    """[m]"""
    rack_depth: Positive = 2.4
    """Of two racks back to back [m]."""
    dock: NonNegative = 9.0
    """Width of the free strips at both ends of the rows' sequence, along x [m]."""
    gap_chance: UnitInterval = 0.1
    """That a rack is missing."""
    block_chance: UnitInterval = 0.15
    """That the stretch of an aisle along a rack, or the passage of a cross aisle through a row, is blocked."""
    block_length: Positive = 1.2
    """Of what blocks an aisle, along it [m]; that of a cross aisle is as deep as the racks."""
    clear_radius: NonNegative = 4.0
    """What would come nearer than this to the start or the target is left out [m]."""

    def __post_init__(self) -> None:
        """Refuses ranges in the wrong order."""
        refuse_crossed_ranges(self, "aisle", "rack")

    @property
    def is_random(self) -> bool:
        """Every draw is another world."""
        return True

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """Draws halls until racks stand across the straight way from start to target.

        Everything begins and ends at a whole centimetre, so that no machine's last bit matters.

        Raises:
            UserError: If that never happens.
        """
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
        """Where everything stands, along x and along y."""
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
        """Spans of a length between two bounds, with an aisle's width between each and the next; the last is cut."""
        spans = []
        while begin < end:
            after = min(round(begin + rng.uniform(*length), 2), end)
            spans.append((begin, after))
            begin = round(after + rng.uniform(self.min_aisle, self.max_aisle), 2)
        return spans

    def _block(self, rack: Span, rng: np.random.Generator) -> Span:
        """Of what blocks the aisle along a rack."""
        length = min(self.block_length, rack[1] - rack[0])
        begin = round(rng.uniform(rack[0], rack[1] - length), 2)
        return begin, begin + length

    def _leaves_free(self, row: Array, arena: Arena) -> bool:
        return all(squared_distance(*point, row) >= self.clear_radius**2 for point in arena.keep_free)


def _box(along_x: Span, along_y: Span) -> OrientedBox:
    """What stands between these bounds."""
    (left, right), (low, high) = along_x, along_y
    x, y, half_length, half_width = (left + right) / 2, (low + high) / 2, (right - left) / 2, (high - low) / 2
    return OrientedBox(round(x, 3), round(y, 3), round(half_length, 3), round(half_width, 3))


def _stands_across(rows: Array, arena: Arena) -> bool:
    """Whether any box, of rows (n, 6) of `as_rows`, stands across the straight way from start to target."""
    (x, y), (target_x, target_y) = arena.keep_free
    way = hypot(target_x - x, target_y - y)
    toward = bearing(Pose(x, y, 0.0), target_x, target_y)
    return bool(ray_distances((x, y), np.array([toward]), rows, way)[0] < way)
