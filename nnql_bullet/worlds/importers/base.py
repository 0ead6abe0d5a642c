"""What readers of other programs' maps and worlds share: how a file is to be read, and what was found in it."""

from dataclasses import dataclass, replace
from math import cos, sin
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose, Shape, as_rows
from nnql_bullet.types import Extent, NonNegative

LONGEST_SIDE = 1000.0
"""Longest side of an arena [m]."""
HEIGHT = 1.5
"""Height of obstacles of maps, which have none [m]."""


@options
class Reading:
    """How a file of another program is read where it leaves a choice."""

    unknown: Literal["solid", "free"] = "solid"
    """ROS maps: what cells are that nobody has seen."""
    grey: Literal["unknown", "thresholds"] = "unknown"
    """ROS maps: whether grey 205, which map savers write for unknown, is unknown whatever free_thresh says."""
    yaw: Literal["apply", "ignore"] = "apply"
    """ROS maps: whether the yaw of the origin turns the map in its frame; Nav2's costmaps ignore it."""
    cell: Annotated[float, Field(gt=0, le=100)] | None = None
    """Side of a cell [m]: of MovingAI maps (default 1), and of the grid for slanted polygons (default 0.05)."""
    units: Literal["metres", "degrees"] = "metres"
    """GeoJSON: what coordinates are; degrees of longitude and latitude are projected around their middle."""
    margin: NonNegative = 2.0
    """SDF and GeoJSON: free space around all obstacles, start and target where no walls surround them [m]."""
    height: Extent = HEIGHT
    """SDF: height up to which the vehicle may touch something [m]; what begins above it is left out."""


@dataclass(frozen=True)
class ForeignWorld:
    """What a file of another program says, in the coordinates of the arena."""

    format: str
    shapes: tuple[Shape, ...]
    width: float
    """[m]"""
    depth: float
    """[m]"""
    frame: Pose
    """The arena's lower left corner, in the frame of the file."""
    files: tuple[Path, ...]
    """Files that were read."""
    notes: tuple[str, ...] = ()
    """How the file was read where it leaves a choice."""
    skipped: tuple[str, ...] = ()
    """What is in the file and not in the world."""
    start: Pose | None = None
    """Where the format has a start: in the frame of the file."""
    target: tuple[float, float] | None = None
    """Where the format has a target: in the frame of the file [m]."""
    obstacle_height: float = HEIGHT
    """[m]"""


def counted(number: int, thing: str, things: str = "") -> str:
    """A number of things in words."""
    return f"{number} {thing if number == 1 else things or f'{thing}s'}"


def in_arena(
    shapes: list[Shape], keep: list[tuple[float, float]], margin: float, where: Path
) -> tuple[tuple[Shape, ...], float, float, Pose]:
    """Moves shapes of a file without an arena into the smallest one: inside their own walls, or with a margin around.

    Args:
        shapes: In the frame of the file.
        keep: Points that are in the arena too [m].
        margin: Free space around all of them where no walls surround them [m].
        where: Names the file in errors.

    Returns:
        Shapes in the arena, its width and depth [m], and its lower left corner in the frame of the file.

    Raises:
        UserError: If there is nothing, or the arena is too large.
    """
    if not shapes:
        raise UserError(f"{where}: there is no obstacle in it that can be read")
    rows = as_rows(shapes)
    half = bounds(rows)
    low, high = (rows[:, :2] - half).min(axis=0), (rows[:, :2] + half).max(axis=0)
    walls = _walls(rows, half, low, high)
    if walls:
        (left, bottom), (right, top) = walls[0], walls[1]
        shapes = [shape for number, shape in enumerate(shapes) if number not in walls[2]]
    if not walls or not all(left < x < right and bottom < y < top for x, y in keep):
        low = [min(value, *(point[axis] for point in keep)) if keep else value for axis, value in enumerate(low)]
        high = [max(value, *(point[axis] for point in keep)) if keep else value for axis, value in enumerate(high)]
        left, bottom, right, top = low[0] - margin, low[1] - margin, high[0] + margin, high[1] + margin
    width, depth = round(float(right - left), 6), round(float(top - bottom), 6)
    if max(width, depth) > LONGEST_SIDE:
        raise UserError(f"{where}: it is {width:g} m x {depth:g} m; arenas are up to {LONGEST_SIDE:g} m long")
    moved = tuple(replace(s, x=round(float(s.x - left), 6), y=round(float(s.y - bottom), 6)) for s in shapes)
    return moved, width, depth, Pose(round(float(left), 6), round(float(bottom), 6), 0.0)


def bounds(rows: Array) -> Array:
    """Half extents (n, 2) along x and y [m] of shapes, rows (n, 7) of `as_rows`."""
    across = abs(rows[:, 2:3] * rows[:, 4:6]) + abs(rows[:, 3:4] * rows[:, 5:3:-1])
    extents: Array = across + rows[:, 6:7]
    return extents


def _walls(
    rows: Array, half: Array, low: Array, high: Array
) -> tuple[tuple[float, float], tuple[float, float], set[int]] | None:
    """Finds four boxes that surround all else: corners of the space between them [m], and their indices."""
    upright = (rows[:, 6] == 0) & (abs(rows[:, 4] * rows[:, 5]) < 1e-9)
    first, last, near = rows[:, :2] - half, rows[:, :2] + half, 1e-6
    found, inner = [], [0.0] * 4
    for side in range(4):  # left, bottom, right, top
        axis, other = side % 2, 1 - side % 2
        edge = abs(first[:, axis] - low[axis]) < near if side < 2 else abs(last[:, axis] - high[axis]) < near
        candidates = [i for i in (upright & edge).nonzero()[0] if 2 * half[i, other] > (high - low)[other] * 0.5]
        if not candidates:
            return None
        found.append(max(candidates, key=lambda i: half[i, other]))
        inner[side] = float(last[found[-1], axis] if side < 2 else first[found[-1], axis])
    left, bottom, right, top = inner
    for side, i in enumerate(found):
        other, ends = 1 - side % 2, ((left, right), (bottom, top))[1 - side % 2]
        if len(set(found)) < 4 or first[i, other] > ends[0] + near or last[i, other] < ends[1] - near:
            return None
    return ((left, bottom), (right, top), set(found)) if left < right and bottom < top else None


def turned_corner(x: float, y: float, yaw: float, along: float, across: float) -> Pose:
    """The pose of a corner that lies (along, across) [m] from the origin of a turned grid."""
    moved = x + cos(yaw) * along - sin(yaw) * across, y + sin(yaw) * along + cos(yaw) * across
    return Pose(round(moved[0], 9) + 0.0, round(moved[1], 9) + 0.0, yaw)


def box_around(points: Array, yaw: float) -> OrientedBox:
    """The smallest box at a yaw around points (n, 2) [m]."""
    axes = np.array([[cos(yaw), sin(yaw)], [-sin(yaw), cos(yaw)]])
    turned = points @ axes.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    (x, y), (length, width) = (low + high) / 2 @ axes, (high - low) / 2
    return OrientedBox(float(x), float(y), float(length), float(width), yaw)
