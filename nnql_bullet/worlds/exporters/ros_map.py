"""Writes ROS maps."""

from functools import partial
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.files import write_atomically, write_text
from nnql_bullet.geometry import Array, Pose, clearance
from nnql_bullet.jit import njit
from nnql_bullet.worlds.importers.base import turned_corner
from nnql_bullet.worlds.importers.cells import MOST_CELLS
from nnql_bullet.worlds.spec import WorldSpec

TOUCH = 2e-6
"""Depth up to which a shape reaches into a cell without making it solid: twice what coordinates are rounded to [m]."""
SOLID, FREE = 0, 254


def write_ros_map(world: WorldSpec, frame: Pose, path: Path, cell: float) -> list[Path]:
    """Writes the YAML file of a map, and its picture beside it.

    A cell is solid if an obstacle or a wall reaches into it. The walls of the arena are a frame of one cell.

    Raises:
        UserError: If it has too many cells.
    """
    if not 1e-3 <= cell <= 100:
        raise UserError(f"the side of a cell must be from 0.001 to 100 m, not {cell:g}")
    columns, rows = (ceil(side / cell - 1e-6) + 2 for side in (world.width, world.depth))
    if columns * rows > MOST_CELLS:
        size = f"{columns} x {rows} cells of {cell:g} m"
        raise UserError(f"world '{world.name}' has {size}; up to {MOST_CELLS} are written: give a larger cell")
    solid = _covered((rows, columns), cell, world.solids, TOUCH)
    picture, corner = path.with_suffix(".pgm"), turned_corner(frame.x, frame.y, frame.yaw, -cell, -cell)
    head = f"P5\n{columns} {rows}\n255\n".encode("ascii")
    content = head + np.where(solid[::-1], SOLID, FREE).astype(np.uint8).tobytes()
    write_atomically(picture, partial(Path.write_bytes, data=content))
    origin = ", ".join(repr(round(value, 9) + 0.0) for value in (corner.x, corner.y, corner.yaw))
    lines = [f"image: {_quoted(picture.name)}", "mode: trinary", f"resolution: {cell!r}", f"origin: [{origin}]"]
    write_text(path, "\n".join([*lines, "negate: 0", "occupied_thresh: 0.65", "free_thresh: 0.196", ""]))
    return [path, picture]


def _quoted(name: str) -> str:
    """Text as YAML writes it whatever it holds."""
    doubled = name.replace("'", "''")
    return f"'{doubled}'"


@njit(nogil=True)
def _covered(shape: tuple[int, int], side: float, solids: Array, touch: float) -> NDArray[np.bool_]:
    """Marks the cells that shapes, rows (n, 7) of `as_rows`, reach into; cell (1, 1) has its corner in (0, 0)."""
    covered = np.zeros(shape, np.bool_)
    cell = np.array([0.0, 0.0, side / 2 - touch, side / 2 - touch, 1.0, 0.0, 0.0])
    for k in range(len(solids)):
        its = solids[k : k + 1]
        across = abs(its[0, 2] * its[0, 4]) + abs(its[0, 3] * its[0, 5]) + its[0, 6]
        along = abs(its[0, 2] * its[0, 5]) + abs(its[0, 3] * its[0, 4]) + its[0, 6]
        rows = max(int((its[0, 1] - along) / side), 0), min(int((its[0, 1] + along) / side) + 3, shape[0])
        columns = max(int((its[0, 0] - across) / side), 0), min(int((its[0, 0] + across) / side) + 3, shape[1])
        for row in range(rows[0], rows[1]):
            for column in range(columns[0], columns[1]):
                if not covered[row, column]:
                    cell[0], cell[1] = (column - 0.5) * side, (row - 0.5) * side
                    covered[row, column] = clearance(cell, its) <= 0.0
    return covered
