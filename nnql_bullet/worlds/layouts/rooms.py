"""A random layout: the arena is divided into rooms by walls with doors (binary space partitioning)."""

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.config import options, refuse_crossed_ranges
from nnql_bullet.geometry import OrientedBox, as_rows, squared_distance
from nnql_bullet.types import Extent, NonNegative
from nnql_bullet.worlds.layouts.base import Arena

Span = tuple[float, float]
NARROWEST = 0.1
"""Share of the width of doors that is left where they are narrowest."""
MOST_TRIES = 20
"""Largest number of places that are tried for a wall."""


@options
class Rooms:
    """Options of a floor of rooms."""

    is_random: ClassVar[bool] = True
    kind: Literal["rooms"]
    min_room: Annotated[float, Field(ge=0.5, le=1000)] = 4.0
    """Smallest side of a room [m]; larger rooms are divided as long as both parts are as large."""
    min_door: Extent = 1.0
    """Width of a door [m]."""
    max_door: Extent = 1.8
    """[m]"""
    wall: Extent = 0.15
    """Thickness of walls [m]."""
    clear_radius: NonNegative = 1.0
    """Smallest distance of walls from the start and the target [m]; a piece that is nearer is left out."""

    def __post_init__(self) -> None:
        """Refuses widths in the wrong order, and doors wider than rooms."""
        refuse_crossed_ranges(self, "door")
        if self.max_door > self.min_room - 2 * self.wall:
            raise ValueError(f"max_door {self.max_door:g} does not fit into min_room {self.min_room:g}; enlarge that")

    def denser(self, share: float) -> "Rooms":
        """Returns the layout with narrower doors."""
        narrower = 1.0 - share * (1.0 - NARROWEST)
        return replace(self, min_door=narrower * self.min_door, max_door=narrower * self.max_door)

    def place(self, arena: Arena, rng: np.random.Generator) -> tuple[OrientedBox, ...]:
        """Divides rooms until they are small, each by a wall with one door."""
        walls: list[OrientedBox] = []
        doors: list[tuple[int, float, Span]] = []  # the axis of the wall, its place, and the span of the door
        rooms: list[tuple[Span, Span]] = [((0.0, arena.width), (0.0, arena.depth))]
        while rooms:
            along_x, along_y = rooms.pop()
            sides = [high - low for low, high in (along_x, along_y)]
            axis = int(sides[1] > sides[0])
            if sides[axis] < 2 * self.min_room + self.wall:
                continue
            across, along = ((along_x, along_y), (along_y, along_x))[axis]
            for _ in range(MOST_TRIES):
                at = round(float(rng.uniform(across[0] + self.min_room, across[1] - self.min_room)), 3)
                if not any(self._blocks(at, along, axis, *door) for door in doors):
                    break
            else:
                continue
            width = float(rng.uniform(self.min_door, self.max_door))
            begin = float(rng.uniform(along[0] + self.wall, along[1] - self.wall - width))
            doors.append((axis, at, (begin, begin + width)))
            walls += self._wall(at, along, axis, (begin, begin + width))
            for part in ((across[0], at), (at, across[1])):
                rooms.append((part, along) if axis == 0 else (along, part))
        return tuple(box for box in walls if self._leaves_free(box, arena))

    def _blocks(self, at: float, along: Span, axis: int, door_axis: int, door_at: float, door: Span) -> bool:
        """Whether a wall ends in a door of another wall."""
        return door_axis != axis and door_at in along and door[0] - self.wall < at < door[1] + self.wall

    def _wall(self, at: float, along: Span, axis: int, door: Span) -> list[OrientedBox]:
        """Makes the two pieces of a wall across the axis (0: x, 1: y), beside its door."""
        pieces = []
        for low, high in ((along[0], door[0]), (door[1], along[1])):
            middle, half = round((low + high) / 2, 3), round((high - low) / 2, 3)
            x, y = (at, middle) if axis == 0 else (middle, at)
            half_length, half_width = (self.wall / 2, half) if axis == 0 else (half, self.wall / 2)
            pieces.append(OrientedBox(x, y, half_length, half_width))
        return pieces

    def _leaves_free(self, box: OrientedBox, arena: Arena) -> bool:
        row = as_rows([box])[0]
        return all(squared_distance(*point, row) >= self.clear_radius**2 for point in arena.keep_free)
