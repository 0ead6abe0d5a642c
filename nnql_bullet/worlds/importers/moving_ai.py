"""Reads maps of the MovingAI benchmarks: a letter a cell, the first row on top, no unit of length."""

from pathlib import Path

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.files import read_text
from nnql_bullet.geometry import Pose
from nnql_bullet.worlds.importers.base import ForeignWorld, Reading, counted
from nnql_bullet.worlds.importers.cells import check_size, merged_boxes, trimmed

CELL = 1.0
"""Side of a cell by default [m]."""
FREE, SOLID = ".GS", "@OTW"
"""Ground, swamp; out of bounds, trees, and water, which nothing goes into from the ground."""


def read_moving_ai(path: Path, reading: Reading) -> ForeignWorld:
    """Reads a map.

    Raises:
        UserError: If it is malformed, too large, or no cell is free.
    """
    head, _, body = read_text(path).partition("map\n")
    sizes: dict[str, int] = {}
    for line in head.splitlines():
        key, _, value = line.strip().partition(" ")
        if key in ("height", "width") and value.strip().isascii() and value.strip().isdigit() and len(value) < 10:
            sizes[key] = int(value)
    if sizes.keys() != {"height", "width"}:
        raise UserError(f"{path}: is not a MovingAI map: it does not begin with the lines type, height, width, map")
    side = reading.cell or CELL
    check_size(sizes["width"], sizes["height"], side, path)
    rows = body.rstrip("\n").split("\n")
    if len(rows) != sizes["height"] or {len(row) for row in rows} != {sizes["width"]}:
        raise UserError(f"{path}: must have {sizes['height']} rows of {sizes['width']} cells, as its header says")
    text = "".join(rows)
    unlike = sorted(set(text) - set(FREE + SOLID))
    if unlike:
        raise UserError(f"{path}: there is no cell '{unlike[0]}'; there are: {' '.join(FREE + SOLID)}")
    letters = np.frombuffer(text.encode("ascii"), np.uint8).reshape(len(rows), -1)
    solid, left, below = trimmed(np.isin(letters, list(SOLID.encode("ascii")))[::-1], path)
    boxes = merged_boxes(solid, side, path)
    return ForeignWorld(
        format="MovingAI map",
        shapes=tuple(boxes),
        width=round(solid.shape[1] * side, 6),
        depth=round(solid.shape[0] * side, 6),
        frame=Pose(round(left * side, 6), round(below * side, 6), 0.0),
        files=(path,),
        notes=(
            f"{int(solid.sum())} solid cells are {counted(len(boxes), 'box', 'boxes')}",
            f"a cell is {side:g} m, as the format has no unit; (0, 0) is the lower left corner of the last row",
        ),
    )
