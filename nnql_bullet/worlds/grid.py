"""The world as a grid of free and occupied cells, and whether free cells lead from the start to the target."""

from heapq import heappop, heappush
from math import floor, hypot

import numpy as np

from nnql_bullet.geometry import Array, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.worlds.spec import WorldSpec

GRID_CELL = 0.2
"""Side of a cell [m]."""
GRID_DIAGONAL = hypot(GRID_CELL, GRID_CELL)
"""Length of a cell's diagonal [m]."""
_GROWTH = np.array([0.0, 0.0, GRID_DIAGONAL / 2, GRID_DIAGONAL / 2, 0.0, 0.0])
"""Growth of the rows of boxes, so that none is too thin to occupy a cell [m]."""

Cell = tuple[int, int]
"""Row along y, column along x."""


def is_solvable(world: WorldSpec, clearance: float) -> bool:
    """Whether a disc of radius `clearance` [m] can go from the start to the target over free cells.

    A box, grown by half a cell's diagonal, occupies the cells whose centres it contains. Cells that extend beyond the
    arena are wall. A cell is free if every point in it is at least `clearance` away from every occupied cell and wall.
    """
    shape = shape_of(world)
    start, target = ends_of(world)
    if not (is_inside(start, shape) and is_inside(target, shape)):
        return False
    # The search begins at the target: in most worlds it is nearer to a corner, so obstacles enclose it more often.
    return bool(_are_joined(target, start, shape, grown_boxes(world), centre_distance(clearance)))


def shape_of(world: WorldSpec) -> Cell:
    """Numbers of rows and columns of the grid."""
    return floor(world.depth / GRID_CELL + 1e-9), floor(world.width / GRID_CELL + 1e-9)


def ends_of(world: WorldSpec) -> tuple[Cell, Cell]:
    """The cells of the start and of the target."""
    return cell_of(world.start.x, world.start.y), cell_of(*world.target)


def is_inside(cell: Cell, shape: Cell) -> bool:
    """Whether a cell is in the grid."""
    return 0 <= cell[0] < shape[0] and 0 <= cell[1] < shape[1]


def grown_boxes(world: WorldSpec) -> Array:
    """The obstacles as rows (n, 6) of `as_rows`, grown by half a cell's diagonal on each side."""
    return np.asarray(world.solids[: len(world.obstacles)] + _GROWTH)


def centre_distance(clearance: float) -> float:
    """Distance between the centres of two cells whose points are all at least `clearance` apart [m]."""
    return clearance + GRID_DIAGONAL


def cell_of(x: float, y: float) -> Cell:
    """The cell that contains a point [m]."""
    return floor(y / GRID_CELL), floor(x / GRID_CELL)


@njit(nogil=True)
def _takes_a_cell_around(cell: Cell, box: Array, reach: float) -> bool:
    """Whether a box occupies a cell whose centre is less than `reach` [m] from the centre of `cell`."""
    far = int(reach / GRID_CELL)
    for row in range(-far, far + 1):
        for column in range(-far, far + 1):
            x, y = (cell[1] + column + 0.5) * GRID_CELL, (cell[0] + row + 0.5) * GRID_CELL
            if (row * row + column * column) * GRID_CELL**2 < reach**2 and squared_distance(x, y, box) == 0.0:
                return True
    return False


@njit(nogil=True)
def _room_around(cell: Cell, shape: Cell, boxes: Array, reach: float) -> float:
    """Lower bound on the distance from a cell's centre to the centres of occupied and wall cells [m].

    The bound is at least `reach` if that distance is, and 0 otherwise.
    """
    row, column = cell
    walls = (min(row, column, shape[0] - 1 - row, shape[1] - 1 - column) + 1) * GRID_CELL
    if walls < reach:
        return 0.0
    closest = np.inf
    for i in range(len(boxes)):
        squared = squared_distance((column + 0.5) * GRID_CELL, (row + 0.5) * GRID_CELL, boxes[i])
        if squared < reach**2 and _takes_a_cell_around(cell, boxes[i], reach):
            return 0.0
        closest = min(closest, squared)
    return float(max(reach, min(walls, np.sqrt(closest))))


@njit(nogil=True)
def _are_joined(begin: Cell, end: Cell, shape: Cell, boxes: Array, reach: float) -> bool:
    """Whether a chain of free cells, each a neighbour of the last (eight directions), leads from `begin` to `end`.

    Greedy best-first search (Russell and Norvig, Artificial Intelligence, 3.5.1): it expands the cell nearest to the
    end. It measures the room around a cell only if the room around the previous cell does not imply enough.
    """
    seen = np.zeros(shape, dtype=np.bool_)
    seen[begin] = True
    heap = [(0, begin, 0.0)]
    while heap:
        _, cell, room = heappop(heap)
        if room < reach:
            room = _room_around(cell, shape, boxes, reach)
            if room < reach:
                continue
        if cell == end:
            return True
        # A free cell is not at the edge, because `reach` is more than a cell.
        for row in range(cell[0] - 1, cell[0] + 2):
            for column in range(cell[1] - 1, cell[1] + 2):
                if not seen[row, column]:
                    seen[row, column] = True
                    to_go = (row - end[0]) ** 2 + (column - end[1]) ** 2
                    heappush(heap, (to_go, (row, column), room - GRID_DIAGONAL))
    return False
