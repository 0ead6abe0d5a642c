"""What a layout is."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nnql_bullet.geometry import OrientedBox


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
