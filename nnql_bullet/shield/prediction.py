"""Which actions leave a vehicle room to stop, predicted from its speed, load and grip.

What recent scans saw has to stay clear of the course. Where they saw nothing at all, an obstacle of the least width may
stand: the vehicle has to be able to stop before it comes near such a place.
"""

from dataclasses import dataclass, fields
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import ACTIONS, REVERSE, SLOW, speed_scale
from nnql_bullet.geometry import Array, as_rows, wrap_angles
from nnql_bullet.mapping.prediction import PREDICTION_STEP, predicted_poses, scan_clearances
from nnql_bullet.mapping.seen_space import RecentScans, meets_unseen
from nnql_bullet.shield.courses import clear_courses, drives, then_stops
from nnql_bullet.shield.lengths import Lengths
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.limits import followed_limits, side_grip
from nnql_bullet.vehicle.profiles import ramp_distances
from nnql_bullet.vehicle.spec import Limits, VehicleSpec

DISTANCE_STEP = 0.1
"""Distance between predicted places along a straight line, for the shipped vehicle [m]."""
APPROACH = 0.03
"""Distance by which that vehicle may get nearer still in a decision if it is nearer than the margin [m]."""
LEAST_CLEARANCE = 0.1
"""Clearance below which it may hardly get nearer [m]."""
SLIDING = 0.1
"""Share of the drive's speed below which a vehicle that is to stop turns as on the spot."""
SLOWLY = 1.2
"""Share of the speed of slow driving up to which a vehicle that slides is expected to turn before it brakes."""

AXLE = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
"""The rear-axle centre as a footprint without size."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What predictions for n vehicles start from."""

    yaw_rate: Array
    """Yaw rates (n,) [rad/s]."""
    speed: Array
    """Measured speeds (n,) [m/s], negative backwards."""
    turns: Array
    """Heading changes of the six actions (n, 6) [rad]."""
    points: Array
    """Points of obstacles in the vehicle frame (n, m, 2) [m]; NaN for none."""
    moving: NDArray[np.bool_]
    """Whether they belong to moving obstacles (n, m)."""

    def of(self, vehicles: NDArray[np.int64]) -> "Situation":
        """The situation of some of the vehicles."""
        return Situation(*(getattr(self, its.name)[vehicles] for its in fields(self)))


class Predictor:
    """Predicts the clearance of actions and of stops. It keeps no state."""

    def __init__(self, lengths: Lengths, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        """Computes what depends on the vehicle alone.

        Args:
            lengths: Of the shield.
            vehicle: The vehicle with its load and grip.
            drive: How decisions reach the wheels.
        """
        self.lengths, self.drive = lengths, drive
        self.footprint = as_rows((vehicle.footprint,))[0]
        self.sensor, self.first_angle = np.array(vehicle.sensor.position[:2]), float(vehicle.sensor.angles[0])
        limits = vehicle.limits
        # What the drive asks for; what load and grip let the vehicle follow of it at speed, and while that changes.
        self.asked = limits
        self.followed = followed_limits(vehicle, drive.speed)
        self.followed_slowly = followed_limits(vehicle, drive.speed * drive.reverse_share)
        self.followed_changing = followed_limits(vehicle, drive.speed / 2, limits.acceleration)
        self.followed_standing = followed_limits(vehicle, lengths.standstill)
        self.slides = self.followed_standing != limits
        """Whether load and grip do not let the vehicle follow its turns on the spot: it slides as they end."""
        self.brakes_straight_above = side_grip(vehicle, limits.acceleration) / limits.yaw_rate
        self.turning_circle = lengths.turning_radius + lengths.times(LEAST_CLEARANCE)
        longest = max(lengths.look_ahead, lengths.corridor) / drive.speed + drive.speed / (2 * limits.acceleration)
        stop = drive.speed / lengths.deceleration + 2 * sqrt(max(paper.TURNS) / limits.yaw_acceleration)
        self.times = np.arange(PREDICTION_STEP, longest + PREDICTION_STEP, PREDICTION_STEP)
        self.stop_times = np.arange(PREDICTION_STEP, stop, PREDICTION_STEP)

    def stopping_distance(self, speeds: Array) -> Array:
        """Distances up to a stop of vehicles that drive on for one more control period (...) [m]."""
        period = self.drive.decision_period
        after = np.minimum(speeds + self.asked.acceleration * period, self.drive.speed)
        return np.asarray((speeds + after) / 2 * period + after * after / (2 * self.lengths.deceleration))

    def margins(self, points: Array) -> Array:
        """Clearances that vehicles have to keep (n,) [m]: the margin or, where they have less already, about that."""
        least, approach = self.lengths.times(LEAST_CLEARANCE), self.lengths.times(APPROACH)
        here: Array = scan_clearances(np.zeros((len(points), 1, 1, 3)), points, self.footprint)[:, 0, 0]
        nearer = np.maximum(here - approach / 6, here / 2)  # a margin of 0 would let it touch
        less = np.where(here < least, nearer, np.maximum(here - approach, least))
        return np.minimum(less, self.lengths.margin)

    def stays_clear(self, situation: Situation, margins: Array, turns_round: bool = True) -> NDArray[np.bool_]:
        """Which actions (n, 6) keep a clearance up to where the vehicle can stop and turn round on the spot.

        The vehicle may turn as asked or fall behind, and has to stay clear either way.

        Args:
            situation: Of n vehicles.
            margins: Clearance that each has to keep (n,) [m].
            turns_round: Whether it has to turn round on the spot; else it is enough that it can stop.
        """
        s = situation
        clear, at_speed = self._keeps(s, margins, turns_round, self.asked), s.speed >= self.drive.speed
        for which, followed in ((at_speed, self.followed), (~at_speed, self.followed_changing)):
            some = np.flatnonzero(which & clear.any(axis=-1))
            if len(some) and followed != self.asked:
                clear[some] &= self._keeps(s.of(some), margins[some], turns_round, followed)
        return clear

    def can_stop(self, situation: Situation, scans: RecentScans, manoeuvre: int, margin: float) -> bool:
        """Whether one vehicle that carries out a manoeuvre and then brakes straight ahead stays clear.

        It stays clear of what was seen, and keeps to where nothing can stand unseen.

        Args:
            situation: Of this vehicle alone.
            scans: Its recent scans.
            manoeuvre: A number below `env.MANOEUVRES`.
            margin: Clearance from what was seen [m].
        """
        tight, width = self.lengths.tight_margin, self.lengths.least_width
        courses = self._until_it_stands(situation, manoeuvre)
        return all(
            scan_clearances(course[None, None], situation.points, self.footprint).min() >= margin for course in courses
        ) and not any(
            meets_unseen(course, self.footprint, tight, width, scans, self.sensor, self.first_angle)
            for course in courses
        )

    def can_stop_after(self, situation: Situation, scans: RecentScans, manner: int, margin: float) -> NDArray[np.bool_]:
        """Whether one vehicle can stop after each of the six actions (6,), see `can_stop`.

        Args:
            situation: Of this vehicle alone.
            scans: Its recent scans.
            manner: 0, `STOP`, `REVERSE` or `SLOW`.
            margin: Clearance from what was seen [m].
        """
        return np.array([self.can_stop(situation, scans, manner + action, margin) for action in range(ACTIONS)])

    def _until_it_stands(self, situation: Situation, manoeuvre: int) -> list[Array]:
        """Courses of one vehicle that carries out a manoeuvre and then brakes straight ahead (k, 3).

        It may fall behind in either part and not in the other: so what its next decision expects of braking has been
        expected here.
        """
        turn, rate = float(situation.turns[0, manoeuvre % ACTIONS]), float(situation.yaw_rate[0])
        speed, goal = float(situation.speed[0]), float(speed_scale(manoeuvre, self.drive)) * self.drive.speed
        courses, braking = {}, self.lengths.deceleration
        change = self.asked.acceleration if goal > speed else braking
        for turned, limits, slides in self._turns(turn, rate, speed, goal):
            yaw_limits = limits.yaw_rate, limits.yaw_acceleration
            driven = drives(rate, speed, turned, goal, self.drive.decision_period, *yaw_limits, change, slides)
            for back, limits, slides in self._turns(0.0, float(driven[-1, 3]), float(driven[-1, 4]), 0.0):
                course = then_stops(driven, back, limits.yaw_rate, limits.yaw_acceleration, braking, slides)
                courses[course.tobytes()] = course
        return list(courses.values())

    def _turns(self, turn: float, rate: float, speed: float, goal: float) -> list[tuple[float, Limits, bool]]:
        """How one vehicle may turn, each with whether it slides: the turn leaves it nothing to brake with meanwhile.

        It may turn as asked, fall behind, and turn no further where braking leaves no grip for a turn. One that slides
        when it turns on the spot does so when it drives slowly, too.

        Args:
            turn: Heading change that is asked for [rad].
            rate: Its yaw rate [rad/s].
            speed: Its speed [m/s].
            goal: Speed that is asked for [m/s].
        """
        turns = [(turn, its, False) for its in dict.fromkeys((self.asked, self._followed_until(goal, speed)))]
        if self.slides and max(abs(goal), abs(speed)) <= SLOWLY * self.drive.reverse_share * self.drive.speed:
            turns.append((turn, self.followed_slowly, abs(goal) < abs(speed)))
        if goal < speed > self.brakes_straight_above:
            turns.append((rate * abs(rate) / (2 * self.asked.yaw_acceleration), self.asked, False))
        return turns

    def reverses(self, situation: Situation, scans: RecentScans, margin: float) -> int:
        """How one vehicle reverses, as straight as it can; -1 if it cannot.

        Args:
            situation: Of this vehicle alone.
            scans: Its recent scans.
            margin: Clearance that it keeps [m].
        """
        possible = np.flatnonzero(self.can_stop_after(situation, scans, REVERSE, margin))
        return REVERSE + int(min(possible, key=lambda action: abs(situation.turns[0, action]))) if len(possible) else -1

    def can_turn_round(self, situation: Situation) -> bool:
        """Whether one vehicle has room to turn round on the spot."""
        here = np.zeros((1, 1, 1, 3))
        return bool(scan_clearances(here, situation.points, AXLE).min() >= self.turning_circle)

    def first_safe(
        self,
        situation: Situation,
        scans: RecentScans,
        ranks: Array,
        clear: NDArray[np.bool_],
        slowly: NDArray[np.bool_],
        margin: float,
    ) -> int:
        """The best of one vehicle's admitted actions after which it can stop; -1 if there is none.

        It carries an action out slowly where it can stop after that and not after full speed.

        Args:
            situation: Of this vehicle alone.
            scans: Its recent scans.
            ranks: How good each action is held to be (6,).
            clear: Whether each action is admitted at full speed (6,).
            slowly: Whether it is admitted slowly (6,).
            margin: Clearance that it keeps up to the stop [m].
        """
        for action in np.argsort(-ranks, kind="stable").tolist():
            for manoeuvre, admitted in ((action, clear[action]), (action + SLOW, slowly[action])):
                if admitted and self.can_stop(situation, scans, manoeuvre, margin):
                    return int(manoeuvre)
        return -1

    def drive_clearances(self, situation: Situation) -> Array:
        """Clearances of one vehicle that drives on along the six turns (6, k) [m], for as long as braking takes."""
        at_speed = situation.speed[0] >= self.drive.speed
        followed = self.followed if at_speed else self.followed_changing
        return self._worse(situation, self.drive.speed, followed)

    def stop_clearances(self, situation: Situation) -> Array:
        """Clearances of one vehicle that brakes along the six turns (6, k) [m], for as long as that takes."""
        return self._worse(situation, 0.0, self._followed_until(0.0, float(situation.speed[0])))

    def _followed_until(self, goal: float, speed: float) -> Limits:
        """The limits that one vehicle follows while its speed changes to another [m/s]."""
        stands = goal == 0 and abs(speed) < SLIDING * self.drive.speed
        return self.followed_standing if stands else self.followed_changing

    def open_side(self, situation: Situation, target_bearing: float) -> int:
        """The side, 1 left or -1 right, on which one vehicle has to turn less for a clear path ahead.

        Directions near the target's cost less.
        """
        angles = np.radians(np.arange(-180.0, 181.0, 15.0))
        step = self.lengths.times(DISTANCE_STEP)
        distances = np.arange(step, self.lengths.look_ahead, step)
        along, turned = np.broadcast_arrays(distances, angles[:, None])
        poses = np.stack([along * np.cos(turned), along * np.sin(turned), turned], axis=-1)
        clearances = scan_clearances(poses[None], situation.points, self.footprint)[0].min(axis=-1)
        cost = np.abs(angles) + np.abs(wrap_angles(angles - target_bearing)) / 2
        cost = np.where(clearances >= self.lengths.margin, cost, np.inf)
        return 1 if cost[angles >= 0].min() <= cost[angles <= 0].min() else -1

    def _poses(self, s: Situation, goal: float, times: Array, limits: Limits) -> tuple[Array, Array]:
        """Poses along the six turns (n, 6, k, 3), and distances from each to the next (n, k) [m]."""
        goals = np.full(len(s.speed), goal)
        acceleration = limits.acceleration if goal > 0 else self.lengths.deceleration
        distances = ramp_distances(s.speed, goals, acceleration, times)
        return predicted_poses(s.yaw_rate, s.turns, distances, limits, times), distances

    def _keeps(self, s: Situation, margins: Array, turns_round: bool, limits: Limits) -> NDArray[np.bool_]:
        """`stays_clear` under the limits that the vehicle follows."""
        poses, distances = self._poses(s, self.drive.speed, self.times, limits)
        closing: Array = np.where(s.moving, self.lengths.box_speed, 0.0)
        clear: NDArray[np.bool_] = clear_courses(
            poses,
            np.cumsum(distances, axis=-1),
            s.points,
            closing,
            self.times,
            self.footprint,
            margins,
            self.stopping_distance(s.speed),
            self.lengths.look_ahead if turns_round else 0.0,
            self.turning_circle if turns_round else 0.0,
        )
        return clear

    def _worse(self, s: Situation, goal: float, followed: Limits) -> Array:
        """The smaller clearances of a vehicle that turns as asked and of one that falls behind (6, k) [m].

        Moving obstacles may have come nearer by then.
        """
        worse = np.full((s.turns.shape[1], len(self.stop_times)), np.inf)
        moving, nearer = np.where(s.moving[..., None], s.points, np.nan), self.lengths.box_speed * self.stop_times
        for limits in dict.fromkeys((self.asked, followed)):
            poses, _ = self._poses(s, goal, self.stop_times, limits)
            worse = np.minimum(worse, scan_clearances(poses, s.points, self.footprint)[0])
            if s.moving.any():
                came = scan_clearances(poses, moving, self.footprint)[0] - nearer
                worse = np.minimum(worse, np.maximum(came, 0.0))
        return worse
