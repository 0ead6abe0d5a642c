"""Rays and distances among many shapes: those that stand together are a block, and far blocks are left out at once.

Block k is the rows 16 k to 16 k + 15 of an array of shapes. What a kernel finds is that of all shapes, bit for bit.
"""

from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, Shape, clearance, meet_circle, reach_of, row_at, squared_distance
from nnql_bullet.jit import njit

SHAPES_PER_BLOCK = 16
MANY_SHAPES = 256
"""Number from which shapes are sorted by place; few are taken in their order."""
SLACK = 1e-6
"""By how much bounds are wider than the shapes [m], and the view of a shape than the shape [rad]; covers rounding."""


def by_place(shapes: tuple[Shape, ...]) -> tuple[Shape, ...]:
    """Sorts many shapes so that those of a block stand together: by strips along y, and in each along y."""
    if len(shapes) < MANY_SHAPES:
        return shapes
    strips = round(sqrt(len(shapes) / SHAPES_PER_BLOCK))
    from_left = sorted(shapes, key=lambda shape: shape.x)
    strip_of = {id(shape): strips * k // len(shapes) for k, shape in enumerate(from_left)}
    return tuple(sorted(from_left, key=lambda shape: (strip_of[id(shape)], shape.y)))


def bounds_of(rows: Array, moving: int = 0) -> Array:
    """Finds the bounds of each block: smallest x, y and largest x, y (k, 4) [m].

    Args:
        rows: Shapes (n, 7) as of `as_rows`.
        moving: Number of rows at the end that move; their blocks have no bounds.
    """
    across = np.abs(rows[:, 2] * rows[:, 4]) + np.abs(rows[:, 3] * rows[:, 5]) + rows[:, 6] + SLACK
    along = np.abs(rows[:, 2] * rows[:, 5]) + np.abs(rows[:, 3] * rows[:, 4]) + rows[:, 6] + SLACK
    half = np.stack([across, along], axis=1)
    half[len(rows) - moving :] = np.inf
    firsts = np.arange(0, len(rows), SHAPES_PER_BLOCK)
    if not len(firsts):
        return np.zeros((0, 4))
    smallest = np.minimum.reduceat(rows[:, :2] - half, firsts)
    return np.hstack([smallest, np.maximum.reduceat(rows[:, :2] + half, firsts)])


def blocks_within(x: float, y: float, reach: float, bounds: Array) -> NDArray[np.bool_]:
    """Whether blocks may reach into a circle [m], by their bounds (k, 4)."""
    across = np.maximum(np.maximum(bounds[:, 0] - x, x - bounds[:, 2]), 0.0)
    along = np.maximum(np.maximum(bounds[:, 1] - y, y - bounds[:, 3]), 0.0)
    return np.asarray(np.hypot(across, along) <= reach)


@njit()
def squared_distance_to_bounds(x: float, y: float, bounds: Array) -> float:
    """Computes the squared distance from a point [m] to the bounds (4,) of a block [m2]; 0 inside."""
    across, along = max(bounds[0] - x, 0.0, x - bounds[2]), max(bounds[1] - y, 0.0, y - bounds[3])
    return float(across * across + along * along)


@njit()
def clearance_among(x: float, y: float, yaw: float, footprint: Array, shapes: Array, bounds: Array) -> float:
    """Computes `geometry.clearance_at`, the block first that is surely near [m]; that of a wall reaches far.

    Args:
        x: [m]
        y: [m]
        yaw: [rad]
        footprint: Row (7,) of `as_rows`, in the vehicle's frame.
        shapes: Rows (n, 7) of `as_rows`.
        bounds: Their `bounds_of` (k, 4) [m].
    """
    row = row_at(x, y, yaw, footprint)
    reach = np.hypot(footprint[2], footprint[3]) + footprint[6]
    nearest, least = 0, np.inf
    for block in range(len(bounds)):
        across = max(row[0] - bounds[block, 0], bounds[block, 2] - row[0])
        along = max(row[1] - bounds[block, 1], bounds[block, 3] - row[1])
        squared = across * across + along * along  # to the farthest corner of the bounds
        if squared < least:
            nearest, least = block, squared
    closest = np.inf
    if len(bounds):
        closest = clearance(row, shapes[SHAPES_PER_BLOCK * nearest : SHAPES_PER_BLOCK * (nearest + 1)])
    for block in range(len(bounds)):
        if squared_distance_to_bounds(row[0], row[1], bounds[block]) < (closest + reach) ** 2 and block != nearest:
            some = shapes[SHAPES_PER_BLOCK * block : SHAPES_PER_BLOCK * (block + 1)]
            closest = clearance(row, some, closest)
    return float(closest)


@njit()
def cast_rays(
    x: float,
    y: float,
    yaw: float,
    directions: Array,
    shapes: Array,
    bounds: Array,
    sensor_range: float,
    distances: Array,
) -> None:
    """Computes the distances at which rays meet a shape: `geometry.ray_distances` as a kernel, shape by shape.

    Args:
        x: x of the rays' origin [m].
        y: y of the rays' origin [m].
        yaw: Yaw of the frame of the directions [rad].
        directions: Unit vectors (m, 2), evenly spaced all round, counter-clockwise.
        shapes: Rows (n, 7) of `geometry.as_rows`.
        bounds: Their `bounds_of` (k, 4) [m].
        sensor_range: Length of a ray that meets nothing [m].
        distances: Array to fill (m,) [m].
    """
    distances[:] = sensor_range
    c, s, squared_range = np.cos(yaw), np.sin(yaw), sensor_range * sensor_range
    first = np.arctan2(directions[0, 1], directions[0, 0])
    for block in range(len(bounds)):
        if squared_distance_to_bounds(x, y, bounds[block]) >= squared_range:
            continue
        for k in range(SHAPES_PER_BLOCK * block, min(SHAPES_PER_BLOCK * (block + 1), len(shapes))):
            shape = shapes[k]
            if squared_distance(x, y, shape) >= squared_range:
                continue
            dx, dy = shape[0] - x, shape[1] - y
            begin, end = _towards(c * dx + s * dy, c * dy - s * dx, reach_of(shape), first, len(directions))
            last = min(end, len(directions))
            _meet(shape, dx, dy, c, s, directions[begin:last], distances[begin:last])
            if end > last:
                _meet(shape, dx, dy, c, s, directions[: end - last], distances[: end - last])


@njit()
def _towards(ahead: float, left: float, reach: float, first: float, rays: int) -> tuple[int, int]:
    """Finds the rays that may meet a shape: from one, below `rays`, up to another before which they end.

    Numbers from `rays` on stand for the rays from 0 on again.

    Args:
        ahead: Position of the shape's centre from the rays' origin, in the frame of their directions [m].
        left: The same to the left [m].
        reach: Distance from the shape's centre to its farthest point [m].
        first: Angle of the first ray in that frame [rad].
        rays: Number of rays, evenly spaced all round.
    """
    distance = np.hypot(ahead, left)
    if distance <= reach:
        return 0, rays
    half, spacing = np.arcsin(reach / distance) + SLACK, 2 * pi / rays
    middle = (np.arctan2(left, ahead) - first) % (2 * pi)
    begin, count = int(np.ceil((middle - half) / spacing)), int(np.floor((middle + half) / spacing)) + 1
    return begin % rays, begin % rays + min(count - begin, rays)


@njit()
def _meet(shape: Array, dx: float, dy: float, c: float, s: float, directions: Array, distances: Array) -> None:
    """Shortens rays that meet a shape, a row (7,) of `as_rows`: boxes by the slab method.

    Args:
        shape: The shape.
        dx: x of its centre, from the rays' origin [m].
        dy: y of its centre, from the rays' origin [m].
        c: Cosine of the yaw of the directions' frame.
        s: Its sine.
        directions: Unit vectors (m, 2).
        distances: Array to shorten (m,) [m].
    """
    if shape[6] > 0.0:
        meet_circle(c * dx + s * dy, c * dy - s * dx, shape[6], directions, distances)
        return
    start_x, start_y = -(shape[4] * dx + shape[5] * dy), -(shape[4] * dy - shape[5] * dx)
    # Yaw of the directions' frame in the box's frame.
    cos_turn, sin_turn = shape[4] * c + shape[5] * s, shape[4] * s - shape[5] * c
    for i in range(len(directions)):
        ux, uy = directions[i, 0], directions[i, 1]
        enter_x, leave_x = _slab(start_x, cos_turn * ux - sin_turn * uy, shape[2])
        enter_y, leave_y = _slab(start_y, sin_turn * ux + cos_turn * uy, shape[3])
        enter = max(enter_x, enter_y, 0.0)
        if enter <= min(leave_x, leave_y) and enter < distances[i]:
            distances[i] = enter


@njit()
def _slab(start: float, direction: float, half: float) -> tuple[float, float]:
    """Computes the distances at which a ray enters and leaves the slab from -half to half; empty if it misses it."""
    if direction == 0.0:
        return (-np.inf, np.inf) if abs(start) <= half else (np.inf, -np.inf)
    first, second = (-half - start) / direction, (half - start) / direction
    return min(first, second), max(first, second)
