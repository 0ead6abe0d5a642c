"""The interface of layouts, and the test that all random layouts apply to their boxes."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import COLUMNS, Array, OrientedBox, Shape, clearance, reach_of, squared_distance
from nnql_bullet.jit import njit

MOST_BOXES = 100_000
"""Largest number of boxes of a world."""


@dataclass(frozen=True, slots=True)
class Arena:
    """The empty arena that a layout fills."""

    width: float
    """[m]"""
    depth: float
    """[m]"""
    keep_free: tuple[tuple[float, float], ...]
    """Start, way points and target [m]."""

    @property
    def limits(self) -> tuple[Array, Array]:
        """Size (2,) and points to keep free (n, 2) [m], the arguments of `leaves_room`."""
        return np.array([self.width, self.depth]), np.array(self.keep_free)


class Layout(Protocol):
    """Options of a layout; they place its obstacles."""

    @property
    def is_random(self) -> bool:
        """Whether each draw gives another world."""

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[Shape, ...]:
        """Places the obstacles of one world, drawn from `rng` alone.

        Raises:
            UserError: If the arena has no room for them.
        """


@runtime_checkable
class Densifiable(Layout, Protocol):
    """A layout that can be made denser, so that its passages become narrower."""

    def denser(self, share: float) -> Layout:
        """Returns the layout denser, by a share of what is possible, 0 to 1; the same numbers from `rng` drawn again.

        Obstacles of the layout stay where they are, and others are added, as far as that is possible.
        """


@njit(nogil=True)
def leaves_room(row: Array, size: Array, keep_free: Array, clear_radius: float) -> bool:
    """Whether a box is inside the arena and far enough from some points.

    Args:
        row: The box, a row (7,) of `as_rows`.
        size: Width and depth of the arena (2,) [m].
        keep_free: The points (n, 2) [m].
        clear_radius: Smallest distance of the box from the points [m].
    """
    across = abs(row[2] * row[4]) + abs(row[3] * row[5]) + row[6]
    along = abs(row[2] * row[5]) + abs(row[3] * row[4]) + row[6]
    if row[0] < across or row[0] > size[0] - across or row[1] < along or row[1] > size[1] - along:
        return False
    nearest = np.inf
    for point in keep_free:
        nearest = min(nearest, squared_distance(point[0], point[1], row))
    return bool(nearest >= clear_radius**2)


@njit(nogil=True)
def placed(
    rows: Array, amounts: Array, wanted: float, size: Array, keep_free: Array, clear_radius: float, spacing: float
) -> tuple[NDArray[np.int64], float]:
    """Chooses shapes in their order, until they amount to what is wanted; rejects those that leave no room.

    Args:
        rows: The shapes, rows (n, 7) of `as_rows`.
        amounts: What each counts for (n,).
        wanted: Sum of the amounts.
        size: See `leaves_room`.
        keep_free: See `leaves_room`.
        clear_radius: See `leaves_room`.
        spacing: Distance that two shapes are farther apart than [m].

    Returns:
        Indices of the chosen shapes, and their amount.
    """
    there, reaches = np.empty_like(rows), np.empty(len(rows))
    chosen = np.empty(len(rows), dtype=np.int64)
    count, amount = 0, 0.0
    for i in range(len(rows)):
        if amount >= wanted:
            break
        if leaves_room(rows[i], size, keep_free, clear_radius) and _is_apart(
            rows[i], there[:count], reaches[:count], spacing
        ):
            for j in range(COLUMNS):  # numba takes seconds to compile the assignment of a row
                there[count, j] = rows[i, j]
            reaches[count] = reach_of(rows[i])
            chosen[count] = i
            amount += amounts[i]
            count += 1
    return chosen[:count], amount


@njit(nogil=True)
def _is_apart(row: Array, others: Array, reaches: Array, spacing: float) -> bool:
    """Whether a shape is farther than `spacing` [m] from others; it measures only those whose circles are as near."""
    reach = reach_of(row) + spacing + 1e-9
    for k in range(len(others)):
        far = reach + reaches[k]
        dx, dy = row[0] - others[k, 0], row[1] - others[k, 1]
        if dx * dx + dy * dy < far * far and clearance(row, others[k : k + 1]) <= spacing:
            return False
    return True


def as_rounded(values: Array, digits: int) -> Array:
    """Rounds numbers to digits as Python's `round` does, from which `np.round` differs for some near a half."""
    scaled = values * 10.0**digits
    whole = np.rint(scaled)
    result = whole / 10.0**digits
    halves = np.abs(scaled - whole) > 0.499
    result[halves] = [round(value, digits) for value in values[halves].tolist()]
    return result


def rounded(box: OrientedBox) -> OrientedBox:
    """Rounds a box to 1 mm and 1e-4 rad, so that all machines draw the same box."""
    return OrientedBox(
        round(box.x, 3), round(box.y, 3), round(box.half_length, 3), round(box.half_width, 3), round(box.yaw, 4)
    )
