"""Recovery of a vehicle that gets no nearer to its target: it follows the obstacle until it is nearer than ever.

The lengths are those of the shipped vehicle (see `vehicle.scale`); another's are multiples of them.

The method is the boundary following of the Bug algorithms (Lumelsky and Stepanov, Algorithmica 2, 1987; Choset et al.,
Principles of Robot Motion, chapter 2), with limits of time and distance, after which the vehicle tries the other side.
"""

from dataclasses import dataclass, replace
from math import inf, pi, radians

import numpy as np

from nnql_bullet import paper
from nnql_bullet.geometry import Array, wrap_angle, wrap_angles
from nnql_bullet.sensing import FRONT_LEFT, FRONT_RIGHT, Sensor

STUCK_AFTER = 12.0
"""Time without progress after which a vehicle is stuck [s]."""
PROGRESS = 0.5
"""Distance by which the vehicle has to be nearer to the target than ever before to make progress [m]."""
FIRST_LIMIT, LIMIT_GROWTH = 20.0, 2.0
"""Time that the first recovery may take [s], and its factor after each recovery that failed."""
FARTHEST = 25.0
"""Distance by which a recovery may lead farther from the target than the vehicle has ever been near [m]."""
FIRST_GAIN, GAIN_GROWTH = 10.0, 4.0
"""How much nearer a vehicle is guided after its first recovery before its agent ranks actions again [m], and what that
is multiplied by with each further recovery: an agent that gets stuck again and again does not know the way."""
KEPT_DISTANCE = 1.2
"""Distance kept between the sensor and the obstacle that is followed [m]."""
CORRECTION = 0.5
"""Gain of that distance's correction: fraction of the largest turn per metre of deviation [1/m]."""
AHEAD, BEHIND = radians(30.0), radians(170.0)
"""Bearings, on one side, between which the obstacle that is followed is looked for [rad]."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """One vehicle's progress, and its recovery."""

    side: int = 0
    """Side to which it turns away from what it follows: 1 left, -1 right, 0 while it does not recover."""
    closest: float = inf
    """Smallest distance to the target so far, in steps of `PROGRESS` [m]."""
    waited: float = 0.0
    """Time since then, or since the last recovery [s]."""
    left: float = 0.0
    """Time left for the recovery [s]."""
    recoveries: int = 0
    """Recoveries so far."""
    failures: int = 0
    """Recoveries that failed: they took too long, or led too far away."""
    last_side: int = 0
    """Side of the last recovery."""
    swap: bool = False
    """Whether the last recovery failed, so that the next goes the other way round."""
    guided_until: float = inf
    """Distance to the target up to which the vehicle is guided [m]; infinite before the first recovery."""

    def updated(self, distance: float, readings: Array, side: int, period: float, scale: float) -> "Recovery":
        """Returns progress and recovery at the next decision.

        Args:
            distance: Distance to the target [m].
            readings: Readings of the eight sensors (8,) [m].
            side: Side to which the vehicle turns on the spot; 0 if it does not.
            period: Time since the last decision [s].
            scale: Of lengths, see `lengths.Lengths`.
        """
        nearer = distance < self.closest - PROGRESS * scale
        waited = 0.0 if nearer else self.waited + period
        closest = distance if nearer else self.closest
        now = replace(self, waited=waited, closest=closest)
        if self.side:
            now = replace(now, left=self.left - period)
            if nearer or now.left < 0 or distance > closest + FARTHEST * scale:
                failures = self.failures + (not nearer)
                return replace(now, side=0, waited=0.0, swap=not nearer, failures=failures)
            return now
        if waited <= STUCK_AFTER:
            return now
        opener = 1 if readings[FRONT_LEFT] > readings[FRONT_RIGHT] else -1
        chosen = -self.last_side if self.swap else side or opener
        return replace(
            now,
            side=chosen,
            last_side=chosen,
            left=FIRST_LIMIT * LIMIT_GROWTH**self.failures,
            guided_until=closest - FIRST_GAIN * scale * GAIN_GROWTH**self.recoveries,
            recoveries=self.recoveries + 1,
        )

    def leads(self, distance: float) -> bool:
        """Whether the recovery, not the agent, leads the vehicle at a distance to the target [m]."""
        return self.side != 0 or (self.recoveries > 0 and distance > self.guided_until)

    def heading(self, target_bearing: float, ray_distances: Array, sensor: Sensor, scale: float) -> float:
        """Heading change [rad]: toward the target or, during a recovery, along the obstacle that is followed."""
        if not self.side:
            return target_bearing
        bearings = wrap_angles(sensor.angles)
        beside = -self.side * bearings
        distances = np.where((beside > -AHEAD) & (beside < BEHIND), ray_distances, inf)
        nearest = int(distances.argmin())
        bearing = float(bearings[nearest]) if sensor.met(distances[nearest]) else -self.side * pi / 2
        deviation = float(distances[nearest]) / scale - KEPT_DISTANCE
        closing = min(max(deviation * CORRECTION, -1.0), 1.0) * max(paper.TURNS)
        return float(wrap_angle(bearing + self.side * (pi / 2 - closing)))
