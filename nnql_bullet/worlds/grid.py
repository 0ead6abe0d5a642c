"""The world on a grid: where the vehicle's centre may be, and whether that reaches from start to target."""

from heapq import heappop, heappush
from math import floor, hypot

import numpy as np

from nnql_bullet.geometry import Array, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.worlds.spec import WorldSpec

GRID_CELL = 0.2
"""Side of a cell [m]."""

GRID_DIAGONAL = hypot(GRID_CELL, GRID_CELL)
"""Of a cell [m]."""
GROWTH = np.array([0.0, 0.0, GRID_DIAGONAL / 2, GRID_DIAGONAL / 2, 0.0, 0.0])
"""What the rows of boxes grow by, so that none is too thin to take a cell."""

Cell = tuple[int, int]
"""Row along y, column along x."""


def is_solvable(world: WorldSpec, clearance: float) -> bool:
    """Whether a disc of radius `clearance` [m] can go from the start to the target, from free cell to free cell.

    A box takes the cells whose centres it holds when it is grown by half a cell's diagonal, so that one too thin to
    hold any is not overlooked; a cell that reaches out of the arena is wall. A cell is free if every obstacle and wall
    is at least `clearance` away from anywhere in it.
    """
    shape = floor(world.depth / GRID_CELL + 1e-9), floor(world.width / GRID_CELL + 1e-9)
    start, target = cell_of(world.start.x, world.start.y), cell_of(*world.target)
    if not all(0 <= cell[axis] < shape[axis] for cell in (start, target) for axis in (0, 1)):
        return False
    boxes = world.solids[: len(world.obstacles)] + GROWTH
    # Between cell centres; points of the two cells may each be half a diagonal nearer.
    reach = clearance + GRID_DIAGONAL
    # From the target, which most worlds have nearer to a corner: what is more often shut in is sooner searched.
    return bool(_are_joined(target, start, shape, boxes, reach))


def cell_of(x: float, y: float) -> Cell:
    """The cell that a point [m] lies in."""
    return floor(y / GRID_CELL), floor(x / GRID_CELL)


@njit(nogil=True)
def _takes_a_cell_around(cell: Cell, box: Array, reach: float) -> bool:
    """Whether a box takes a cell whose centre is nearer than `reach` [m] to that of `cell`."""
    far = int(reach / GRID_CELL)
    for row in range(-far, far + 1):
        for column in range(-far, far + 1):
            x, y = (cell[1] + column + 0.5) * GRID_CELL, (cell[0] + row + 0.5) * GRID_CELL
            if (row * row + column * column) * GRID_CELL**2 < reach**2 and squared_distance(x, y, box) == 0.0:
                return True
    return False


@njit(nogil=True)
def _room_around(cell: Cell, shape: Cell, boxes: Array, reach: float) -> float:
    """A lower bound [m] on how far the centre of a cell is from those of cells that are taken or wall.

    It is `reach` or more exactly where that distance is, and 0 elsewhere.
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
    """Whether free cells, each one of the eight around the last, lead from `begin` to `end`.

    Greedy best-first search (Russell and Norvig, Artificial Intelligence, 3.5.1): the cell nearest to the end is next.
    The room around a cell is measured only where it does not follow from that around the cell it is entered from.
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
        # A free cell is not at the edge: `reach` is more than a cell.
        for row in range(cell[0] - 1, cell[0] + 2):
            for column in range(cell[1] - 1, cell[1] + 2):
                if not seen[row, column]:
                    seen[row, column] = True
                    to_go = (row - end[0]) ** 2 + (column - end[1]) ** 2
                    heappush(heap, (to_go, (row, column), room - GRID_DIAGONAL))
    return False
