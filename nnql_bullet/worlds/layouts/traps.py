"""U-shaped traps: dead ends with the target behind their back wall."""

from math import atan2, cos, pi, sin
from typing import Literal

import numpy as np

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, Pose, as_rows, clearance, moved
from nnql_bullet.types import Count, NonNegative, Positive
from nnql_bullet.worlds.layouts.base import Arena, leaves_room

MOST_TRIES = 5_000


@options
class Traps:
    """Options of traps, each of three boxes: a back wall and two side walls.

    The first stands across the straight way from start to target, its opening towards the start; the others stand
    anywhere. The shipped vehicle, which does not reverse and stops only in a shield, turns at 2 m/s on a circle of
    1.28 m radius; to turn round, corners and all, it takes 3.5 m of width. In 8 m it can do that wherever it came in,
    and drive out again. So what holds it there is not what it can do: once outside, it sees free space, and its target
    is behind the trap as before. A way out is for one that remembers.
    """

    kind: Literal["traps"]
    count: Count
    """The first included."""
    min_width: Positive = 8.0
    """Between the side walls [m]."""
    max_width: Positive = 14.0
    """[m]"""
    min_depth: Positive = 8.0
    """From the opening to the back wall [m]. From 10 m on, the sensors see no back wall from the opening."""
    max_depth: Positive = 15.0
    """[m]"""
    min_thickness: Positive = 0.5
    """Of the walls [m]."""
    max_thickness: Positive = 1.5
    """[m]"""
    clear_radius: NonNegative = 4.0
    """No trap, its inside included, comes nearer than this to the start or the target [m]."""

    def __post_init__(self) -> None:
        """Refuses ranges in the wrong order."""
        refuse_crossed_ranges(self, "width", "depth", "thickness")

    @property
    def is_random(self) -> bool:
        """Every draw is another world."""
        return True

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """Draws traps one by one, each rejected where it overlaps another, leaves the arena, or crowds start or target.

        Numbers are rounded to a millimetre and 1e-4 rad, so that no machine's last bit matters.

        Raises:
            UserError: If no room is found for them.
        """
        size, keep_free = np.array([arena.width, arena.depth]), np.array(arena.keep_free)
        outlines, boxes = np.empty((0, 6)), list[OrientedBox]()
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
        """A trap that the straight way enters by the middle half of its opening, to end at that of its back wall."""
        (x, y), (target_x, target_y) = arena.keep_free
        width, depth, thickness = self._sizes(rng)
        there, enters, ends = rng.uniform((0.0, -width / 4, -width / 4), (1.0, width / 4, width / 4)).tolist()
        yaw = atan2(target_y - y, target_x - x) - atan2(ends - enters, depth)
        x, y = x + there * (target_x - x), y + there * (target_y - y)
        left = (enters + ends) / 2  # of the middle, half-way in
        return _trap(Pose(x + left * sin(yaw), y - left * cos(yaw), yaw), width, depth, thickness)

    def _anywhere(self, arena: Arena, rng: np.random.Generator) -> list[OrientedBox]:
        width, depth, thickness = self._sizes(rng)
        x, y, yaw = rng.uniform((0.0, 0.0, -pi), (arena.width, arena.depth, pi)).tolist()
        return _trap(Pose(x, y, yaw), width, depth, thickness)

    def _sizes(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Width, depth and thickness [m]."""
        low = self.min_width, self.min_depth, self.min_thickness
        high = self.max_width, self.max_depth, self.max_thickness
        width, depth, thickness = rng.uniform(low, high).tolist()
        return round(width, 2), round(depth, 2), round(thickness, 2)


def _trap(middle: Pose, width: float, depth: float, thickness: float) -> list[OrientedBox]:
    """All that a trap takes up, and its back, left and right walls.

    Args:
        middle: Of its inside; its yaw leads from the opening to the back wall.
        width: Of its inside [m].
        depth: Likewise [m].
        thickness: Of the walls [m].
    """
    half = thickness / 2
    outline = OrientedBox(half, 0.0, depth / 2 + half, width / 2 + thickness)
    back = OrientedBox(depth / 2 + half, 0.0, half, width / 2 + thickness)
    left, right = (OrientedBox(0.0, side * (width / 2 + half), depth / 2, half) for side in (1, -1))
    return [_rounded(moved(box, middle)) for box in (outline, back, left, right)]


def _rounded(box: OrientedBox) -> OrientedBox:
    return OrientedBox(
        round(box.x, 3), round(box.y, 3), round(box.half_length, 3), round(box.half_width, 3), round(box.yaw, 4)
    )
