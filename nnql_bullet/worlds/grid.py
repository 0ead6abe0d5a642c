"""The world on a grid: where the vehicle's centre may be, and whether that reaches from start to target."""

from dataclasses import replace
from math import cos, floor, hypot, sin

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nnql_bullet.geometry import OrientedBox
from nnql_bullet.worlds.spec import WorldSpec

CELL = 0.2
"""Side of a cell [m]."""


def occupancy(world: WorldSpec, cell: float = CELL) -> NDArray[np.bool_]:
    """Cells (rows along y, columns along x) that an obstacle may touch, with a wall all round.

    Boxes grow by half a cell's diagonal, so that one too thin to hold a cell's centre is not overlooked; a cell that
    reaches out of the arena is wall.
    """
    rows, columns = floor(world.depth / cell + 1e-9), floor(world.width / cell + 1e-9)
    grid = np.zeros((rows, columns), dtype=np.bool_)
    grow = hypot(cell, cell) / 2
    for box in world.obstacles:
        _fill(grid, replace(box, half_length=box.half_length + grow, half_width=box.half_width + grow), cell)
    return np.pad(grid, 1, constant_values=True)


def free_cells(world: WorldSpec, clearance: float, cell: float = CELL) -> NDArray[np.bool_]:
    """Cells from anywhere in which every obstacle and wall is at least `clearance` [m] away; walls included."""
    taken = occupancy(world, cell)
    # Between cell centres; points of the two cells may each be half a diagonal nearer.
    distances = ndimage.distance_transform_edt(~taken, sampling=cell)
    return np.asarray(distances >= clearance + hypot(cell, cell))


def is_solvable(world: WorldSpec, clearance: float) -> bool:
    """Whether a disc of radius `clearance` [m] can go from the start to the target."""
    free = free_cells(world, clearance)
    regions, _ = ndimage.label(free, structure=np.ones((3, 3)))
    ends = ((world.start.x, world.start.y), world.target)
    if not all(0 <= x <= world.width and 0 <= y <= world.depth for x, y in ends):
        return False
    start, target = (regions[_cell_of(x, y)] for x, y in ends)
    return bool(start == target != 0)


def _cell_of(x: float, y: float) -> tuple[int, int]:
    return int(y / CELL) + 1, int(x / CELL) + 1


def _fill(grid: NDArray[np.bool_], box: OrientedBox, cell: float) -> None:
    corners = box.corners() / cell
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int), (grid.shape[1], grid.shape[0]))
    if np.any(low >= high):
        return
    dx = (np.arange(low[0], high[0]) + 0.5) * cell - box.x
    dy = ((np.arange(low[1], high[1]) + 0.5) * cell - box.y)[:, None]
    c, s = cos(box.yaw), sin(box.yaw)
    inside = (np.abs(c * dx + s * dy) <= box.half_length) & (np.abs(c * dy - s * dx) <= box.half_width)
    grid[low[1] : high[1], low[0] : high[0]] |= inside
