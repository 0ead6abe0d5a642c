"""The ideal twin: the same drive, sensors and endings as contact physics, but wheels that never slip or lag.

The vehicle follows the yaw-rate profile exactly, as a unicycle of constant speed (Siegwart and Nourbakhsh, Autonomous
Robots, 3.2). The footprint collides as the oriented box it is, looked at after every wheel command.
"""

import numba
import numpy as np

from nnql_bullet import paper
from nnql_bullet.geometry import Array, Pose, as_rows, clearance_at, wrap_angle
from nnql_bullet.sensing import Scan, ray_angles, scan_from
from nnql_bullet.sim.base import COMMAND_RATE, SAMPLE_EVERY, DriveOptions, Motion, Sample, whole_steps
from nnql_bullet.vehicle.drive import plan_turn, sample_turn, wheel_speeds
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec


class TwinSimulator:
    """One ideal vehicle in one world. See `sim.base.Simulator` for the contract."""

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.vehicle = vehicle
        self.drive = drive
        self.control_period = drive.decision_period
        commands = whole_steps(drive.decision_period, 1 / COMMAND_RATE)
        self._command_times = np.arange(commands + 1) / COMMAND_RATE
        self._footprint = as_rows((vehicle.footprint,))[0]
        self._ray_angles = ray_angles()
        self._caster = np.array([vehicle.wheelbase + vehicle.caster_trail, vehicle.caster_trail, vehicle.caster_radius])

    def close(self) -> None:
        """There is nothing to free."""

    def reset(self, world: WorldSpec) -> None:
        """Puts the vehicle on the world's start, at the drive's speed."""
        self._world = world
        self._pose = world.start
        self._yaw_rate = 0.0
        self._time = 0.0
        self._joints = np.zeros(4)

    def advance(self, heading_change: float, trace: list[Sample] | None = None) -> Motion:
        """Follows the turn's profile for one control period, or up to the first contact or the target."""
        begin, speed, world = self._pose, self.drive.speed, self._world
        turn = plan_turn(self._yaw_rate, heading_change, self.vehicle.limits)
        rates, headings = sample_turn(turn, self._command_times)
        poses, clearances, event = _follow(
            np.array([begin.x, begin.y, begin.yaw]),
            headings,
            speed / COMMAND_RATE,
            self._footprint,
            world.solids,
            np.array([*world.target, world.target_radius]),
        )
        commands = len(poses) - 1
        if trace is not None:
            self._extend(trace, poses, np.diff(headings[: commands + 1]) * COMMAND_RATE, over=event != 0)
        x, y, yaw = poses[-1].tolist()
        self._pose = Pose(x, y, wrap_angle(yaw))
        self._yaw_rate = float(rates[commands])
        self._time += commands / COMMAND_RATE
        return Motion(
            pose=self._pose,
            speed=speed,
            yaw_rate=self._yaw_rate,
            wheel_speeds=wheel_speeds(speed, self._yaw_rate, self.vehicle.track, self.vehicle.wheel_radius),
            duration=commands / COMMAND_RATE,
            path_length=speed * commands / COMMAND_RATE,
            clearance=float(clearances.min()),
            heading_error=wrap_angle(begin.yaw + heading_change - yaw),
            touching=event == _TOUCHING,
            at_target=event == _AT_TARGET,
        )

    def pose(self) -> Pose:
        """Of the rear-axle centre."""
        return self._pose

    def scan(self) -> Scan:
        """Rays from the sensor, by the slab method."""
        ahead, left, _ = self.vehicle.sensor
        x, y, yaw = self._pose.x, self._pose.y, self._pose.yaw
        origin_x, origin_y = x + np.cos(yaw) * ahead - np.sin(yaw) * left, y + np.sin(yaw) * ahead + np.cos(yaw) * left
        return scan_from(cast_rays(origin_x, origin_y, self._ray_angles + yaw, self._world.solids, paper.SENSOR_RANGE))

    def _extend(self, trace: list[Sample], poses: Array, yaw_rates: Array, over: bool) -> None:
        """Samples between the decisions; the joints turn as the wheels roll."""
        for command, yaw_rate in enumerate(yaw_rates.tolist(), 1):
            left, right = wheel_speeds(self.drive.speed, yaw_rate, self.vehicle.track, self.vehicle.wheel_radius)
            swivel, roll = _caster_rates(self._joints[2], self.drive.speed, yaw_rate, *self._caster)
            self._joints += np.array([left, right, swivel, roll]) / COMMAND_RATE
            if command % SAMPLE_EVERY == 0 or (over and command == len(yaw_rates)):
                x, y, yaw = poses[command].tolist()
                a, b, c, d = self._joints.tolist()
                time = self._time + command / COMMAND_RATE
                trace.append(Sample(time, Pose(x, y, wrap_angle(yaw)), (a, b, c, d), (left, right)))


_TOUCHING, _AT_TARGET = 1, 2


@numba.njit(cache=True)
def _follow(
    pose: Array, headings: Array, stride: float, footprint: Array, solids: Array, target: Array
) -> tuple[Array, Array, int]:
    """Moves along `headings` (k + 1,) [rad] by `stride` [m] each, up to the first contact or the target.

    Returns:
        Poses (j + 1, 3) from the start to the last reached, clearances (j + 1,) [m] there, and what ended it.
    """
    poses, clearances = np.empty((len(headings), 3)), np.empty(len(headings))
    poses[0] = pose
    clearances[0] = clearance_at(pose[0], pose[1], pose[2], footprint, solids)
    for k in range(1, len(headings)):
        # The chord of an arc points along its middle heading.
        middle = pose[2] + (headings[k - 1] + headings[k]) / 2
        poses[k, 0] = poses[k - 1, 0] + stride * np.cos(middle)
        poses[k, 1] = poses[k - 1, 1] + stride * np.sin(middle)
        poses[k, 2] = pose[2] + headings[k]
        clearances[k] = clearance_at(poses[k, 0], poses[k, 1], poses[k, 2], footprint, solids)
        if clearances[k] <= 0.0:
            return poses[: k + 1], clearances[: k + 1], _TOUCHING
        if np.hypot(poses[k, 0] - target[0], poses[k, 1] - target[1]) <= target[2]:
            return poses[: k + 1], clearances[: k + 1], _AT_TARGET
    return poses, clearances, 0


@numba.njit(cache=True)
def cast_rays(x: float, y: float, angles: Array, boxes: Array, sensor_range: float) -> Array:
    """Where rays first meet a box: `geometry.ray_distances` as a kernel, one box at a time.

    Args:
        x: Where the rays start [m].
        y: Where the rays start [m].
        angles: Their directions in the world (m,) [rad].
        boxes: Rows (n, 6) of `geometry.as_rows`.
        sensor_range: What a ray that meets nothing reads [m].

    Returns:
        Distances (m,) [m].
    """
    distances = np.full(len(angles), sensor_range)
    for box in boxes:
        dx, dy = x - box[0], y - box[1]
        start_x, start_y = box[4] * dx + box[5] * dy, box[4] * dy - box[5] * dx
        gap_x, gap_y = max(abs(start_x) - box[2], 0.0), max(abs(start_y) - box[3], 0.0)
        if np.hypot(gap_x, gap_y) >= sensor_range:
            continue
        for i, angle in enumerate(angles):
            c, s = np.cos(angle), np.sin(angle)
            enter_x, leave_x = _slab(start_x, box[4] * c + box[5] * s, box[2])
            enter_y, leave_y = _slab(start_y, box[4] * s - box[5] * c, box[3])
            enter = max(enter_x, enter_y, 0.0)
            if enter <= min(leave_x, leave_y) and enter < distances[i]:
                distances[i] = enter
    return distances


@numba.njit(cache=True)
def _slab(start: float, direction: float, half: float) -> tuple[float, float]:
    """Where a ray enters and leaves the slab from -half to half; an empty interval if it never does."""
    if direction == 0.0:
        return (-np.inf, np.inf) if abs(start) <= half else (np.inf, -np.inf)
    first, second = (-half - start) / direction, (half - start) / direction
    return min(first, second), max(first, second)


@numba.njit(cache=True)
def _caster_rates(
    swivel: float, speed: float, yaw_rate: float, ahead: float, trail: float, radius: float
) -> tuple[float, float]:
    """Rates [rad/s] of the swivel angle and of the wheel of a trailing caster that rolls without slip.

    The swivel axis, `ahead` of the axle, moves at (speed, yaw_rate * ahead); the wheel, `trail` behind it along the
    fork, may not move sideways.
    """
    along = speed * np.cos(swivel) + yaw_rate * ahead * np.sin(swivel)
    across = yaw_rate * ahead * np.cos(swivel) - speed * np.sin(swivel)
    return across / trail - yaw_rate, along / radius
