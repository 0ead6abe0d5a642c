"""A world as it stands: one arena with its obstacles, start and target."""

import hashlib
from dataclasses import dataclass
from functools import cached_property

from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows

WALL_THICKNESS = 1.0


@dataclass(frozen=True)
class WorldSpec:
    """A rectangular arena from (0, 0) to (`width`, `depth`) [m], walled in."""

    name: str
    seed: int
    width: float
    depth: float
    obstacles: tuple[OrientedBox, ...]
    start: Pose
    target: tuple[float, float]
    target_radius: float
    obstacle_height: float

    @property
    def walls(self) -> tuple[OrientedBox, ...]:
        """Four boxes just outside the arena."""
        w, d, t = self.width / 2, self.depth / 2, WALL_THICKNESS / 2
        return (
            OrientedBox(w, -t, w + 2 * t, t),
            OrientedBox(w, self.depth + t, w + 2 * t, t),
            OrientedBox(-t, d, t, d),
            OrientedBox(self.width + t, d, t, d),
        )

    @cached_property
    def solids(self) -> Array:
        """Obstacles and walls as the rows (n, 6) of `geometry.as_rows`."""
        return as_rows(self.obstacles + self.walls)

    @property
    def cover(self) -> float:
        """The obstacles' share of the arena's area; they do not overlap in generated worlds."""
        return sum(box.area for box in self.obstacles) / (self.width * self.depth)

    @cached_property
    def digest(self) -> str:
        """A hash of everything a vehicle could tell apart, the same on every machine."""
        numbers = [self.width, self.depth, self.start.x, self.start.y, self.start.yaw, *self.target, self.target_radius]
        for box in self.obstacles:
            numbers += [box.x, box.y, box.half_length, box.half_width, box.yaw]
        text = " ".join(f"{number:.6f}" for number in [*numbers, self.obstacle_height])
        return hashlib.sha256(text.encode()).hexdigest()[:16]
