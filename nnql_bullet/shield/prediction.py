"""Which actions leave a vehicle room to stop, predicted against the last scan under its load and grip."""

from dataclasses import dataclass, fields
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.geometry import Array, as_rows, wrap_angles
from nnql_bullet.mapping.prediction import PREDICTION_STEP, predicted_poses, scan_clearances
from nnql_bullet.types import NonNegative, Reach
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.limits import followed_limits, turning_deceleration
from nnql_bullet.vehicle.profiles import ramp_distances
from nnql_bullet.vehicle.spec import Limits, VehicleSpec

DISTANCE_STEP = 0.1
"""Distance between predicted places along a straight line [m]."""
GRIP_SHARE = 0.9
"""Fraction of the hardest braking that load and friction allow, which the prediction counts on."""
APPROACH = 0.03
"""Distance by which a vehicle that is nearer than the margin may get nearer still in a decision [m]."""
LEAST_CLEARANCE = 0.1
"""Clearance below which it may hardly get nearer [m]."""
AXLE = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
"""The rear-axle centre as a footprint without size."""


@options
class ShieldOptions:
    """Options of the shield: the clearance that it keeps, and how far ahead it keeps it."""

    margin: Reach = 0.3
    """Smallest clearance between the footprint and the last scan [m]. An obstacle may reach out between two rays."""
    tight_margin: Reach = 0.06
    """The same for a vehicle that stands and has no other way out [m]."""
    look_ahead: Reach = 2.0
    """Distance along every action that has to be clear [m]; more where a control period and braking take more."""
    corridor: Reach = 6.0
    """Distance within which there has to be a place to turn round on the spot [m]. The vehicle does not reverse, so
    that it could not leave a path without one."""
    box_speed: NonNegative = 1.0
    """Speed at which moving obstacles may come nearer [m/s]."""
    recovers: bool = True
    """Whether the shield leads an agent that gets no nearer to the target (see `recovery`)."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What predictions for n vehicles start from."""

    yaw_rate: Array
    """Yaw rates (n,) [rad/s]."""
    speed: Array
    """Commanded speeds (n,) [m/s]."""
    turns: Array
    """Heading changes of the six actions (n, 6) [rad]."""
    points: Array
    """Points of the scan in the vehicle frame (n, rays, 2) [m]; NaN for none."""
    moving: Array
    """Those of them that belong to moving obstacles (n, rays, 2) [m]; NaN for the others."""

    def of(self, vehicles: NDArray[np.int64]) -> "Situation":
        """The situation of some of the vehicles."""
        return Situation(*(getattr(self, its.name)[vehicles] for its in fields(self)))

    @property
    def moves(self) -> bool:
        """Whether any obstacle moves."""
        return bool(np.isfinite(self.moving).any())


class Predictor:
    """Predicts the clearance of actions and of stops. It keeps no state."""

    def __init__(self, options: ShieldOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        """Computes what depends on the vehicle alone.

        Args:
            options: Of the shield.
            vehicle: The vehicle with its load and grip.
            drive: How decisions reach the wheels.
        """
        self._options, self._drive = options, drive
        self._footprint = as_rows((vehicle.footprint,))[0]
        limits = vehicle.limits
        self._deceleration = min(limits.acceleration, GRIP_SHARE * turning_deceleration(vehicle, drive.speed))
        # What the drive asks for; what load and grip let the vehicle follow of it at speed, and while that changes.
        self._asked = limits
        self._followed = followed_limits(vehicle, drive.speed)
        self._followed_changing = followed_limits(vehicle, drive.speed / 2, limits.acceleration)
        self._look_ahead = max(options.look_ahead, float(self.stopping_distance(np.array(drive.speed))))
        self._turning_circle = float(np.hypot(*vehicle.footprint.corners().T).max()) + LEAST_CLEARANCE
        longest = max(self._look_ahead, options.corridor) / drive.speed + drive.speed / (2 * limits.acceleration)
        stop = drive.speed / self._deceleration + 2 * sqrt(max(paper.TURNS) / limits.yaw_acceleration)
        self._times = np.arange(PREDICTION_STEP, longest + PREDICTION_STEP, PREDICTION_STEP)
        self._stop_times = np.arange(PREDICTION_STEP, stop, PREDICTION_STEP)

    def stopping_distance(self, speeds: Array) -> Array:
        """Distances up to a stop of vehicles that drive on for one more control period (...) [m]."""
        period = self._drive.decision_period
        after = np.minimum(speeds + self._asked.acceleration * period, self._drive.speed)
        return np.asarray((speeds + after) / 2 * period + after * after / (2 * self._deceleration))

    def margins(self, points: Array) -> Array:
        """Clearances that vehicles have to keep (n,) [m]: the margin or, where they have less already, about that."""
        here: Array = scan_clearances(np.zeros((len(points), 1, 1, 3)), points, self._footprint)[:, 0, 0]
        less = np.where(here < LEAST_CLEARANCE, here - APPROACH / 6, np.maximum(here - APPROACH, LEAST_CLEARANCE))
        return np.minimum(less, self._options.margin)

    def stays_clear(self, situation: Situation, margins: Array, turns_round: bool = True) -> NDArray[np.bool_]:
        """Which actions (n, 6) keep a clearance up to where the vehicle can stop and turn round on the spot.

        The vehicle may turn as asked or fall behind, and has to stay clear either way.

        Args:
            situation: Of n vehicles.
            margins: Clearance that each has to keep (n,) [m].
            turns_round: Whether it has to turn round on the spot; else it is enough that it can stop.
        """
        s = situation
        clear, at_speed = self._keeps(s, margins, turns_round, self._asked), s.speed >= self._drive.speed
        for which, followed in ((at_speed, self._followed), (~at_speed, self._followed_changing)):
            some = np.flatnonzero(which & clear.any(axis=-1))
            if len(some) and followed != self._asked:
                clear[some] &= self._keeps(s.of(some), margins[some], turns_round, followed)
        return clear

    def drive_clearances(self, situation: Situation) -> Array:
        """Clearances of one vehicle that drives on along the six turns (6, k) [m], for as long as braking takes."""
        at_speed = situation.speed[0] >= self._drive.speed
        followed = self._followed if at_speed else self._followed_changing
        return self._worse(situation, self._drive.speed, followed)

    def stop_clearances(self, situation: Situation) -> Array:
        """Clearances of one vehicle that brakes along the six turns (6, k) [m], for as long as that takes."""
        return self._worse(situation, 0.0, self._followed_changing)

    def open_side(self, situation: Situation, target_bearing: float) -> int:
        """The side, 1 left or -1 right, on which one vehicle has to turn less for a clear path ahead.

        Directions near the target's cost less.
        """
        angles = np.radians(np.arange(-180.0, 181.0, 15.0))
        distances = np.arange(DISTANCE_STEP, self._look_ahead, DISTANCE_STEP)
        along, turned = np.broadcast_arrays(distances, angles[:, None])
        poses = np.stack([along * np.cos(turned), along * np.sin(turned), turned], axis=-1)
        clearances = scan_clearances(poses[None], situation.points, self._footprint)[0].min(axis=-1)
        cost = np.abs(angles) + np.abs(wrap_angles(angles - target_bearing)) / 2
        cost = np.where(clearances >= self._options.margin, cost, np.inf)
        return 1 if cost[angles >= 0].min() <= cost[angles <= 0].min() else -1

    def _predicted(self, s: Situation, goal: float, times: Array, limits: Limits) -> tuple[Array, Array, Array]:
        """Poses along the six turns (n, 6, k, 3), clearances there (n, 6, k) and distances driven (n, 1, k) [m].

        Moving obstacles may have come nearer by then.
        """
        goals = np.full(len(s.speed), goal)
        acceleration = limits.acceleration if goal > 0 else self._deceleration
        distances = ramp_distances(s.speed, goals, acceleration, times)
        poses = predicted_poses(s.yaw_rate, s.turns, distances, limits, times)
        clearances: Array = scan_clearances(poses, s.points, self._footprint)
        if s.moves:
            moving = scan_clearances(poses, s.moving, self._footprint) - self._options.box_speed * times
            clearances = np.minimum(clearances, np.maximum(moving, 0.0))
        return poses, clearances, np.cumsum(distances, axis=-1)[:, None, :]

    def _keeps(self, s: Situation, margins: Array, turns_round: bool, limits: Limits) -> NDArray[np.bool_]:
        """`stays_clear` under the limits that the vehicle follows."""
        poses, clearances, distances = self._predicted(s, self._drive.speed, self._times, limits)
        free = np.logical_and.accumulate(clearances >= margins[:, None, None], axis=-1)
        stops = free & (distances >= self.stopping_distance(s.speed)[:, None, None])
        if not turns_round:
            return np.asarray(stops.any(axis=-1))
        has_room = scan_clearances(poses, s.points, AXLE) >= self._turning_circle
        return np.asarray((free & (distances >= self._look_ahead)).any(axis=-1) & (stops & has_room).any(axis=-1))

    def _worse(self, situation: Situation, goal: float, followed: Limits) -> Array:
        """The smaller clearances of a vehicle that turns as asked and of one that falls behind (6, k) [m]."""
        both = self._asked, followed
        asked, behind = (self._predicted(situation, goal, self._stop_times, limits)[1][0] for limits in both)
        return np.asarray(np.minimum(asked, behind))
