"""One vehicle in contact physics, driven one control period at a time."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from math import cos, exp, hypot, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.blocks import clearance_among
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Pose, as_rows, wrap_angle
from nnql_bullet.jit import njit
from nnql_bullet.sim.base import SAMPLE_EVERY, Sample
from nnql_bullet.sim.physics import CONTACT_MARGIN, VehiclePhysics, rear_axle
from nnql_bullet.vehicle.controller import (
    COMMAND_RATE,
    DriveOptions,
    Goal,
    Plan,
    command_times,
    command_wheels,
    plan_late,
    plan_period,
    whole_steps,
)
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec


@dataclass(frozen=True, slots=True)
class VehicleMotion:
    """The motion of one vehicle in one control period: a row of `sim.base.Motion`."""

    pose: Pose
    yaw_rate: float
    speed: float
    duration: float
    path_length: float
    clearance: float
    heading_error: float
    touching: bool
    at_target: bool
    overturned: bool


class _Episode(NamedTuple):
    """Numbers of an episode for `_look_and_command`, which takes them as one record: each argument costs time."""

    ahead: float
    """Position of the engine's frame ahead of the rear axle [m]."""
    left: float
    """Its position to the left of the rear-axle centre [m]."""
    up: float
    """Its position above the rear axle [m]."""
    reach: float
    """Largest approach of vehicle and solid from one look to the next [m]."""
    heading_gain: float
    """[1/s]"""
    track: float
    """[m]"""
    wheel_radius: float
    """[m]"""
    target_x: float
    """[m]"""
    target_y: float
    """[m]"""
    target_radius: float
    """[m]"""


OVERTURNED = pi / 3
"""Angle between the vehicle's upward axis and the vertical beyond which it has tipped over [rad]: it falls on its side,
nose or roof. Only wheels touch the ground, so nothing stops a fall before this angle."""
_UPRIGHT = cos(OVERTURNED)

_RECORD = np.dtype([(name, np.float64) for name in _Episode._fields], align=True)

X, Y, YAW, PATH_LENGTH, SMALLEST, BOUND = range(6)
"""Columns of the progress of a control period: pose of the rear-axle centre, length of its path, smallest clearance so
far, and a lower bound on the clearance now [m, rad]."""


class ContactEngine(VehiclePhysics):
    """One vehicle in one world of contact physics, driven one control period at a time.

    `sim.engines.ContactSimulator` makes a simulator of n of these.
    """

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions, time_step: float) -> None:
        footprint, eye = vehicle.footprint, hypot(*vehicle.sensor.position[:2])
        farthest = hypot(abs(footprint.x) + footprint.half_length, abs(footprint.y) + footprint.half_width)
        # With slip; no point moves away from the rear-axle centre.
        travel = 1.1 * drive.speed * drive.decision_period + CONTACT_MARGIN
        super().__init__(vehicle, time_step, max(farthest, eye + vehicle.sensor.range) + travel)
        self.drive = drive
        self._delay = round(vehicle.delays.decision * COMMAND_RATE)
        if self._delay >= whole_steps(drive.decision_period, 1 / COMMAND_RATE):
            raise UserError(
                f"a decision that takes effect after {vehicle.delays.decision:g} s comes too late for a decision "
                f"period of {drive.decision_period:g} s; set a shorter latency or a longer period"
            )
        self._wheel_response = 1.0 - exp(-1 / COMMAND_RATE / vehicle.delays.wheels) if vehicle.delays.wheels else 1.0
        self._steps_per_command = whole_steps(1 / COMMAND_RATE, time_step)
        self._command_times = command_times(drive)
        sensor = vehicle.sensor
        self._rays = np.column_stack([sensor.directions, np.zeros(sensor.rays)]) * sensor.range
        self._blind = np.flatnonzero(~sensor.seen)
        self._begins, self._ends = np.empty_like(self._rays), np.empty_like(self._rays)
        self._start_at(drive.speed)
        fastest = drive.speed + vehicle.limits.yaw_rate * farthest
        # No point of the vehicle moves farther than this from one look to the next, slip included [m].
        self._reach = 1.1 * fastest * SAMPLE_EVERY / COMMAND_RATE + CONTACT_MARGIN
        self._footprint = as_rows((footprint,))[0]

    @abstractmethod
    def sample(self) -> Sample:
        """The vehicle now."""

    def reset(self, world: WorldSpec) -> None:
        """Builds the world anew and puts the vehicle on its start, at rest or at the drive's speed."""
        self.place(world, world.start, world.start_speed(self.drive.speed))
        self._start_at(world.start_speed(self.drive.speed))

    def place(self, world: WorldSpec, pose: Pose, speed: float, height: float = 0.0, ground: bool = True) -> None:
        """See `VehiclePhysics.place`. The controller starts at the drive's speed, whatever the vehicle's speed is."""
        super().place(world, pose, speed, height, ground)
        self._start_at(self.drive.speed)
        self._sensor = np.subtract(self.vehicle.sensor.position, self._com)
        at = self.pose()
        self._clearance = clearance_among(at.x, at.y, at.yaw, self._footprint, self._solids, self._bounds)
        fastest_patrol = max((patrol.speed for patrol in world.patrols), default=0.0)
        episode = _Episode(
            ahead=self._com[0],
            left=self._com[1],
            up=self._com[2],
            reach=self._reach + fastest_patrol * SAMPLE_EVERY / COMMAND_RATE,
            heading_gain=self.drive.heading_gain,
            track=self.vehicle.track,
            wheel_radius=self.vehicle.wheel_radius,
            target_x=world.targets[0][0],
            target_y=world.targets[0][1],
            target_radius=world.target_radius,
        )
        self._episode = np.array([episode], dtype=_RECORD)

    def _start_at(self, speed: float) -> None:
        """Lets the controller start straight ahead at a speed [m/s]."""
        self._planned_yaw_rate, self._planned_speed = 0.0, speed
        self._former = Goal(0.0, speed)
        self._lagged = np.full(2, speed / self.vehicle.wheel_radius)

    def _plan(self, goal: Goal) -> Plan:
        """Plans a control period; what the former decision still asks for comes first where decisions are late."""
        start = self._planned_yaw_rate, self._planned_speed
        if not self._delay:
            return plan_period(*start, *goal, self.vehicle.limits, self._command_times)
        return plan_late(*start, (self._former, goal), self._delay, self.vehicle.limits, self._command_times)

    def _lagging(self, speeds: Array) -> Array:
        """Returns the wheel speeds (k, 2) [rad/s] that the wheels are driven at where they lag behind these."""
        followed = np.empty_like(speeds)
        for k, wanted in enumerate(speeds):
            self._lagged = self._lagged + self._wheel_response * (wanted - self._lagged)
            followed[k] = self._lagged
        return followed

    def advance(
        self,
        heading_change: float,
        trace: list[Sample] | None = None,
        speed_scale: float = 1.0,
        look: Callable[[], None] | None = None,
    ) -> VehicleMotion:
        """Drives one control period, or up to the first contact, the target, or a fall.

        The controller sets the wheel speeds 120 times a second, and feeds the heading back 30 times a second. Contact
        is checked at every physics step where it is possible, the target after every wheel command near it, and
        30 times a second whether the vehicle has tipped over.

        Args:
            heading_change: Wanted change from the present yaw [rad], positive to the left.
            trace: Receives samples, if given.
            speed_scale: Wanted speed as a share of the drive's, from -1 to 1; negative backwards.
            look: Called after every physics step; it may read the engine, not change it.
        """
        first_step, (position, orientation) = self._steps, self._frame()
        begin = Pose(*rear_axle(position, orientation, *self._com))
        self._keep_near(begin)
        goal = Goal(heading_change, speed_scale * self.drive.speed)
        plan = self._plan(goal)
        headings, feed_forward = begin.yaw + plan.headings, plan.feed_forward
        progress = np.array([begin.x, begin.y, begin.yaw, 0.0, self._clearance, self._clearance])
        speeds = np.empty((SAMPLE_EVERY, 2))
        episode, footprint, solids, bounds = self._episode, self._footprint, self._solids, self._bounds
        command, last, touching = 0, len(feed_forward), False
        while True:
            near, at_target, overturned, commands = _look_and_command(
                position,
                orientation,
                progress,
                headings,
                feed_forward,
                command,
                speeds,
                episode,
                footprint,
                solids,
                bounds,
            )
            over = command > 0 and (touching or at_target or overturned)
            if trace is not None and (over or command % SAMPLE_EVERY == 0 < command):
                trace.append(self.sample())
            if over or command == last:
                break
            driven = self._lagging(speeds[:commands]) if self._wheel_response < 1.0 else speeds[:commands]
            carried_out, touching = self._carry_out(driven.tolist(), near, look)
            command += carried_out
            if not near:
                self._move_patrols()
            position, orientation = self._frame()
        x, y, yaw, path_length, smallest, _ = progress.tolist()
        self._clearance = clearance_among(x, y, yaw, footprint, solids, bounds)
        self._planned_yaw_rate, self._planned_speed = float(plan.yaw_rates[command]), float(plan.speeds[command])
        self._former = Goal(heading_change - float(plan.headings[command]), goal.speed)
        return VehicleMotion(
            pose=Pose(x, y, yaw),
            yaw_rate=self.yaw_rate(),
            speed=self.speed(),
            duration=(self._steps - first_step) * self.time_step,
            path_length=path_length,
            clearance=0.0 if touching else smallest,
            heading_error=wrap_angle(begin.yaw + heading_change - yaw),
            touching=touching,
            at_target=at_target and not touching and not overturned,
            overturned=overturned and not touching,
        )

    def retarget(self, target: Point) -> None:
        """Gives the vehicle another target x, y [m]; its radius stays."""
        self._episode["target_x"], self._episode["target_y"] = target

    def scan(self) -> Array:
        """Distances of the rays (rays,) [m]. The sensor pitches and rolls with the chassis."""
        position, orientation = self._frame()
        _move_rays(position, orientation, self._sensor, self._rays, self._begins, self._ends)
        distances = self._cast(self._begins, self._ends)
        distances[self._blind] = self.vehicle.sensor.range
        return distances

    def _carry_out(self, speeds: list[list[float]], near: bool, look: Callable[[], None] | None) -> tuple[int, bool]:
        """Carries out wheel commands, up to the first contact.

        Args:
            speeds: Speeds of left and right wheel of each command [rad/s].
            near: Whether contact is possible. If it is not, the patrols may stay where they were.
            look: Called after every physics step, if given.

        Returns:
            The number of commands carried out, and whether there was contact.
        """
        self._engage_motors()
        if not near and look is None:
            self._drive_freely(speeds)
            return len(speeds), False
        for number, pair in enumerate(speeds, 1):
            self._command(pair)
            for _ in range(self._steps_per_command):
                self._step_and_move()
                if look:
                    look()
                if near and self.touching():
                    return number, True
        return len(speeds), False

    def _drive_freely(self, speeds: list[list[float]]) -> None:
        """Carries out wheel commands during which no contact is possible; the patrols stay where they were."""
        for pair in speeds:
            self._command(pair)
            for _ in range(self._steps_per_command):
                self._step()


@njit()
def _look_and_command(
    position: tuple[float, float, float],
    orientation: tuple[float, float, float, float],
    progress: Array,
    headings: Array,
    feed_forward: Array,
    command: int,
    speeds: Array,
    episode: NDArray[np.void],
    footprint: Array,
    solids: Array,
    bounds: Array,
) -> tuple[bool, bool, bool, int]:
    """Finds out where the vehicle is, and computes the wheel commands until the next look.

    From one look to the next the clearance falls by `reach` at most. So it is computed only where it may have fallen to
    the reach, or below the smallest so far.

    Args:
        position: Origin of the engine's frame [m].
        orientation: Its quaternion: x, y, z, w.
        progress: Updated: the columns `X` to `BOUND` (6,).
        headings: Wanted headings at each command and at the end (m + 1,) [rad].
        feed_forward: See `controller.Plan` (m, 2).
        command: Index of the next command.
        speeds: Filled with left and right wheel speeds (k, 2) [rad/s] of the commands until the next look.
        episode: An `_Episode` as a record (1,).
        footprint: A row (7,) of `as_rows`.
        solids: Rows (n, 7) of `as_rows`, as they are now.
        bounds: Their `bounds_of` (k, 4) [m].

    Returns:
        Whether contact is possible before the next look, whether the target is reached, whether the vehicle has tipped
        over, and the number of commands until the next look, which is 1 where they might reach the target.
    """
    e = episode[0]
    x, y, yaw = rear_axle(position, orientation, e.ahead, e.left, e.up)
    progress[PATH_LENGTH] += np.hypot(x - progress[X], y - progress[Y])
    progress[X], progress[Y], progress[YAW] = x, y, yaw
    progress[BOUND] -= e.reach
    if progress[BOUND] <= max(progress[SMALLEST], e.reach):
        progress[BOUND] = clearance_among(x, y, yaw, footprint, solids, bounds)
        progress[SMALLEST] = min(progress[SMALLEST], progress[BOUND])
    to_target = np.hypot(x - e.target_x, y - e.target_y) - e.target_radius
    commands = min(len(speeds) if to_target > e.reach else 1, len(feed_forward) - command)
    heading_error = wrap_angle(headings[command] - yaw)
    command_wheels(
        feed_forward[command : command + commands],
        heading_error,
        e.heading_gain,
        e.track,
        e.wheel_radius,
        speeds[:commands],
    )
    qx, qy, _, _ = orientation
    overturned = 1 - 2 * (qx * qx + qy * qy) < _UPRIGHT
    return progress[BOUND] <= e.reach, to_target <= 0.0, overturned, commands


@njit()
def _move_rays(
    position: tuple[float, float, float],
    orientation: tuple[float, float, float, float],
    sensor: Array,
    rays: Array,
    begins: Array,
    ends: Array,
) -> None:
    """Computes where rays begin and end in the world.

    Args:
        position: Origin of the engine's frame [m].
        orientation: Its quaternion: x, y, z, w.
        sensor: Position of the sensor from that origin, in the chassis frame (3,) [m].
        rays: Rays in the chassis frame (n, 3) [m].
        begins: Filled with where they begin (n, 3) [m].
        ends: Filled with where they end (n, 3) [m].
    """
    ahead, left, up = _rotated(sensor[0], sensor[1], sensor[2], *orientation)
    x, y, z = position[0] + ahead, position[1] + left, position[2] + up
    for i in range(len(rays)):
        dx, dy, dz = _rotated(rays[i, 0], rays[i, 1], rays[i, 2], *orientation)
        begins[i, 0], begins[i, 1], begins[i, 2] = x, y, z
        ends[i, 0], ends[i, 1], ends[i, 2] = x + dx, y + dy, z + dz


@njit()
def _rotated(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> tuple[float, float, float]:
    """Rotates a vector by a unit quaternion: v + 2 w (q x v) + 2 q x (q x v)."""
    tx, ty, tz = 2 * (qy * z - qz * y), 2 * (qz * x - qx * z), 2 * (qx * y - qy * x)
    return x + qw * tx + qy * tz - qz * ty, y + qw * ty + qz * tx - qx * tz, z + qw * tz + qx * ty - qy * tx
