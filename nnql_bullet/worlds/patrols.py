"""Patrols: moving boxes that are drawn into a world of any layout."""

from math import atan2, cos, hypot, pi, sin
from typing import Annotated

import numpy as np
from pydantic import Field

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, as_rows, clearance
from nnql_bullet.types import Extent, NonNegative
from nnql_bullet.worlds.spec import Patrol, WorldSpec

Speed = Annotated[float, Field(gt=0, le=1)]
MOST_TRIES = 20_000
SWEEP_MARGIN = 0.1
"""Smallest distance of the area that a patrol sweeps from what stands, and from the areas of other patrols [m]."""


@options
class Patrols:
    """Options of patrols: boxes that go back and forth on straight tracks, as carts do.

    Patrols never stop. Their tracks are clear of all fixed obstacles and of each other, so no two ever meet.
    """

    count: Annotated[int, Field(ge=0, le=1000)]
    """Number of patrols."""
    min_side: Extent = 1.0
    """Length of a side [m]."""
    max_side: Extent = 3.0
    """[m]"""
    min_track: Annotated[float, Field(ge=0.1, le=1000)] = 10.0
    """Length of a track [m]."""
    max_track: Extent = 30.0
    """[m]"""
    min_speed: Speed = 0.3
    """[m/s]"""
    max_speed: Speed = 1.0
    """[m/s]; the default is half the speed of the paper's vehicle."""
    clear_radius: NonNegative = 4.0
    """Smallest distance of patrols from the start and the target [m]."""

    def __post_init__(self) -> None:
        """Refuses ranges in the wrong order."""
        refuse_crossed_ranges(self, "side", "track", "speed")

    def draw(self, world: WorldSpec, rng: np.random.Generator) -> tuple[Patrol, ...]:
        """Draws patrols one by one; rejects those that would touch something or come near the start or target.

        Numbers are rounded, so that all machines draw the same patrols.

        Raises:
            UserError: If the world has no room for them.
        """
        keep_free = as_rows(
            tuple(OrientedBox(x, y, 0.0, 0.0) for x, y in ((world.start.x, world.start.y), *world.targets))
        )
        patrols: list[Patrol] = []
        taken = world.solids
        for _ in range(MOST_TRIES):
            if len(patrols) == self.count:
                return tuple(patrols)
            patrol = self._anywhere(world, rng)
            swept = as_rows((_swept(patrol),))[0]
            inside = 0 < patrol.box.x < world.width and 0 < patrol.box.y < world.depth
            if inside and clearance(swept, taken) >= SWEEP_MARGIN and clearance(swept, keep_free) >= self.clear_radius:
                patrols.append(patrol)
                taken = np.concatenate([taken, swept[None]])
        raise UserError(
            f"world '{world.name}', seed {world.seed}: no room for {self.count} patrols; "
            "lower their 'count', 'max_side', 'max_track' or 'clear_radius'"
        )

    def _anywhere(self, world: WorldSpec, rng: np.random.Generator) -> Patrol:
        low = (0.0, 0.0, -pi, self.min_side, self.min_side, self.min_track, self.min_speed, 0.0)
        high = (world.width, world.depth, pi, self.max_side, self.max_side, self.max_track, self.max_speed, 1.0)
        x, y, yaw, length, width, track, speed, phase = rng.uniform(low, high).tolist()
        box = OrientedBox(round(x, 3), round(y, 3), round(length / 2, 3), round(width / 2, 3), round(yaw, 4))
        end = round(x + track * cos(yaw), 3), round(y + track * sin(yaw), 3)
        return Patrol(box, end, round(speed, 3), round(phase, 4))


def _swept(patrol: Patrol) -> OrientedBox:
    """The area that a patrol covers on its track, as a box along the track."""
    box, (end_x, end_y) = patrol.box, patrol.end
    along, across = end_x - box.x, end_y - box.y
    return OrientedBox(
        box.x + along / 2,
        box.y + across / 2,
        box.half_length + hypot(along, across) / 2,
        box.half_width,
        atan2(across, along),
    )
