"""The shortest path of a disc through a world, and measures of the world's difficulty along it."""

from dataclasses import dataclass
from heapq import heappop, heappush
from math import pi

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, clearance_at, ray_distances, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.worlds.grid import GRID_CELL, Cell, centre_distance, ends_of, grown_boxes, is_inside, shape_of
from nnql_bullet.worlds.spec import WorldSpec

CHECK_SPACING = GRID_CELL / 4
"""Distance between the checked points of a straight line [m]; the cell of each point must be free."""
SURVEY_SPACING = 2.0
"""Distance along the path between measurements of its surroundings [m]."""
SIGHT_BOXES = 200
"""Boxes that rays are tested against at a time."""
VISIBILITY_RANGE = 100.0
"""Length of a ray that meets nothing [m]; in the paper's arena every ray meets a wall."""


@dataclass(frozen=True, slots=True)
class Difficulty:
    """Measures of a world's difficulty, which do not depend on a policy.

    The last three are means along the shortest path, after Perille, Truong, Xiao and Stone, Benchmarking Metric Ground
    Navigation (SSRR 2020).
    """

    cover: float
    """Share of the arena's area under boxes."""
    shortest_path: float
    """Length of a disc's shortest path from the start to the edge of the target [m]."""
    tortuosity: float
    """Length of the shortest path over the straight distance."""
    closest_obstacle: float
    """Distance to the closest obstacle or wall [m]."""
    visibility: float
    """Mean length of rays in all directions [m]."""


def difficulty(world: WorldSpec, clearance: float) -> Difficulty:
    """Measures the difficulty of a world for a disc of radius `clearance` [m].

    Raises:
        UserError: If there is no path to the target.
    """
    path = shortest_path(world, clearance)
    length = path_length(path)
    straight = float(np.hypot(*(path[-1] - path[0])))
    points = _along(path, SURVEY_SPACING)
    angles = np.arange(0.0, 2 * pi, pi / 36)
    point = np.zeros(6)  # a footprint without extent
    point[4] = 1.0
    closest = [clearance_at(x, y, 0.0, point, world.solids) for x, y in points.tolist()]
    seen = [float(np.mean(_sight(x, y, angles, world.solids))) for x, y in points.tolist()]
    return Difficulty(
        cover=world.cover,
        shortest_path=length - world.target_radius,
        tortuosity=length / straight,
        closest_obstacle=float(np.mean(closest)),
        visibility=float(np.mean(seen)),
    )


def _sight(x: float, y: float, angles: Array, solids: Array) -> Array:
    """Lengths of rays (m,) from a point [m], the nearest boxes first: those behind what all rays meet are left out."""
    nearest = np.hypot(solids[:, 0] - x, solids[:, 1] - y) - np.hypot(solids[:, 2], solids[:, 3])
    order = np.argsort(nearest)
    lengths = np.full(len(angles), VISIBILITY_RANGE)
    for first in range(0, len(order), SIGHT_BOXES):
        some = order[first : first + SIGHT_BOXES]
        if nearest[some[0]] > lengths.max():
            break
        lengths = np.minimum(lengths, ray_distances((x, y), angles, solids[some], VISIBILITY_RANGE))
    return lengths


def shortest_path(world: WorldSpec, clearance: float) -> Array:
    """Finds the shortest path from start to target over free cells (see `grid.is_solvable`).

    Lazy Theta* (Nash, Koenig and Tovey, AAAI 2010), an A* whose paths may run at any angle.

    Returns:
        Corners of the straight pieces of the path (k, 2) [m].

    Raises:
        UserError: If there is no path.
    """
    shape, (begin, end) = shape_of(world), ends_of(world)
    free = _free_cells(world, shape, clearance)
    inside = is_inside(begin, shape) and is_inside(end, shape)
    cells = _theta_star(begin, end, free) if inside and free[begin] and free[end] else np.zeros((0, 2), np.int64)
    if len(cells) == 0:
        raise UserError(f"world '{world.name}', seed {world.seed}: there is no way to the target; move its boxes apart")
    path = np.asarray((cells[:, ::-1] + 0.5) * GRID_CELL)
    path[0], path[-1] = (world.start.x, world.start.y), world.target
    return path


def path_length(path: Array) -> float:
    """Length of a path with corners (k, 2) [m]."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def _along(path: Array, every: float) -> Array:
    """Points (m, 2) on a path, `every` [m] apart."""
    ends = np.concatenate([[0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()])
    at = np.arange(0.0, ends[-1], every)
    return np.stack([np.interp(at, ends, path[:, axis]) for axis in (0, 1)], axis=1)


def _free_cells(world: WorldSpec, shape: Cell, clearance: float) -> NDArray[np.bool_]:
    """Marks the free cells, by the exact distance transform of the occupied and wall cells."""
    taken = np.ones((shape[0] + 2, shape[1] + 2), np.bool_)
    taken[1:-1, 1:-1] = _taken_cells(shape, grown_boxes(world))
    distance = np.asarray(distance_transform_edt(~taken, sampling=GRID_CELL))
    return np.asarray(distance[1:-1, 1:-1] >= centre_distance(clearance))


@njit(nogil=True)
def _taken_cells(shape: Cell, boxes: Array) -> NDArray[np.bool_]:
    """Marks the cells whose centres are in a box."""
    taken = np.zeros(shape, np.bool_)
    for i in range(len(boxes)):
        box = boxes[i]
        reach = np.hypot(box[2], box[3])
        rows = max(int((box[1] - reach) / GRID_CELL), 0), min(int((box[1] + reach) / GRID_CELL) + 1, shape[0])
        columns = max(int((box[0] - reach) / GRID_CELL), 0), min(int((box[0] + reach) / GRID_CELL) + 1, shape[1])
        for row in range(rows[0], rows[1]):
            for column in range(columns[0], columns[1]):
                if squared_distance((column + 0.5) * GRID_CELL, (row + 0.5) * GRID_CELL, box) == 0.0:
                    taken[row, column] = True
    return taken


@njit(nogil=True)
def _is_clear(begin: Cell, end: Cell, free: NDArray[np.bool_]) -> bool:
    """Whether the straight line between the centres of two cells crosses free cells only."""
    rows, columns = end[0] - begin[0], end[1] - begin[1]
    pieces = int(np.hypot(rows, columns) * GRID_CELL / CHECK_SPACING) + 1
    for k in range(1, pieces):
        row = int(np.floor(begin[0] + 0.5 + rows * k / pieces))
        column = int(np.floor(begin[1] + 0.5 + columns * k / pieces))
        if not free[row, column]:
            return False
    return True


@njit(nogil=True)
def _apart(one: Cell, other: Cell) -> float:
    """Distance between two cells, in cells."""
    return float(np.hypot(one[0] - other[0], one[1] - other[1]))


@njit(nogil=True)
def _theta_star(begin: Cell, end: Cell, free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Finds the cells (k, 2) at the corners of the path from `begin` to `end`; none if there is no path."""
    length = np.full(free.shape, np.inf)  # of the path from `begin`, in cells
    parents = np.zeros((free.shape[0], free.shape[1], 2), np.int64)
    closed = np.zeros(free.shape, np.bool_)
    length[begin] = 0.0
    parents[begin] = begin
    heap = [(_apart(begin, end), begin)]
    while heap:
        _, cell = heappop(heap)
        if closed[cell]:
            continue
        parent = parents[cell][0], parents[cell][1]
        if not _is_clear(parent, cell, free):  # lazy: the line is checked only now
            length[cell] = np.inf
            for row in range(cell[0] - 1, cell[0] + 2):
                for column in range(cell[1] - 1, cell[1] + 2):
                    if closed[row, column]:
                        candidate = length[row, column] + _apart((row, column), cell)
                        if candidate < length[cell]:
                            length[cell] = candidate
                            parents[cell] = (row, column)
            parent = parents[cell][0], parents[cell][1]
        closed[cell] = True
        if cell == end:
            break
        # A free cell is not at the edge, because the clearance is more than a cell.
        for row in range(cell[0] - 1, cell[0] + 2):
            for column in range(cell[1] - 1, cell[1] + 2):
                if free[row, column] and not closed[row, column]:
                    candidate = length[parent] + _apart(parent, (row, column))
                    if candidate < length[row, column]:
                        length[row, column] = candidate
                        parents[row, column] = parent
                        heappush(heap, (candidate + _apart((row, column), end), (row, column)))
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
