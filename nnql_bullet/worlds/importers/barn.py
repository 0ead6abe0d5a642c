"""Reads worlds of the BARN challenge (Perille, Truong, Xiao and Stone, SSRR 2020): Gazebo worlds with reference paths.

`world_N.world` is a world whose start and target are the same for all N. `path_N.npy`, in the same folder, in
`path_files` beside it or beside its folder, has the cells of a path through it.
"""

import re
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file
from nnql_bullet.geometry import Array, Pose
from nnql_bullet.worlds.importers.base import ForeignWorld, Reading
from nnql_bullet.worlds.importers.sdf import read_sdf

START, TARGET = Pose(-2.0, 3.0, pi / 2), (-2.0, 13.0)
"""Of every world; the target is reached within 1 m."""
CELL, CORNER = 0.15, (-4.5, 5.0)
"""Side of a cell of reference paths, and the lower left corner of their grid [m]."""
MOST_BYTES = 1_000_000
"""Size of the largest file of a path [bytes]."""
_NAME = re.compile(r"world_(\d{1,6})")


def path_file(world: Path) -> Path | None:
    """The file of the reference path of a world; None if it is no world of BARN."""
    named = _NAME.fullmatch(world.stem)
    if named is None:
        return None
    name = f"path_{named[1]}.npy"
    folders = (world.parent, world.parent / "path_files", world.parent.parent / "path_files")
    return next((folder / name for folder in folders if is_file(folder / name)), None)


def read_barn(path: Path, reading: Reading) -> ForeignWorld:
    """Reads a world, with the start and the target of the challenge.

    Raises:
        UserError: If it is malformed.
    """
    found = read_sdf(path, reading, ((START.x, START.y), TARGET))
    notes = (*found.notes, "start and target are those of the BARN challenge")
    return replace(found, format="BARN world", notes=notes, start=START, target=TARGET)


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
