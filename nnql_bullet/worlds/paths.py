"""The shortest path of a disc through a world, and measures of the world's difficulty along it."""

from dataclasses import dataclass, replace
from heapq import heappop, heappush
from math import ceil, floor, inf, nan, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.blocks import bounds_of, cast_rays, clearance_among
from nnql_bullet.geometry import Array, Circle, Pose, as_rows, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.worlds.spec import WorldSpec

GRID_CELL = 0.1
"""Side of a cell of the grid [m]; larger in arenas of more than `MOST_CELLS` cells."""
MOST_CELLS = 4_000_000
SURVEY_SPACING = 2.0
"""Distance along the path between measurements of its surroundings [m]."""
VISIBILITY_RANGE = 100.0
"""Length of a ray that meets nothing [m]; in the paper's arena every ray meets a wall."""

Cell = tuple[int, int]
"""Row along y, column along x."""


@dataclass(frozen=True, slots=True)
class Difficulty:
    """Measures of a world's difficulty, which do not depend on a policy.

    The last three are means along the shortest path, after Perille, Truong, Xiao and Stone, Benchmarking Metric Ground
    Navigation (SSRR 2020); NaN without a path.
    """

    cover: float
    """Share of the arena's area under obstacles."""
    bottleneck: float
    """Width of the narrowest place of the widest path [m]."""
    shortest_path: float
    """Length of the vehicle's shortest path from the start to the edge of the target [m]; infinite without a path."""
    tortuosity: float
    """Length of the shortest path, and on to the target's centre, over the straight distance."""
    closest_obstacle: float
    """Distance to the closest obstacle or wall [m]."""
    visibility: float
    """Mean length of rays in all directions [m]."""


def difficulty(world: WorldSpec, vehicle_width: float) -> Difficulty:
    """Measures the difficulty of a world.

    Args:
        world: The world.
        vehicle_width: Diameter of the disc whose shortest path is measured, or that of the bottleneck if that is
            narrower [m].
    """
    path, length = shortest_path(world, min(vehicle_width, world.bottleneck.width) / 2)
    straight = sum(float(np.hypot(u - x, v - y)) for (x, y), (u, v) in world.legs)
    points = _along(path, SURVEY_SPACING) if len(path) else np.zeros((0, 2))
    closest, seen = _surroundings(points, world.solids, bounds_of(world.solids))
    return Difficulty(
        cover=world.cover,
        bottleneck=world.bottleneck.width,
        shortest_path=length - world.target_radius,
        tortuosity=length / straight,
        closest_obstacle=float(np.mean(closest)) if len(points) else nan,
        visibility=float(np.mean(seen)) if len(points) else nan,
    )


def _surroundings(points: Array, solids: Array, bounds: Array) -> tuple[Array, Array]:
    """Measures, at points (m, 2) [m], the distance to the closest solid and the mean length of rays (m,) [m]."""
    point = as_rows([Circle(0.0, 0.0, 0.0)])[0]  # a footprint without extent
    angles = np.arange(0.0, 2 * pi, pi / 36)
    directions, lengths = np.stack([np.cos(angles), np.sin(angles)], axis=1), np.empty(len(angles))
    closest, seen = np.empty(len(points)), np.empty(len(points))
    for i, (x, y) in enumerate(points.tolist()):
        closest[i] = clearance_among(x, y, 0.0, point, solids, bounds)
        cast_rays(x, y, 0.0, directions, solids, bounds, VISIBILITY_RANGE, lengths)
        seen[i] = np.mean(lengths)
    return closest, seen


def shortest_path(world: WorldSpec, radius: float) -> tuple[Array, float]:
    """Finds the shortest path of a disc from the start to the target, which is reached at its radius.

    A cell of a grid is free if its centre is at least `radius`, less half a cell's diagonal, away from everything; so
    where a disc of this radius passes, free cells are connected. Lazy Theta* (Nash, Koenig and Tovey, AAAI 2010), an A*
    whose paths may run at any angle, searches them: to the target's centre where all cells around it are free, else to
    the first cell within the target's radius. A path by way points is one from each to the next.

    Returns:
        Corners of the straight pieces of the path (k, 2) [m]; none if there is no path. The last is the target's
        centre, or else lies within its radius. The other value is the path's length to the target's edge and the
        target's radius [m]; infinite if there is no path.
    """
    if world.waypoints:
        return _by_waypoints(world, radius)
    side = max(GRID_CELL, sqrt(world.width * world.depth / MOST_CELLS))
    shape = ceil(world.depth / side), ceil(world.width / side)
    ends = (world.start.x, world.start.y), world.target
    begin, end = ((floor(y / side), floor(x / side)) for x, y in ends)
    if not all(0 <= row < shape[0] and 0 <= column < shape[1] for row, column in (begin, end)):
        return np.zeros((0, 2)), inf
    free = free_cells(shape, side, world.solids, max(radius - side / sqrt(2), 0.0))
    reach = 0.0 if _is_open(end, world.target_radius / side, free) else world.target_radius / side
    cells = _theta_star(begin, end, reach, free) if free[begin] else np.zeros((0, 2), np.int64)
    path = np.asarray((cells[:, ::-1] + 0.5) * side)
    if not len(path):
        return path, inf
    path[0] = ends[0]
    if reach == 0.0:
        path = np.array(ends) if len(path) == 1 else np.concatenate([path[:-1], [ends[1]]])
        return path, path_length(path)
    left = float(np.hypot(*(path[-1] - ends[1])))
    return path, max(path_length(path) + left, float(np.hypot(*np.subtract(*ends))))


def _by_waypoints(world: WorldSpec, radius: float) -> tuple[Array, float]:
    """Joins the shortest paths of the legs."""
    parts = [
        shortest_path(replace(world, start=Pose(*begin, 0.0), target=end, waypoints=()), radius)
        for begin, end in world.legs
    ]
    length = sum(its for _, its in parts)
    return (np.concatenate([path for path, _ in parts]) if length < inf else np.zeros((0, 2))), length


def path_length(path: Array) -> float:
    """Length of a path with corners (k, 2) [m]."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def _along(path: Array, every: float) -> Array:
    """Points (m, 2) on a path, `every` [m] apart."""
    ends = np.concatenate([[0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()])
    at = np.arange(0.0, ends[-1], every)
    return np.stack([np.interp(at, ends, path[:, axis]) for axis in (0, 1)], axis=1)


@njit(nogil=True)
def free_cells(shape: Cell, side: float, solids: Array, distance: float) -> NDArray[np.bool_]:
    """Marks the cells whose centres are farther than `distance` [m] from all solids, rows (n, 7) of `as_rows`."""
    free = np.ones(shape, np.bool_)
    for i in range(len(solids)):
        box = solids[i]
        across = abs(box[2] * box[4]) + abs(box[3] * box[5]) + box[6] + distance
        along = abs(box[2] * box[5]) + abs(box[3] * box[4]) + box[6] + distance
        rows = max(int((box[1] - along) / side), 0), min(int((box[1] + along) / side) + 1, shape[0])
        columns = max(int((box[0] - across) / side), 0), min(int((box[0] + across) / side) + 1, shape[1])
        for row in range(rows[0], rows[1]):
            for column in range(columns[0], columns[1]):
                x, y = (column + 0.5) * side, (row + 0.5) * side
                if squared_distance(x, y, box) <= distance * distance:
                    free[row, column] = False
    return free


@njit(nogil=True)
def _is_clear(begin: Cell, end: Cell, free: NDArray[np.bool_]) -> bool:
    """Whether the straight line between the centres of two cells crosses free cells only.

    It goes from cell to cell (Amanatides and Woo, Eurographics 1987), by a neighbour on one side through a corner.
    """
    rows, columns = abs(end[0] - begin[0]), abs(end[1] - begin[1])
    down, right = (1 if end[0] > begin[0] else -1), (1 if end[1] > begin[1] else -1)
    row, column = begin
    balance = columns - rows  # positive: the side of the cell is met before its top or bottom
    for _ in range(rows + columns):
        if not free[row, column]:
            return False
        if balance >= 0:
            column += right
            balance -= 2 * rows
        else:
            row += down
            balance += 2 * columns
    return bool(free[row, column])


@njit(nogil=True)
def _apart(one: Cell, other: Cell) -> float:
    """Distance between two cells, in cells."""
    return float(np.hypot(one[0] - other[0], one[1] - other[1]))


@njit(nogil=True)
def _is_open(middle: Cell, reach: float, free: NDArray[np.bool_]) -> bool:
    """Whether all cells no farther than `reach` cells from one are free."""
    far = int(reach) + 1
    for row in range(max(middle[0] - far, 0), min(middle[0] + far + 1, free.shape[0])):
        for column in range(max(middle[1] - far, 0), min(middle[1] + far + 1, free.shape[1])):
            if not free[row, column] and _apart((row, column), middle) <= reach:
                return False
    return True


@njit(nogil=True)
def _theta_star(begin: Cell, end: Cell, reach: float, free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Finds the cells (k, 2) at the corners of the path from `begin` to the first cell within `reach` cells of `end`.

    There is none if there is no path.
    """
    length = np.full(free.shape, np.inf)  # of the path from `begin`, in cells
    parents = np.zeros((free.shape[0], free.shape[1], 2), np.int64)
    closed = np.zeros(free.shape, np.bool_)
    length[begin] = 0.0
    parents[begin] = begin
    heap = [(max(_apart(begin, end) - reach, 0.0), begin)]
    while heap:
        _, cell = heappop(heap)
        if closed[cell]:
            continue
        parent = parents[cell][0], parents[cell][1]
        if not _is_clear(parent, cell, free):  # lazy: the line is checked only now
            length[cell] = np.inf
            for row in range(max(cell[0] - 1, 0), min(cell[0] + 2, free.shape[0])):
                for column in range(max(cell[1] - 1, 0), min(cell[1] + 2, free.shape[1])):
                    if closed[row, column]:
                        candidate = length[row, column] + _apart((row, column), cell)
                        if candidate < length[cell]:
                            length[cell] = candidate
                            parents[cell] = (row, column)
            parent = parents[cell][0], parents[cell][1]
        closed[cell] = True
        if _apart(cell, end) <= reach:
            end = cell
            break
        for row in range(max(cell[0] - 1, 0), min(cell[0] + 2, free.shape[0])):
            for column in range(max(cell[1] - 1, 0), min(cell[1] + 2, free.shape[1])):
                if free[row, column] and not closed[row, column]:
                    candidate = length[parent] + _apart(parent, (row, column))
                    if candidate < length[row, column]:
                        length[row, column] = candidate
                        parents[row, column] = parent
                        heappush(heap, (candidate + max(_apart((row, column), end) - reach, 0.0), (row, column)))
    corners = [end]
    if not closed[end]:
        return np.zeros((0, 2), np.int64)
    while corners[-1] != begin:
        last = corners[-1]
        corners.append((parents[last][0], parents[last][1]))
    path = np.zeros((len(corners), 2), np.int64)
    for k in range(len(corners)):
        path[len(corners) - 1 - k] = corners[k]
    return path
