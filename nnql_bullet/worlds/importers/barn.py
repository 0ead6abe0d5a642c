"""Reads worlds of the BARN challenge (Perille, Truong, Xiao and Stone, SSRR 2020): Gazebo worlds with reference paths.

`world_N.world` is a world whose start and target are the same for all N. `path_N.npy`, in the same folder, in
`path_files` beside it or beside its folder, has the cells of a path through it. Without one, a world named so is of
BARN if obstacles lie on all sides of that start.
"""

import re
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file
from nnql_bullet.geometry import Array, Pose, as_rows
from nnql_bullet.worlds.importers.base import ForeignWorld, Reading, bounds
from nnql_bullet.worlds.importers.sdf import read_sdf

START, TARGET = Pose(-2.0, 3.0, pi / 2), (-2.0, 13.0)
"""Of every world; the target is reached within 1 m."""
CELL, CORNER = 0.15, (-4.5, 5.0)
"""Side of a cell of reference paths, and the lower left corner of their grid [m]."""
MOST_BYTES = 1_000_000
"""Size of the largest file of a path [bytes]."""
SHIFT = 0.15
"""How far to the left of its cells the challenge's own program draws a reference path [m]."""
FOLDERS = ("", "worlds", "world_files", "BARN")
"""Where the worlds lie in a folder of BARN: in itself or in one of these."""
_NAME = re.compile(r"world_(\d{1,6})")


def number_of(world: Path) -> int | None:
    """The number of a world by its name; None if it is named otherwise."""
    named = _NAME.fullmatch(world.stem)
    return int(named[1]) if named else None


def world_files(folder: Path) -> dict[int, Path]:
    """Finds the worlds of a folder of BARN by their numbers, in order.

    Raises:
        UserError: If there are none, or two of one number.
    """
    homes = [folder / name for name in FOLDERS]
    found = next((its for home in homes if (its := sorted(home.glob("world_*.world")))), [])
    numbered = [(number, path) for path in found if (number := number_of(path)) is not None and is_file(path)]
    if not numbered:
        raise UserError(
            f"{folder}: has no world_N.world, nor has {', '.join(FOLDERS[1:])} in it; give a folder of BARN"
        )
    files = dict(sorted(numbered))
    if len(files) < len(numbered):
        twice = next(path for number, path in numbered if files[number] != path)
        raise UserError(f"{twice}: there is another world of this number; keep one of them")
    return files


def path_file(world: Path) -> Path | None:
    """The file of the reference path of a world; None if it has none or is named otherwise."""
    named = _NAME.fullmatch(world.stem)
    if named is None:
        return None
    name = f"path_{named[1]}.npy"
    folders = (world.parent, world.parent / "path_files", world.parent.parent / "path_files")
    return next((folder / name for folder in folders if is_file(folder / name)), None)


def read_barn(path: Path, reading: Reading) -> ForeignWorld:
    """Reads a world that is named as those of BARN, with the start and the target of the challenge if it is one.

    Raises:
        UserError: If it is malformed.
    """
    found = read_sdf(path, reading, ((START.x, START.y), TARGET))
    if path_file(path) is None and not _surrounds_start(found):
        return read_sdf(path, reading)
    notes = (*found.notes, "start and target are those of the BARN challenge")
    return replace(found, format="BARN world", notes=notes, start=START, target=TARGET)


def _surrounds_start(found: ForeignWorld) -> bool:
    """Whether obstacles lie on all sides of the challenge's start."""
    rows, start = as_rows(found.shapes), np.subtract((START.x, START.y), (found.frame.x, found.frame.y))
    half = bounds(rows)
    low, high = (rows[:, :2] - half).min(axis=0), (rows[:, :2] + half).max(axis=0)
    return bool(((low < start) & (start < high)).all())


def reference_length(path: Path) -> float:
    """Computes the length of a reference path from the start to the target, as the challenge's own program does [m].

    It joins start, cells and target by straight lines, and draws the cells one cell too far to the left (`SHIFT`).

    Raises:
        UserError: If the path is malformed.
    """
    cells = read_reference_path(path) - (SHIFT, 0.0)
    points = np.concatenate([[(START.x, START.y)], cells, [TARGET]])
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def read_reference_path(path: Path) -> Array:
    """Reads a reference path.

    Returns:
        Centres of its cells, in the frame of the world (k, 2) [m].

    Raises:
        UserError: If it is malformed.
    """
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise UserError(f"{path}: has {size} bytes; paths are read up to {MOST_BYTES}")
        cells = np.lib.format.open_memmap(path, mode="r")  # neither objects nor more than the file holds
    except UserError:
        raise
    except Exception as error:  # NumPy raises whatever a damaged file leads it into
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{path}: cannot be read as an array: {reason}") from None
    fits = cells.ndim == 2 and cells.shape[1:] == (2,) and len(cells) > 1
    if not fits or cells.dtype.kind not in "iuf" or not np.isfinite(cells).all() or abs(cells).max() > 1e6:
        raise UserError(f"{path}: must hold the columns and rows of at least two cells, as numbers")
    return np.asarray((cells.astype(np.float64) + 0.5) * CELL + CORNER)
