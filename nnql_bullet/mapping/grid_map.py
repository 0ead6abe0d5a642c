"""A coarse grid map of obstacles around a vehicle, and the shortest path to its target through that map.

A landmark, usually the target itself, gives with its distance and bearing, and the displacement between two decisions,
the pose in a frame whose origin it is and whose x axis points from the start to it. Heading errors do not accumulate.

Unseen cells count as free, as in Koenig and Likhachev, "D* Lite" (AAAI 2002). Every decision computes the remaining
path lengths again, by sweeps over the cells (Rosenfeld and Pfaltz, "Sequential Operations in Digital Picture
Processing", JACM 1966) until none changes.
"""

from math import floor, pi

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, wrap_angles
from nnql_bullet.jit import njit

Cells = NDArray[np.int8]

MAP_CELL = 0.75
"""Side of a cell [m]."""
SIZE = 56
"""Number of cells along a side of the map. The vehicle stays in its middle; a trap fits into the map."""
BEARINGS = 24
"""Number of directions in which the map is probed, from straight ahead counter-clockwise."""
REACHES = (2.5, 5.0)
"""Distances at which the map is probed [m]."""
SENSE = BEARINGS * len(REACHES)
"""Number of probed places."""
BARRED = 100.0
"""Value of a probed place behind an obstacle [m]; larger than any detour."""

PASSAGE = 1.3
"""Largest distance between the points of two rays for which no vehicle passes between them [m]."""
NEIGHBOURS = 3.0
"""The same distance for two neighbouring rays [m]; it is larger because their points on a wall may be far apart."""
SEEN = 3
"""Number of rays that must pass through an occupied cell before it counts as free again."""
COSTS = (40.0, 3.0, 1.5)
"""Cost factors of an occupied cell, of a cell beside one, and of the next cell. They are finite: a path leads through
obstacles where there is no other."""
_INSIDE = 0.15
"""Offset added to a ray hit so that it falls inside the obstacle's cell [m]."""
_BESIDE = 4
"""Number of following rays whose points are joined with a ray's point if they are near."""
_MOST_SWEEPS = 40
_DIAGONAL = 2**0.5
_ROUNDING = 1e-9


def tracked(poses: Array, steps: Array, distance: Array, bearing: Array) -> Array:
    """Computes poses (n, 3) in the landmark's frame after a decision.

    Args:
        poses: Poses before the decision (n, 3).
        steps: Displacements in the vehicle frame before the decision (n, 2) [m].
        distance: Present distance of the landmark (n,) [m].
        bearing: Present bearing of the landmark (n,) [rad].
    """
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + c * steps[:, 0] - s * steps[:, 1]
    y = poses[:, 1] + s * steps[:, 0] + c * steps[:, 1]
    return _from_landmark(np.arctan2(-y, -x), distance, bearing)


def first_poses(distance: Array, bearing: Array) -> Array:
    """Computes poses (n, 3) in the landmark's frame at the start, by its distance (n,) [m] and bearing (n,) [rad]."""
    return _from_landmark(np.zeros(len(distance)), distance, bearing)


def _from_landmark(toward: Array, distance: Array, bearing: Array) -> Array:
    """Computes poses (n, 3) from which the landmark is in the direction `toward` of its own frame (n,) [rad]."""
    x, y = -distance * np.cos(toward), -distance * np.sin(toward)
    return np.stack([x, y, wrap_angles(toward - bearing)], axis=-1)


def places_of(poses: Array, distance: Array, bearing: Array) -> Array:
    """Computes places (n, 2) [m] that are seen from poses (n, 3) at a distance (n,) [m] and bearing (n,) [rad]."""
    direction = poses[:, 2] + bearing
    return np.asarray(poses[:, :2] + (distance * np.stack([np.cos(direction), np.sin(direction)])).T)


@njit(nogil=True)
def add_scans(
    cells: Cells,
    corners: NDArray[np.int64],
    poses: Array,
    distances: Array,
    sensor: Array,
    angles: Array,
    sensor_range: float,
) -> None:
    """Moves each map along with its vehicle, frees the cells that rays pass through and marks those that they hit.

    Args:
        cells: Maps (n, SIZE, SIZE), above zero in occupied cells; updated.
        corners: First cells of the maps, counted from the landmark (n, 2); updated.
        poses: Poses of the vehicles (n, 3).
        distances: Ray distances (n, m) [m].
        sensor: Origin of the rays in the vehicle frame (2,) [m].
        angles: Angles of the rays in the vehicle frame (m,) [rad].
        sensor_range: Distance of a ray that meets nothing [m].
    """
    for i in range(len(cells)):
        x, y, yaw = poses[i]
        corner_x, corner_y = floor(x / MAP_CELL) - SIZE // 2, floor(y / MAP_CELL) - SIZE // 2
        _shift(cells[i], corner_x - corners[i, 0], corner_y - corners[i, 1])
        corners[i, 0], corners[i, 1] = corner_x, corner_y
        c, s = np.cos(yaw), np.sin(yaw)
        x, y = x + c * sensor[0] - s * sensor[1], y + s * sensor[0] + c * sensor[1]
        for j in range(len(angles)):
            c, s = np.cos(yaw + angles[j]), np.sin(yaw + angles[j])
            for k in range(int(distances[i, j] / MAP_CELL)):
                way = (k + 0.5) * MAP_CELL
                a, b = floor((x + c * way) / MAP_CELL) - corner_x, floor((y + s * way) / MAP_CELL) - corner_y
                if 0 <= a < SIZE and 0 <= b < SIZE and cells[i, a, b] > 0:
                    cells[i, a, b] -= 1
        for j in range(len(angles)):
            if distances[i, j] < sensor_range:
                here_x, here_y = _hit(x, y, yaw + angles[j], distances[i, j])
                for k in range(_BESIDE + 1):
                    other = (j + k) % len(angles)
                    there_x, there_y = _hit(x, y, yaw + angles[other], distances[i, other])
                    apart = np.hypot(there_x - here_x, there_y - here_y)
                    if distances[i, other] < sensor_range and apart < (NEIGHBOURS if k == 1 else PASSAGE):
                        _enter(cells[i], corners[i], here_x, here_y, there_x, there_y)


@njit(nogil=True)
def _hit(x: float, y: float, direction: float, distance: float) -> tuple[float, float]:
    """Computes the position that a ray hit [m]."""
    way = distance + _INSIDE
    return x + np.cos(direction) * way, y + np.sin(direction) * way


@njit(nogil=True)
def _enter(cells: Cells, corner: NDArray[np.int64], x: float, y: float, to_x: float, to_y: float) -> None:
    """Marks the cells from one position to another as occupied."""
    points = int(np.hypot(to_x - x, to_y - y) / (MAP_CELL / 2)) + 2
    for k in range(points):
        share = k / (points - 1)
        a = floor((x + share * (to_x - x)) / MAP_CELL) - corner[0]
        b = floor((y + share * (to_y - y)) / MAP_CELL) - corner[1]
        if 0 <= a < SIZE and 0 <= b < SIZE:
            cells[a, b] = SEEN


@njit(nogil=True)
def _shift(cells: Cells, along: int, across: int) -> None:
    """Shifts a map (SIZE, SIZE) by some cells; new cells are free."""
    if along == 0 and across == 0:
        return
    before = cells.copy()
    for a in range(SIZE):
        for b in range(SIZE):
            inside = 0 <= a + along < SIZE and 0 <= b + across < SIZE
            cells[a, b] = before[a + along, b + across] if inside else 0


@njit(nogil=True)
def path_lengths(cells: Cells, corner: NDArray[np.int64], target: Array) -> Array:
    """Computes the lengths of the shortest paths from each cell of a map to the target (SIZE, SIZE) [m].

    A path leads from cell to neighbouring cell, and straight on from the map's edge. `COSTS` weights the lengths; a
    diagonal step costs at least as much as the cheaper cell beside it, so that no path crosses a slanted wall.

    Args:
        cells: The map (SIZE, SIZE).
        corner: The map's first cell, counted from the landmark (2,).
        target: Its place in the landmark's frame (2,) [m].
    """
    barred = (cells > 0).astype(np.int8)
    beside = _widened(barred)
    walls = barred + beside + _widened(beside)
    metre = np.array((1.0, *COSTS[::-1]))
    cost, left = np.empty((SIZE, SIZE)), np.full((SIZE, SIZE), np.inf)
    for a in range(SIZE):
        for b in range(SIZE):
            cost[a, b] = MAP_CELL / 2 * metre[walls[a, b]]
            x, y = corner[0] + a + 0.5 - target[0] / MAP_CELL, corner[1] + b + 0.5 - target[1] / MAP_CELL
            if a in (0, SIZE - 1) or b in (0, SIZE - 1) or (abs(x) <= 0.5 and abs(y) <= 0.5):
                left[a, b] = MAP_CELL * np.hypot(x, y)
    # Whether the row before, and the row after, may shorten the paths of a row.
    by_before, by_after = np.ones(SIZE, np.bool_), np.ones(SIZE, np.bool_)
    for _ in range(_MOST_SWEEPS):
        changed = False
        for a in range(SIZE):
            if by_before[a]:
                by_before[a] = False
                if _sweep(left, cost, a, a - 1):
                    changed = by_before[min(a + 1, SIZE - 1)] = by_after[max(a - 1, 0)] = True
        for a in range(SIZE - 1, -1, -1):
            if by_after[a]:
                by_after[a] = False
                if _sweep(left, cost, a, a + 1):
                    changed = by_before[min(a + 1, SIZE - 1)] = by_after[max(a - 1, 0)] = True
        if not changed:
            break
    return left


@njit(nogil=True)
def _widened(marks: Cells) -> Cells:
    """Extends marks (SIZE, SIZE) of 0 and 1 to all cells that touch a marked cell."""
    along, wide = np.zeros(SIZE + 2, np.int8), np.empty((SIZE, SIZE), np.int8)
    for a in range(SIZE):
        row, before, after = marks[a], marks[max(a - 1, 0)], marks[min(a + 1, SIZE - 1)]
        for b in range(SIZE):
            along[b + 1] = row[b] | before[b] | after[b]
        for b in range(SIZE):
            wide[a, b] = along[b] | along[b + 1] | along[b + 2]
    return wide


@njit(nogil=True)
def _sweep(left: Array, cost: Array, a: int, beside: int) -> bool:
    """Shortens the paths of row `a` by those from the row beside it, then by those along the row in both directions.

    Args:
        left: Path lengths (SIZE, SIZE) [m]; changed in place.
        cost: Cost of half a cell (SIZE, SIZE) [m].
        a: Index of the row.
        beside: Index of the row beside it; outside the map for none.

    Returns:
        Whether any path became shorter by more than rounding.
    """
    here, cost_here = left[a], cost[a]
    best = here.copy()
    if 0 <= beside < SIZE:
        there, cost_there = left[beside], cost[beside]
        for b in range(1, SIZE - 1):
            straight = there[b] + cost_there[b] + cost_here[b]
            between = min(cost_there[b], cost_here[b - 1])
            one = there[b - 1] + _DIAGONAL * (max(cost_there[b - 1], between) + max(cost_here[b], between))
            between = min(cost_there[b], cost_here[b + 1])
            other = there[b + 1] + _DIAGONAL * (max(cost_there[b + 1], between) + max(cost_here[b], between))
            best[b] = min(best[b], straight, one, other)
    # Both directions at once, because neither depends on the other.
    upward, downward = best.copy(), best.copy()
    last_up, last_down = best[0], best[SIZE - 1]
    for b in range(1, SIZE):
        c = SIZE - 1 - b
        last_up = min(best[b], last_up + (cost_here[b - 1] + cost_here[b]))
        last_down = min(best[c], last_down + (cost_here[c + 1] + cost_here[c]))
        upward[b], downward[c] = last_up, last_down
    shorter = False
    for b in range(SIZE):
        best[b] = min(upward[b], downward[b])
        shorter |= best[b] < here[b] - _ROUNDING
        here[b] = best[b]
    return shorter


@njit(nogil=True)
def path_length_at(left: Array, corner: NDArray[np.int64], x: float, y: float) -> float:
    """Interpolates the length of the path to the target between cell centres [m].

    Args:
        left: Path lengths from `path_lengths` (SIZE, SIZE) [m].
        corner: The map's first cell (2,).
        x: x in the landmark's frame [m]; the nearest position in the map counts for one outside.
        y: y in the landmark's frame [m].
    """
    a = min(max(x / MAP_CELL - corner[0] - 0.5, 0.0), SIZE - 1.000001)
    b = min(max(y / MAP_CELL - corner[1] - 0.5, 0.0), SIZE - 1.000001)
    i, j = int(a), int(b)
    a, b = a - i, b - j
    low = (1 - b) * left[i, j] + b * left[i, j + 1]
    high = (1 - b) * left[i + 1, j] + b * left[i + 1, j + 1]
    here: float = (1 - a) * low + a * high
    return here


@njit(nogil=True)
def _free_distance(cells: Cells, corner: NDArray[np.int64], x: float, y: float, c: float, s: float) -> float:
    """Computes the distance from a position to the first occupied cell in a direction, up to the last reach [m].

    The cell of the position itself does not count.
    """
    first_a, first_b = floor(x / MAP_CELL) - corner[0], floor(y / MAP_CELL) - corner[1]
    way = 0.0
    while way < REACHES[-1]:
        way += MAP_CELL / 2
        a, b = floor((x + way * c) / MAP_CELL) - corner[0], floor((y + way * s) / MAP_CELL) - corner[1]
        if cells[a, b] > 0 and (a != first_a or b != first_b):
            return way
    return way


@njit(nogil=True)
def sensed(
    cells: Cells, corners: NDArray[np.int64], poses: Array, before: Array, targets: Array
) -> tuple[Array, Array, Array]:
    """Probes the maps around the vehicles.

    Args:
        cells: Maps (n, SIZE, SIZE).
        corners: First cells of the maps (n, 2).
        poses: Poses of the vehicles (n, 3).
        before: Earlier positions of the vehicles (n, 2) [m].
        targets: Places of the targets (n, 2) [m].

    Returns:
        Path length from the places at `REACHES` and `BEARINGS` less that from the vehicle, `BARRED` behind an obstacle
        (n, SENSE) [m]; path length from the vehicle (n,) [m]; and its decrease since `before` (n,) [m].
    """
    n = len(cells)
    around, ways, progress = np.empty((n, SENSE)), np.empty(n), np.empty(n)
    for i in range(n):
        left = path_lengths(cells[i], corners[i], targets[i])
        x, y, yaw = poses[i]
        ways[i] = path_length_at(left, corners[i], x, y)
        progress[i] = path_length_at(left, corners[i], before[i, 0], before[i, 1]) - ways[i]
        for j in range(BEARINGS):
            direction = yaw + j * 2 * pi / BEARINGS
            c, s = np.cos(direction), np.sin(direction)
            free = _free_distance(cells[i], corners[i], x, y, c, s)
            for k in range(len(REACHES)):
                there = path_length_at(left, corners[i], x + REACHES[k] * c, y + REACHES[k] * s)
                around[i, k * BEARINGS + j] = there - ways[i] if free >= REACHES[k] else BARRED
    return around, ways, progress
