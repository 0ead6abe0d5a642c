"""What a layout is."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nnql_bullet.geometry import Array, OrientedBox, squared_distance
from nnql_bullet.jit import njit


@dataclass(frozen=True, slots=True)
class Arena:
    """The empty arena that a layout fills: its size [m] and the points that must stay reachable."""

    width: float
    depth: float
    keep_free: tuple[tuple[float, float], ...]
    """Start and target."""


class Layout(Protocol):
    """Options that know how to place obstacles."""

    @property
    def is_random(self) -> bool:
        """Whether another draw gives another world."""

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """Obstacles for one world, drawn from `rng` alone."""


@njit(nogil=True)
def leaves_room(row: Array, size: Array, keep_free: Array, clear_radius: float) -> bool:
    """Whether a box, a row (6,) of `as_rows`, lies in the arena and off what is to be kept free.

    Args:
        row: The box.
        size: Of the arena (2,) [m].
        keep_free: Points (n, 2) [m].
        clear_radius: That it comes no nearer to them than this [m].
    """
    across = abs(row[2] * row[4]) + abs(row[3] * row[5])
    along = abs(row[2] * row[5]) + abs(row[3] * row[4])
    if row[0] < across or row[0] > size[0] - across or row[1] < along or row[1] > size[1] - along:
        return False
    nearest = np.inf
    for point in keep_free:
        nearest = min(nearest, squared_distance(point[0], point[1], row))
    return bool(nearest >= clear_radius**2)
