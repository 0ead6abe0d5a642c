"""Chooses a start and a target in a world that has none: two places far apart that a vehicle gets between."""

from dataclasses import dataclass
from math import atan2, ceil, dist, sqrt

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, Pose
from nnql_bullet.jit import njit
from nnql_bullet.worlds.passages import Point, narrowest_passage
from nnql_bullet.worlds.paths import GRID_CELL, MOST_CELLS, free_cells

ROOM = 1.3
"""Distance of both ends from everything, in widths of the passage; the shipped vehicle can turn round there."""
AHEAD = 2.0
"""Distance along the way at which the start looks [widths of the passage]."""


@dataclass(frozen=True, slots=True)
class Ends:
    """A start and a target."""

    start: Pose
    target: Point
    """[m]"""
    way: float
    """Length of the shortest way along rows and columns of cells [m]."""


def choose_ends(
    size: Point, solids: Array, passage: float, start: Point | None = None, target: Point | None = None
) -> Ends | None:
    """Finds two places that are as far apart as a way through a world is long, or one of them for a given other.

    Args:
        size: Width and depth of the arena [m].
        solids: Obstacles and walls, rows (n, 7) of `as_rows`.
        passage: Width of the narrowest place of the way at least [m].
        start: A given start [m].
        target: A given target [m].

    Returns:
        None if there are no two places farther apart than four times the passage.
    """
    side = max(min(GRID_CELL, passage / 4), sqrt(size[0] * size[1] / MOST_CELLS))
    # Where a disc passes, cells are connected with the slack of half a diagonal; they may be elsewhere too.
    for slack in (side / sqrt(2), 0.0):
        ends = _chosen(size, solids, passage, side, slack, start, target)
        if ends and narrowest_passage(solids, (ends.start.x, ends.start.y), ends.target).admits(passage):
            return ends
    return None


def _chosen(
    size: Point, solids: Array, passage: float, side: float, slack: float, start: Point | None, target: Point | None
) -> Ends | None:
    """Chooses ends on a grid of cells of a side [m], whose centres are half a passage away from all, less `slack`."""
    from scipy.ndimage import label  # takes long to load

    shape = ceil(size[1] / side), ceil(size[0] / side)
    labels, _ = label(free_cells(shape, side, solids, passage / 2 - slack), np.ones((3, 3)))
    roomy = free_cells(shape, side, solids, ROOM * passage) & (labels > 0)
    if not roomy.any():
        return None

    def cell_of(point: Point) -> tuple[int, int]:
        return min(int(point[1] / side), shape[0] - 1), min(int(point[0] / side), shape[1] - 1)

    given = start or target
    region = labels[cell_of(given)] if given else np.bincount(labels[roomy]).argmax()
    within = labels == region
    candidates = roomy & within
    if region == 0 or not candidates.any():
        return None
    begin = cell_of(given) if given else _farthest(_steps(within, *_first(candidates)), candidates)
    steps = _steps(within, *begin)
    end = _farthest(steps, candidates)
    if given is target and target:
        begin, end = end, begin
        steps = _steps(within, *begin)
    first, last = (start or _centre(begin, side)), (target or _centre(end, side))
    ahead = _place_on_way(steps, *end, round(AHEAD * passage / side))
    if dist(first, last) < 4 * passage:
        return None
    x, y = _centre((int(ahead[0]), int(ahead[1])), side)
    yaw = round(atan2(y - first[1], x - first[0]), 6)
    return Ends(Pose(*first, yaw), last, float(steps[end]) * side)


def _centre(cell: tuple[int, int], side: float) -> Point:
    return round((cell[1] + 0.5) * side, 6), round((cell[0] + 0.5) * side, 6)


def _first(cells: NDArray[np.bool_]) -> tuple[int, int]:
    row, column = np.unravel_index(int(cells.argmax()), cells.shape)
    return int(row), int(column)


def _farthest(steps: NDArray[np.int32], candidates: NDArray[np.bool_]) -> tuple[int, int]:
    """The candidate that most steps lead to."""
    row, column = np.unravel_index(int(np.where(candidates, steps, -1).argmax()), steps.shape)
    return int(row), int(column)


@njit(nogil=True)
def _steps(free: NDArray[np.bool_], row: int, column: int) -> NDArray[np.int32]:
    """Counts the steps from a cell to every free cell, to one of four neighbours each; -1 where none lead."""
    steps = np.full(free.shape, -1, np.int32)
    queue = np.zeros((free.size, 2), np.int32)
    queue[0, 0], queue[0, 1] = row, column
    steps[row, column] = 0
    first, last = 0, 1
    while first < last:
        r, c = queue[first]
        first += 1
        for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            i, j = r + dr, c + dc
            if 0 <= i < free.shape[0] and 0 <= j < free.shape[1] and free[i, j] and steps[i, j] < 0:
                steps[i, j] = steps[r, c] + 1
                queue[last, 0], queue[last, 1] = i, j
                last += 1
    return steps


@njit(nogil=True)
def _place_on_way(steps: NDArray[np.int32], row: int, column: int, ahead: int) -> tuple[int, int]:
    """Follows steps back from a cell to the one that is so many steps from where they begin.

    Rows and columns take turns where both lead back, so that the way is straight where it can be.
    """
    while steps[row, column] > ahead:
        here, moved = steps[row, column], False
        for k in range(4):
            which = (k + here) % 4
            dr, dc = ((0, 1), (1, 0), (0, -1), (-1, 0))[which]
            i, j = row + dr, column + dc
            if 0 <= i < steps.shape[0] and 0 <= j < steps.shape[1] and steps[i, j] == here - 1:
                row, column, moved = i, j, True
                break
        if not moved:
            break
    return row, column
