"""A map at the scale of the vehicle's body: what is free, what is occupied and where exactly, and what was never seen.

Cells are a third of the vehicle's width. Each occupied cell keeps the point where a ray ended in it last, so that what
is computed from the map is nearly as exact as the scan. `costs_to_go` gives the costs of the best ways to the target,
the unseen counted as free as in Koenig and Likhachev, "D* Lite" (AAAI 2002): a search from the target outwards in the
order of A* toward the vehicle (Hart, Nilsson and Raphael, 1968), with its queue in buckets (Dial, CACM 1969). Poses are
in the landmark's frame of `grid_map`.
"""

from math import floor

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit

Cells = NDArray[np.int8]
Offsets = NDArray[np.uint8]
Lengths = NDArray[np.float32]

CELLS_ACROSS = 3
"""Number of cells across the vehicle."""
SIDE = 192
"""Number of cells along a side of the map, with the vehicle in its middle; a trap fits into the map."""
UNSEEN, FREE, OCCUPIED = 0, -1, 2
"""Values of cells. A ray that passes the point of an occupied cell lowers its value by 1; at 0 it is free. A free cell
is less than `FREE` by the number of decisions that the vehicle took there."""
LEAST = -120
"""Least value of a cell."""
TRIED = 2.0
"""What each of these decisions adds to the cost factor of a way: where a vehicle tries in vain, another way becomes the
better one (as in learning real-time A*: Korf, "Real-time heuristic search", 1990)."""
PASSED = CELLS_ACROSS / 9
"""A ray that passes a point at less than that has shown that nothing is there [cells]."""
PASSED_THIN = PASSED / 4
"""The same of a point without points beside it: it may be a thin pole, which few rays meet [cells]."""
BEFORE_END = 1.0
"""Length before its end over which a ray shows nothing [cells]."""
REACH = 3.0
"""Distance from an obstacle from which on a way costs its length alone [cells]."""
BESIDE, TIGHT, BARRED = 2.0, 8.0, 300.0
"""Cost factors of a way beside obstacles, beyond 1, in a gap where the vehicle hardly fits, and in one where it does
not. The last is finite: a way leads through obstacles where there is no other."""
HARDLY = 2.2
"""Half a gap in which the vehicle hardly fits [cells]."""
SHIFT = 0.4
"""How far beside the centre of a cell a way through it may pass [cells]. A way along any line passes centres at most
half a cell from it; and one through a wall, of points a cell apart, a centre less than a cell from one of them."""
LOCAL = 9.0
"""Distance from the vehicle, along the sides of cells, within which ways are wanted [cells]."""
FARTHER = 9.0
"""How much longer than the vehicle's own they may be, that they are still told apart [cells]."""
_TIGHT = 0.1
"""How much narrower than the vehicle half a gap may look, for rounding [cells]."""
_BUCKETS, _PER_CELL = 16384, 8
_DIAGONAL = 2**0.5
_HALF, _HALF_DIAGONAL = np.float32(0.5), np.float32(_DIAGONAL / 2)


@njit(nogil=True)
def add_scans(
    cells: Cells,
    offsets: Offsets,
    corners: NDArray[np.int64],
    poses: Array,
    distances: Array,
    sensor: Array,
    angles: Array,
    sensor_range: float,
    cell: float,
) -> None:
    """Moves each map along with its vehicle, frees what rays pass and marks where they end.

    Args:
        cells: Maps (n, SIDE, SIDE); updated.
        offsets: Places of points in their cells, in 256ths (n, SIDE, SIDE, 2); updated.
        corners: First cells of the maps, counted from the landmark (n, 2); updated.
        poses: Poses of the vehicles (n, 3).
        distances: Ray distances (n, r) [m].
        sensor: Origin of the rays in the vehicle frame (2,) [m].
        angles: Angles of the rays in the vehicle frame (r,) [rad].
        sensor_range: Distance of a ray that meets nothing [m].
        cell: Side of a cell [m].
    """
    for i in range(len(cells)):
        x, y, yaw = poses[i] / np.array((cell, cell, 1.0))
        corner_x, corner_y = floor(x) - SIDE // 2, floor(y) - SIDE // 2
        _shift(cells[i], offsets[i], corner_x - corners[i, 0], corner_y - corners[i, 1])
        corners[i, 0], corners[i, 1] = corner_x, corner_y
        _mark(cells[i], x - corner_x, y - corner_y)
        c, s = np.cos(yaw), np.sin(yaw)
        x += (c * sensor[0] - s * sensor[1]) / cell - corner_x
        y += (s * sensor[0] + c * sensor[1]) / cell - corner_y
        for j in range(len(angles)):
            _pass(cells[i], offsets[i], x, y, yaw + angles[j], distances[i, j] / cell - BEFORE_END)
        for j in range(len(angles)):
            if distances[i, j] < sensor_range:
                way = distances[i, j] / cell
                hit_x, hit_y = x + np.cos(yaw + angles[j]) * way, y + np.sin(yaw + angles[j]) * way
                a, b = floor(hit_x), floor(hit_y)
                if 0 <= a < SIDE and 0 <= b < SIDE:
                    cells[i, a, b] = OCCUPIED
                    offsets[i, a, b, 0], offsets[i, a, b, 1] = int(256 * (hit_x - a)), int(256 * (hit_y - b))


@njit(nogil=True)
def _mark(cells: Cells, x: float, y: float) -> None:
    """Notes that the vehicle was at a place [cells], in the cells about it."""
    for a in range(int(x) - 1, int(x) + 2):
        for b in range(int(y) - 1, int(y) + 2):
            if cells[a, b] <= UNSEEN:
                cells[a, b] = max(min(cells[a, b], FREE) - 1, LEAST)


@njit(nogil=True)
def _pass(cells: Cells, offsets: Offsets, x: float, y: float, direction: float, length: float) -> None:
    """Frees the cells that a ray passes; an occupied one only where the ray would have met its point."""
    c, s = np.cos(direction), np.sin(direction)
    for k in range(int(length + 1.0)):
        a, b = floor(x + c * k), floor(y + s * k)
        if not (0 <= a < SIDE and 0 <= b < SIDE):
            break
        value = cells[a, b]
        if value == UNSEEN:
            cells[a, b] = FREE
        elif value > 0:
            dx, dy = a + offsets[a, b, 0] / 256 - x, b + offsets[a, b, 1] / 256 - y
            passed = PASSED_THIN if _is_alone(cells, a, b) else PASSED
            if abs(c * dy - s * dx) < passed and c * dx + s * dy < length:
                cells[a, b] = value - 1 if value > 1 else FREE


@njit(nogil=True)
def _is_alone(cells: Cells, a: int, b: int) -> bool:
    """Whether no cell beside an occupied one is occupied."""
    count = 0
    for beside_a in range(max(a - 1, 0), min(a + 2, SIDE)):
        for beside_b in range(max(b - 1, 0), min(b + 2, SIDE)):
            count += cells[beside_a, beside_b] > 0
    return count == 1


@njit(nogil=True)
def _shift(cells: Cells, offsets: Offsets, along: int, across: int) -> None:
    """Shifts a map (SIDE, SIDE) by some cells; new cells are unseen."""
    if along == 0 and across == 0:
        return
    before, places = cells.copy(), offsets.copy()
    cells[:] = UNSEEN
    first, last = max(0, -across), min(SIDE, SIDE - across)
    for a in range(max(0, -along), min(SIDE, SIDE - along)):
        cells[a, first:last] = before[a + along, first + across : last + across]
        offsets[a, first:last] = places[a + along, first + across : last + across]


@njit(nogil=True)
def cost_factors(cells: Cells, offsets: Offsets) -> Lengths:
    """Computes what a way through each cell costs, as a factor of its length (SIDE, SIDE).

    It rises toward obstacles, and is `BARRED` where the gap between the nearest point and those on the other side of
    the cell is narrower than the vehicle. So passages are as wide as they are, wherever the cells lie.
    """
    reach, half_width = int(REACH + 0.5), CELLS_ACROSS / 2
    room = np.full((SIDE, SIDE), np.float32(REACH**2))
    beside_x, beside_y = np.empty((SIDE, SIDE), np.float32), np.empty((SIDE, SIDE), np.float32)
    points = np.empty((SIDE * SIDE, 2))
    count = 0
    for a in range(SIDE):
        for b in range(SIDE):
            if cells[a, b] <= 0:
                continue
            x, y = a + offsets[a, b, 0] / 256, b + offsets[a, b, 1] / 256
            points[count] = x, y
            count += 1
            for to_a in range(max(a - reach, 0), min(a + reach + 1, SIDE)):
                for to_b in range(max(b - reach, 0), min(b + reach + 1, SIDE)):
                    dx, dy = x - to_a - 0.5, y - to_b - 0.5
                    squared = dx * dx + dy * dy
                    if squared < room[to_a, to_b]:
                        room[to_a, to_b] = squared
                        beside_x[to_a, to_b], beside_y[to_a, to_b] = dx, dy
    room = np.sqrt(room)
    half_gap = np.minimum(room + np.float32(SHIFT), np.float32(REACH))
    for k in range(count):
        x, y = points[k]
        a, b = int(x), int(y)
        for to_a in range(max(a - reach, 0), min(a + reach + 1, SIDE)):
            for to_b in range(max(b - reach, 0), min(b + reach + 1, SIDE)):
                if room[to_a, to_b] < HARDLY:
                    dx, dy = x - to_a - 0.5, y - to_b - 0.5
                    near_x, near_y = beside_x[to_a, to_b], beside_y[to_a, to_b]
                    if dx * near_x + dy * near_y < 0.0:
                        gap = 0.5 * np.sqrt((dx - near_x) ** 2 + (dy - near_y) ** 2)
                        half_gap[to_a, to_b] = min(half_gap[to_a, to_b], gap)
    factors = np.ones((SIDE, SIDE), np.float32)
    for a in range(SIDE):
        for b in range(SIDE):
            if half_gap[a, b] < half_width - _TIGHT:
                factors[a, b] = BARRED
            elif half_gap[a, b] < HARDLY:
                factors[a, b] = TIGHT
            elif room[a, b] < REACH:
                factors[a, b] = 1.0 + BESIDE * (1.0 - room[a, b] / REACH)
            if cells[a, b] < FREE:
                factors[a, b] += TRIED * (FREE - cells[a, b])
    return factors


@njit(nogil=True)
def costs_to_go(factors: Lengths, corner: NDArray[np.int64], place: Array, target: Array, cell: float) -> Lengths:
    """Computes what the ways from the cells about a vehicle to the target cost, at least (SIDE, SIDE) [cells].

    A way leads from cell to neighbouring cell, and straight on from the map's edge. Infinite where it is of no account:
    far from the vehicle, or `FARTHER` from the target than the vehicle.

    Args:
        factors: See `cost_factors` (SIDE, SIDE).
        corner: The map's first cell, counted from the landmark (2,).
        place: Of the vehicle, in the landmark's frame (2,) [m].
        target: Place of the target likewise (2,) [m].
        cell: Side of a cell [m].
    """
    left = np.full((SIDE, SIDE), np.float32(np.inf))
    most = 8 * SIDE * SIDE
    first, after = np.full(_BUCKETS, -1, np.int32), np.empty(most, np.int32)
    where, cost = np.empty(most, np.int32), np.empty(most, np.float32)
    count = 0
    at_a, at_b = place[0] / cell - corner[0] - 0.5, place[1] / cell - corner[1] - 0.5
    goal_a, goal_b = target[0] / cell - corner[0] - 0.5, target[1] / cell - corner[1] - 0.5
    here = (int(np.rint(at_a)), int(np.rint(at_b)))
    begin = _BUCKETS - 1
    for a in range(SIDE):
        inner = 0 < a < SIDE - 1
        near = abs(a - goal_a) <= 0.5
        for b in range(0, SIDE, SIDE - 1 if inner and not near else 1):
            if inner and 0 < b < SIDE - 1 and abs(b - goal_b) > 0.5:
                continue
            away = float(np.float32(np.hypot(a - goal_a, b - goal_b)))
            left[a, b] = away
            bucket = _bucket(away, a - at_a, b - at_b)
            begin = min(begin, bucket)
            where[count], cost[count], after[count] = a * SIDE + b, away, first[bucket]
            first[bucket] = count
            count += 1
    last = _BUCKETS
    k = begin
    while k < min(last, _BUCKETS):
        entry = first[k]
        if entry < 0:
            k += 1
            continue
        first[k] = after[entry]
        a, b = where[entry] // SIDE, where[entry] % SIDE
        so_far = cost[entry]
        if so_far > left[a, b]:
            continue
        if (a, b) == here:
            last = min(last, k + int(_PER_CELL * FARTHER))
        for to_a in range(max(a - 1, 1), min(a + 2, SIDE - 1)):
            for to_b in range(max(b - 1, 1), min(b + 2, SIDE - 1)):
                step = _HALF_DIAGONAL if to_a != a and to_b != b else _HALF
                there = so_far + step * (factors[a, b] + factors[to_a, to_b])
                if there < left[to_a, to_b] and count < most:
                    left[to_a, to_b] = there
                    bucket = max(_bucket(there, to_a - at_a, to_b - at_b), k)
                    where[count], cost[count], after[count] = to_a * SIDE + to_b, there, first[bucket]
                    first[bucket] = count
                    count += 1
    return left


@njit(nogil=True)
def ways_to(
    cells: Cells, offsets: Offsets, corners: NDArray[np.int64], poses: Array, targets: Array, cell: float
) -> tuple[Lengths, Lengths]:
    """Computes `cost_factors` and `costs_to_go` of n maps (n, SIDE, SIDE), for vehicles at poses (n, 3) [m, rad]."""
    factors, left = np.empty(cells.shape, np.float32), np.empty(cells.shape, np.float32)
    for i in range(len(cells)):
        factors[i] = cost_factors(cells[i], offsets[i])
        left[i] = costs_to_go(factors[i], corners[i], poses[i, :2], targets[i], cell)
    return factors, left


@njit(nogil=True)
def _bucket(so_far: float, da: float, db: float) -> int:
    """The place in the queue of a cell: by the cost so far, and the distance to what is near the vehicle [cells]."""
    da, db = max(abs(da) - LOCAL, 0.0), max(abs(db) - LOCAL, 0.0)
    rest = max(da, db) + (_DIAGONAL - 1) * min(da, db)
    return min(int(_PER_CELL * (so_far + rest)), _BUCKETS - 1)


@njit(nogil=True)
def open_until(factors: Lengths, corner: NDArray[np.int64], x: float, y: float, c: float, s: float, most: int) -> int:
    """How far the vehicle fits from a place on in a direction, in steps of a cell, up to `most`.

    Args:
        factors: See `cost_factors` (SIDE, SIDE).
        corner: The map's first cell (2,).
        x: In the landmark's frame [cells].
        y: Likewise [cells].
        c: Cosine of the direction.
        s: Its sine.
        most: Number of steps.
    """
    for k in range(1, most + 1):
        a, b = floor(x + c * k) - corner[0], floor(y + s * k) - corner[1]
        if not (0 <= a < SIDE and 0 <= b < SIDE) or factors[a, b] >= BARRED:
            return k - 1
    return most


@njit(nogil=True)
def cost_at(left: Lengths, corner: NDArray[np.int64], x: float, y: float, cell: float, most: float) -> float:
    """Interpolates the cost of the way to the target between cell centres [cells].

    Args:
        left: From `costs_to_go` (SIDE, SIDE).
        corner: The map's first cell (2,).
        x: In the landmark's frame [m]; the nearest place in the map counts for one outside.
        y: Likewise [m].
        cell: Side of a cell [m].
        most: Largest cost that counts [cells].
    """
    a = min(max(x / cell - corner[0] - 0.5, 0.0), SIDE - 1.000001)
    b = min(max(y / cell - corner[1] - 0.5, 0.0), SIDE - 1.000001)
    i, j = int(a), int(b)
    a, b = a - i, b - j
    low = (1 - b) * min(left[i, j], most) + b * min(left[i, j + 1], most)
    high = (1 - b) * min(left[i + 1, j], most) + b * min(left[i + 1, j + 1], most)
    return float((1 - a) * low + a * high)
