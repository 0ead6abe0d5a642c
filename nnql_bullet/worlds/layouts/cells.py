"""A random layout: a cellular automaton grows clumps of round cells, as in the BARN worlds.

After Perille, Truong, Xiao and Stone, Benchmarking Metric Ground Navigation (SSRR 2020).
"""

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet.config import options
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Circle
from nnql_bullet.types import Extent, NonNegative
from nnql_bullet.worlds.layouts.base import Arena

NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])
BIRTH, LONELY = 5, 1
"""Numbers of filled neighbours from which a cell is filled, and up to which it is emptied."""
MOST_CELLS = 40_000
MOST_FILL = 0.6


@options
class Cells:
    """Options of a field of clumps."""

    is_random: ClassVar[bool] = True
    kind: Literal["cells"]
    fill: Annotated[float, Field(ge=0, le=MOST_FILL)]
    """Probability that a cell is filled at first."""
    cell: Extent = 0.3
    """Side of a cell, and diameter of the circle in a filled one [m]."""
    smoothing: Annotated[int, Field(ge=0, le=20)] = 3
    """Number of steps of the automaton."""
    clear_radius: NonNegative = 3.0
    """Smallest distance of circles from the start and the target [m]."""

    def denser(self, share: float) -> "Cells":
        """Returns the layout with more cells filled at first; whatever was filled in the end stays so."""
        return replace(self, fill=self.fill + share * (MOST_FILL - self.fill))

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[Circle, ...]:
        """Fills cells at random, and lets those with many filled neighbours grow and lonely ones die.

        Raises:
            UserError: If the arena has too many cells.
        """
        rows, columns = int(arena.depth / self.cell), int(arena.width / self.cell)
        if rows * columns > MOST_CELLS:
            raise UserError(f"layout: {rows} x {columns} cells are more than {MOST_CELLS}; enlarge 'cell'")
        filled = rng.random((rows, columns)) < self.fill
        for _ in range(self.smoothing):
            filled = _stepped(filled)
        y, x = ((index + 0.5) * self.cell for index in np.nonzero(filled))
        far = np.ones(len(x), np.bool_)
        for end_x, end_y in arena.keep_free:
            far &= np.hypot(x - end_x, y - end_y) >= self.clear_radius + self.cell / 2
        places = zip(np.round(x[far], 4).tolist(), np.round(y[far], 4).tolist(), strict=True)
        return tuple(Circle(its_x, its_y, self.cell / 2) for its_x, its_y in places)


def _stepped(filled: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Takes a step of the automaton; beyond the edge nothing is filled."""
    from scipy.ndimage import convolve  # takes long to load

    count = convolve(filled.astype(np.int64), NEIGHBOURS, mode="constant")
    return np.where(count >= BIRTH, True, np.where(count <= LONELY, False, filled))
