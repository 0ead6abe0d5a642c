"""A drawn world: the arena with its obstacles, start, target and patrols."""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import hypot

import numpy as np

from nnql_bullet.blocks import by_place
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, Shape, as_rows
from nnql_bullet.jit import njit
from nnql_bullet.worlds.passages import Passage, Point, is_passable, narrowest_passage

WALL_THICKNESS = 1.0
"""[m]"""


@dataclass(frozen=True, slots=True)
class Patrol:
    """A box that goes back and forth on a straight track at constant speed and reverses at once at its ends.

    It never stops and passes through other patrols.
    """

    box: OrientedBox
    """The box at one end of the track. Its yaw is constant."""
    end: tuple[float, float]
    """Centre of the box at the other end [m]."""
    speed: float
    """[m/s]"""
    phase: float
    """Share of a round trip completed at time 0; 0 is at `box`."""

    @property
    def track(self) -> tuple[float, float, float, float, float, float]:
        """Row of `follow_tracks`: x, y of one end, offset of the other end [m], round trips per second, phase."""
        along, across = self.end[0] - self.box.x, self.end[1] - self.box.y
        return self.box.x, self.box.y, along, across, self.speed / (2 * hypot(along, across)), self.phase

    def at(self, time: float) -> OrientedBox:
        """The box at a time after the world's reset [s]."""
        x, y, along, across, rate, phase = self.track
        share = there_and_back(phase + rate * time)
        return replace(self.box, x=x + share * along, y=y + share * across)


@njit()
def there_and_back(round_trips: float) -> float:
    """Computes the position along a track, from 0 at one end to 1 at the other: a triangle wave."""
    return float(1.0 - abs(1.0 - 2.0 * (round_trips % 1.0)))


@njit()
def follow_tracks(tracks: Array, time: float, boxes: Array) -> None:
    """Moves boxes on tracks to their positions at a time.

    Args:
        tracks: Rows (m, 6) of `WorldSpec.tracks`.
        time: Time since the reset [s].
        boxes: Rows (m, 7) of `as_rows`, whose centres are overwritten.
    """
    for i in range(len(tracks)):
        share = there_and_back(tracks[i, 5] + tracks[i, 4] * time)
        boxes[i, 0] = tracks[i, 0] + share * tracks[i, 2]
        boxes[i, 1] = tracks[i, 1] + share * tracks[i, 3]


@njit()
def track_velocities(tracks: Array, time: float) -> Array:
    """Computes velocities (m, 2) [m/s] of boxes on tracks (m, 6) at a time after the reset [s]."""
    velocities = np.empty((len(tracks), 2))
    for i in range(len(tracks)):
        there = (tracks[i, 5] + tracks[i, 4] * time) % 1.0 < 0.5
        rate = 2.0 * tracks[i, 4] if there else -2.0 * tracks[i, 4]
        velocities[i, 0], velocities[i, 1] = rate * tracks[i, 2], rate * tracks[i, 3]
    return velocities


@dataclass(frozen=True)
class WorldSpec:
    """A rectangular arena from (0, 0) to (`width`, `depth`) [m] with walls around it."""

    name: str
    seed: int
    width: float
    depth: float
    obstacles: tuple[Shape, ...]
    start: Pose
    target: tuple[float, float]
    target_radius: float
    obstacle_height: float
    patrols: tuple[Patrol, ...] = ()
    waypoints: tuple[Point, ...] = ()
    """Places to reach in turn before the target, each within the target's radius [m]."""
    at_rest: bool = False
    """Whether the vehicle starts at rest, and not at the speed of its drive."""

    def start_speed(self, speed: float) -> float:
        """Speed at the start of a vehicle whose drive has a given speed [m/s]."""
        return 0.0 if self.at_rest else speed

    @property
    def targets(self) -> tuple[Point, ...]:
        """The way points and the target, in turn [m]."""
        return (*self.waypoints, self.target)

    @property
    def legs(self) -> tuple[tuple[Point, Point], ...]:
        """From the start to the first way point, and so on to the target [m]."""
        return tuple(pairwise(((self.start.x, self.start.y), *self.targets)))

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
    def shapes(self) -> tuple[Shape, ...]:
        """Obstacles and walls; many are sorted by place."""
        return by_place(self.obstacles + self.walls)

    @cached_property
    def solids(self) -> Array:
        """The `shapes` as the rows (n, 7) of `geometry.as_rows`."""
        return as_rows(self.shapes)

    @cached_property
    def tracks(self) -> Array:
        """Rows `Patrol.track` of all patrols (m, 6)."""
        return np.array([patrol.track for patrol in self.patrols], dtype=np.float64).reshape(len(self.patrols), 6)

    def solids_at(self, time: float) -> Array:
        """The `solids` and the patrols at a time after the reset [s], as rows (n + m, 7) of a new array."""
        return np.concatenate([self.solids, as_rows(tuple(patrol.at(time) for patrol in self.patrols))])

    @cached_property
    def bottleneck(self) -> Passage:
        """The narrowest place of the widest path from the start, by all way points, to the target, without patrols."""
        return min((narrowest_passage(self.solids, *leg) for leg in self.legs), key=lambda its: its.width)

    def admits(self, width: float) -> bool:
        """Whether the bottleneck admits a disc of a width [m], found faster than the bottleneck itself."""
        return all(is_passable(self.solids, *leg, width) for leg in self.legs)

    @property
    def cover(self) -> float:
        """Share of the arena's area under obstacles, if they do not overlap."""
        return sum(shape.area for shape in self.obstacles) / (self.width * self.depth)

    @cached_property
    def digest(self) -> str:
        """Hash of the world without its name and seed; it is the same on every machine."""
        numbers = [self.width, self.depth, self.start.x, self.start.y, self.start.yaw, *self.target, self.target_radius]
        for shape in self.obstacles:
            if isinstance(shape, Circle):
                numbers += [shape.x, shape.y, -shape.radius]
            else:
                numbers += [shape.x, shape.y, shape.half_length, shape.half_width, shape.yaw]
        numbers += [number for point in self.waypoints for number in point]
        for patrol in self.patrols:
            box = patrol.box
            numbers += [box.x, box.y, box.half_length, box.half_width, box.yaw, *patrol.end, patrol.speed, patrol.phase]
        text = " ".join(f"{number:.6f}" for number in [*numbers, self.obstacle_height])
        text += " at rest" if self.at_rest else ""
        return hashlib.sha256(text.encode()).hexdigest()[:16]
