"""Boxes of random size and yaw that do not overlap, up to a share of the arena's area."""

from math import pi
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows, clearance, distance
from nnql_bullet.worlds.layouts.base import Arena

Positive = Annotated[float, Field(gt=0)]
MOST_TRIES = 20_000


@options
class RandomBoxes:
    """Options of the paper's "obstacles randomly scattered in the environment" (IV), whose sizes it leaves open."""

    kind: Literal["random_boxes"]
    cover: Annotated[float, Field(ge=0, le=0.4)]
    """Share of the arena's area under boxes."""
    min_side: Positive = 2.0
    """[m]"""
    max_side: Positive = 8.0
    """[m]"""
    clear_radius: Annotated[float, Field(ge=0)] = 4.0
    """No box comes nearer than this to the start or the target [m]."""

    def __post_init__(self) -> None:
        """Refuses sides in the wrong order."""
        if self.min_side > self.max_side:
            raise ValueError(f"min_side {self.min_side:g} is above max_side {self.max_side:g}")

    @property
    def is_random(self) -> bool:
        """Every draw is another world."""
        return True

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """Draws boxes one by one, each rejected where it overlaps another, leaves the arena, or crowds start or target.

        Numbers are rounded to a millimetre and 1e-4 rad, so that no machine's last bit matters.

        Raises:
            UserError: If no room is found for the cover asked for.
        """
        mean_area = ((self.min_side + self.max_side) / 2) ** 2
        wanted = self.cover * arena.width * arena.depth - mean_area / 2
        boxes: list[OrientedBox] = []
        rows = np.empty((0, 6))
        for _ in range(MOST_TRIES):
            if sum(box.area for box in boxes) >= wanted:
                return tuple(boxes)
            box = self._draw(arena, rng)
            row = as_rows((box,))
            if clearance(row[0], rows) > 0 and self._leaves_room(box, row, arena):
                boxes.append(box)
                rows = np.concatenate([rows, row])
        raise UserError(
            f"layout: no room for boxes over {self.cover:.0%} of the arena; lower 'cover', 'max_side' or 'clear_radius'"
        )

    def _draw(self, arena: Arena, rng: np.random.Generator) -> OrientedBox:
        x, y = rng.uniform((0.0, 0.0), (arena.width, arena.depth))
        half_length, half_width = rng.uniform(self.min_side, self.max_side, 2) / 2
        yaw = rng.uniform(-pi / 2, pi / 2)
        x, y, half_length, half_width = (round(float(number), 3) for number in (x, y, half_length, half_width))
        return OrientedBox(x, y, half_length, half_width, round(float(yaw), 4))

    def _leaves_room(self, box: OrientedBox, row: Array, arena: Arena) -> bool:
        corners = box.corners()
        if np.any(corners < 0.0) or np.any(corners > (arena.width, arena.depth)):
            return False
        reach = np.hypot(box.half_length, box.half_width)
        for x, y in arena.keep_free:
            if distance(Pose(box.x, box.y, 0.0), x, y) > reach + self.clear_radius:
                continue
            if clearance(as_rows((OrientedBox(x, y, 0.0, 0.0),))[0], row) < self.clear_radius:
                return False
        return True
