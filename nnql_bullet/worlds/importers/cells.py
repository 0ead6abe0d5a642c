"""Solid cells of a grid as few boxes."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.jit import njit
from nnql_bullet.worlds.importers.base import LONGEST_SIDE
from nnql_bullet.worlds.layouts.base import MOST_BOXES

MOST_CELLS = 50_000_000
"""Largest number of cells of a map."""


def check_size(columns: int, rows: int, side: float, where: Path) -> None:
    """Checks the size of a grid before it is read.

    Raises:
        UserError: If it has too many cells, or is too long.
    """
    if columns < 1 or rows < 1:
        raise UserError(f"{where}: it has no cells")
    if columns * rows > MOST_CELLS:
        raise UserError(f"{where}: it has {columns} x {rows} cells; up to {MOST_CELLS} are read")
    if max(columns, rows) * side > LONGEST_SIDE:
        size = f"{columns * side:g} m x {rows * side:g} m"
        raise UserError(f"{where}: it is {size}; arenas are up to {LONGEST_SIDE:g} m long: check the size of its cells")


def trimmed(solid: NDArray[np.bool_], where: Path) -> tuple[NDArray[np.bool_], int, int]:
    """Removes outer rows and columns without a free cell, in whose place an arena has its walls.

    Args:
        solid: Whether each cell is solid (rows from below, columns from the left).
        where: Names the file in errors.

    Returns:
        What remains, and the numbers of columns and rows that were removed at the left and below.

    Raises:
        UserError: If no cell is free.
    """
    rows, columns = (np.flatnonzero(~solid.all(axis=axis)) for axis in (1, 0))
    if not len(rows):
        raise UserError(f"{where}: no cell of it is free")
    return solid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], int(columns[0]), int(rows[0])


def merged_boxes(solid: NDArray[np.bool_], side: float, where: Path) -> list[OrientedBox]:
    """Covers exactly the solid cells of a grid with few boxes, which do not overlap.

    Args:
        solid: Whether each cell is solid (rows from below, columns from the left).
        side: Side of a cell [m].
        where: Names the file in errors.

    Raises:
        UserError: If a world cannot have so many boxes.
    """
    found = _rectangles(np.ascontiguousarray(solid), MOST_BOXES + 1)
    if len(found) > MOST_BOXES:
        raise UserError(f"{where}: its solid cells make more than {MOST_BOXES} boxes; clean it, or make cells larger")
    centres = (found[:, :2] + found[:, 2:] / 2) * side
    halves = found[:, 2:] * side / 2
    rows = np.round(np.concatenate([centres, halves], axis=1), 6).tolist()
    return [OrientedBox(*row) for row in rows]


@njit(nogil=True)
def _rectangles(solid: NDArray[np.bool_], most: int) -> NDArray[np.int64]:
    """Finds rectangles (n, 4) that cover the solid cells: column and row of their corner, columns and rows.

    Each begins at the first cell that is not covered, and is the larger of two: as wide as possible and then as high,
    or as high as possible and then as wide.
    """
    left = solid.copy()
    rows, columns = solid.shape
    found = []
    for row in range(rows):
        for column in range(columns):
            if not left[row, column]:
                continue
            wide = _grown(left, row, column, True)
            high = _grown(left, row, column, False)
            its = wide if wide[0] * wide[1] >= high[0] * high[1] else high
            left[row : row + its[1], column : column + its[0]] = False
            found.append((column, row, its[0], its[1]))
            if len(found) == most:
                break
        if len(found) == most:
            break
    boxes = np.zeros((len(found), 4), np.int64)
    for k in range(len(found)):
        for i in range(4):
            boxes[k, i] = found[k][i]
    return boxes


@njit(nogil=True)
def _grown(left: NDArray[np.bool_], row: int, column: int, wide_first: bool) -> tuple[int, int]:
    """Columns and rows of the rectangle of solid cells that grows from a cell along one side and then the other."""
    rows, columns = left.shape
    across, up = 1, 1
    for step in range(2):
        if wide_first == (step == 0):
            while column + across < columns and left[row : row + up, column + across].all():
                across += 1
        else:
            while row + up < rows and left[row + up, column : column + across].all():
                up += 1
    return across, up
