"""A random layout of U-shaped traps: dead ends with the target behind their back wall."""

from math import atan2, cos, pi, sin
from typing import ClassVar, Literal

import numpy as np

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import COLUMNS, OrientedBox, Pose, as_rows, clearance, moved
from nnql_bullet.types import Extent, Few, NonNegative
from nnql_bullet.worlds.layouts.base import Arena, leaves_room, rounded

MOST_TRIES = 5_000


@options
class Traps:
    """Options of traps; a trap has a back wall and two side walls.

    The first trap stands across the straight line from start to target and opens towards the start; the others stand
    anywhere. The shipped vehicle can turn round in a trap of the default width. A policy without memory still returns
    to the trap: outside it sees free space, and the target is behind the trap.
    """

    is_random: ClassVar[bool] = True
    kind: Literal["traps"]
    count: Few
    """Number of traps."""
    min_width: Extent = 8.0
    """Distance between the side walls [m]."""
    max_width: Extent = 14.0
    """[m]"""
    min_depth: Extent = 8.0
    """Distance from the opening to the back wall [m]; from outside, the sensors see the back wall only in range."""
    max_depth: Extent = 15.0
    """[m]"""
    min_thickness: Extent = 0.5
    """Thickness of the walls [m]."""
    max_thickness: Extent = 1.5
    """[m]"""
    clear_radius: NonNegative = 4.0
    """Smallest distance of traps, including their inside, from the start and the target [m]."""

    def __post_init__(self) -> None:
        """Refuses ranges in the wrong order."""
        refuse_crossed_ranges(self, "width", "depth", "thickness")

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """Draws traps one by one, and rejects those that overlap another, leave the arena, or are near start or target.

        Raises:
            UserError: If the arena has no room for them.
        """
        size, keep_free = arena.limits
        outlines, boxes = np.empty((0, COLUMNS)), list[OrientedBox]()
        for _ in range(MOST_TRIES):
            outline, *walls = self._anywhere(arena, rng) if boxes else self._across(arena, rng)
            row = as_rows((outline,))
            if leaves_room(row[0], size, keep_free, self.clear_radius) and clearance(row[0], outlines) > 0:
                outlines = np.concatenate([outlines, row])
                boxes += walls
            if len(outlines) == self.count:
                return tuple(boxes)
        raise UserError(
            f"layout: no room for {self.count} traps; lower 'count', 'max_width', 'max_depth' or 'clear_radius'"
        )

    def _across(self, arena: Arena, rng: np.random.Generator) -> list[OrientedBox]:
        """Draws a trap; the straight line to the target crosses the middle halves of its opening and back wall."""
        (x, y), *_, (target_x, target_y) = arena.keep_free
        width, depth, thickness = self._sizes(rng)
        there, enters, ends = rng.uniform((0.0, -width / 4, -width / 4), (1.0, width / 4, width / 4)).tolist()
        yaw = atan2(target_y - y, target_x - x) - atan2(ends - enters, depth)
        x, y = x + there * (target_x - x), y + there * (target_y - y)
        left = (enters + ends) / 2  # offset of the line from the trap's centre
        return _trap(Pose(x + left * sin(yaw), y - left * cos(yaw), yaw), width, depth, thickness)

    def _anywhere(self, arena: Arena, rng: np.random.Generator) -> list[OrientedBox]:
        """Draws a trap at any place and yaw."""
        width, depth, thickness = self._sizes(rng)
        x, y, yaw = rng.uniform((0.0, 0.0, -pi), (arena.width, arena.depth, pi)).tolist()
        return _trap(Pose(x, y, yaw), width, depth, thickness)

    def _sizes(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Draws width, depth and thickness [m]."""
        low = self.min_width, self.min_depth, self.min_thickness
        high = self.max_width, self.max_depth, self.max_thickness
        width, depth, thickness = rng.uniform(low, high).tolist()
        return round(width, 2), round(depth, 2), round(thickness, 2)


def _trap(middle: Pose, width: float, depth: float, thickness: float) -> list[OrientedBox]:
    """Makes the outline of a trap, and its back, left and right walls.

    Args:
        middle: Centre of its inside; the yaw points from the opening to the back wall.
        width: Width of its inside [m].
        depth: Depth of its inside [m].
        thickness: Thickness of its walls [m].
    """
    half = thickness / 2
    outline = OrientedBox(half, 0.0, depth / 2 + half, width / 2 + thickness)
    back = OrientedBox(depth / 2 + half, 0.0, half, width / 2 + thickness)
    left, right = (OrientedBox(0.0, side * (width / 2 + half), depth / 2, half) for side in (1, -1))
    return [rounded(moved(box, middle)) for box in (outline, back, left, right)]
