"""Explains from recordings why two drives through one world ended differently: slip, tracking lag or a near miss.

Each control period has three ends. From the period's true start, the planned profile leads to the ideal end; the
measured rotation of the wheels leads to odometry's end (Siegwart and Nourbakhsh, Autonomous Mobile Robots, 5.2.4); the
recording gives the true end. The wheels lagged by the distance from the ideal end to odometry's, and slipped by the
distance from odometry's end to the true one.
"""

from dataclasses import dataclass
from math import hypot
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import TOWARD_TARGET, speed_scale
from nnql_bullet.geometry import Array
from nnql_bullet.recording import Recording
from nnql_bullet.vehicle.controller import COMMAND_RATE, DriveOptions
from nnql_bullet.vehicle.profiles import plan_turn, rolled_path, sample_ramp, sample_turn
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

Cause = Literal["slip", "tracking lag", "grazing contact", "other"]
CAUSES: tuple[Cause, ...] = ("slip", "tracking lag", "grazing contact", "other")

# Distances are those of the shipped vehicle; see `vehicle.scale`.
NOTABLE = 0.03
"""Smallest slip or lag of a control period that counts, over the distance driven in it."""
DRIFT = 0.1
"""Smallest distance at the first different decision of drives that drifted apart before it [m]."""
GRAZE = 0.05
"""Largest clearance of a near miss [m]."""
SAME_PLACE = 0.3
"""Distance below which vehicles are at the same place [m]."""


@dataclass(frozen=True, slots=True)
class PeriodErrors:
    """Lag, slip and distance driven of each control period (n,) [m]."""

    lag: Array
    """Distance from the ideal end to odometry's."""
    slip: Array
    """Distance from odometry's end to the true one."""
    distance: Array
    """Distance driven at the drive's speed."""


def period_errors(recording: Recording, vehicle: VehicleSpec, drive: DriveOptions) -> PeriodErrors:
    """Measures the lag and slip of every control period of a recording.

    Args:
        recording: The drive.
        vehicle: The vehicle that drove.
        drive: Options of its controller.
    """
    goals = drive.speed * speed_scale(recording.action, drive)
    n = len(recording.action)
    times = np.concatenate([[0.0], recording.sample_time])
    wheels = np.concatenate([np.zeros((1, 2)), recording.joint_angles[:, :2]]) * vehicle.wheel_radius
    rate, speed = 0.0, recording.world.start_speed(drive.speed)
    lag, slip, distance = np.zeros((3, n))
    for k in range(n):
        begin, end = recording.state_time[k], recording.state_time[k + 1]
        start, reached = recording.state_pose[k], recording.state_pose[k + 1]
        turn = plan_turn(rate, float(recording.heading_command[k]), vehicle.limits)
        instants = np.arange(round((end - begin) * COMMAND_RATE) + 1) / COMMAND_RATE
        instants[-1] = end - begin
        rates, headings = sample_turn(turn, instants)
        speeds = np.empty(len(instants))
        sample_ramp(speed, float(goals[k]), vehicle.limits.acceleration, instants, speeds)
        rate, speed = float(rates[-1]), float(speeds[-1])
        ways = np.diff(instants) * (speeds[:-1] + speeds[1:]) / 2
        ideal = rolled_path(start[2], ways, np.diff(headings))[-1]
        within = (times > begin - 1e-9) & (times < end + 1e-9)
        left, right = np.diff(wheels[within], axis=0).T
        known = rolled_path(start[2], (left + right) / 2, (right - left) / vehicle.track)[-1]
        lag[k], slip[k] = hypot(*(known - ideal)), hypot(*(reached[:2] - start[:2] - known))
        distance[k] = (end - begin) * drive.speed
    return PeriodErrors(lag, slip, distance)


def apart(first: Recording, second: Recording) -> tuple[Array, Array]:
    """Measures the distance between two drives through one world, at the decisions that both made.

    Returns:
        Times (m,) [s] and distances (m,) [m], without the last step of a drive, which may end early.
    """
    m = min(len(first.action), len(second.action))
    return first.state_time[:m], np.hypot(*(first.state_pose[:m, :2] - second.state_pose[:m, :2]).T)


def parting(first: Recording, second: Recording) -> int:
    """Finds the index of the first decision in which two drives differ; the number of common decisions if none differs.

    "Toward the target" is the same decision for every bearing of the target.
    """
    m = min(len(first.action), len(second.action))
    differ: NDArray[np.bool_] = first.action[:m] != second.action[:m]
    return int(np.argmax(differ)) if differ.any() else m


@dataclass(frozen=True, slots=True)
class Explanation:
    """The cause of different endings of two drives through one world, with its evidence."""

    cause: Cause
    time: float
    """Time of the first different decision, or of the end of the shorter drive if there is none [s]."""
    apart: float
    """Distance between the vehicles at that time [m]."""
    slip: float
    """Largest slip of a control period up to that time, over the distance driven in it."""
    lag: float
    """Largest lag of a control period up to that time, over the distance driven in it."""
    q_margin: float
    """Difference between the Q-values of the two different decisions, the smaller of both drives. NaN if a drive did
    not compute Q-values or no decision differs."""
    miss: float
    """Clearance of one drive at the place where the other collided [m]; infinite if it did not pass that place."""


def explain(first: Recording, second: Recording, vehicle: VehicleSpec, drive: DriveOptions) -> Explanation:
    """Explains why two drives through one world ended differently.

    The cause is slip or lag, the larger in total, if one of them exceeds `NOTABLE` in a control period before the first
    different decision, or if the drives are more than `DRIFT` apart by then. Otherwise it is a grazing contact if one
    drive passed closer than `GRAZE` to the obstacle that the other touched, and "other" in all other cases.

    Args:
        first: A drive.
        second: Another drive through the same world.
        vehicle: The vehicle that drove.
        drive: Options of its controller.
    """
    k = parting(first, second)
    until = max(k, 1)
    parts = [period_errors(recording, vehicle, drive) for recording in (first, second)]
    slip = max(float(np.max((part.slip / part.distance)[:until])) for part in parts)
    lag = max(float(np.max((part.lag / part.distance)[:until])) for part in parts)
    slipped = sum(float(np.sum(part.slip[:until])) for part in parts)
    lagged = sum(float(np.sum(part.lag[:until])) for part in parts)
    scale = length_scale(vehicle.footprint)
    miss = min(_miss(first, second, SAME_PLACE * scale), _miss(second, first, SAME_PLACE * scale))
    times, distances = apart(first, second)
    there = min(k, len(distances) - 1)
    cause: Cause = "other"
    if max(slip, lag) > NOTABLE or distances[there] > DRIFT * scale:
        cause = "slip" if slipped >= lagged else "tracking lag"
    elif miss < GRAZE * scale:
        cause = "grazing contact"
    return Explanation(
        cause=cause,
        time=float(times[there]),
        apart=float(distances[there]),
        slip=slip,
        lag=lag,
        q_margin=_q_margin(first, second, k),
        miss=miss,
    )


def _q_margin(first: Recording, second: Recording, k: int) -> float:
    """Computes `Explanation.q_margin` of two drives that decide differently in decision k."""
    if k == min(len(first.action), len(second.action)):
        return float("nan")
    one, other = int(first.action[k]), int(second.action[k])
    if max(one, other) >= TOWARD_TARGET:  # only the five turns have values
        return float("nan")
    q_one, q_other = first.q_values[k], second.q_values[k]
    return float(min(q_one[one] - q_one[other], q_other[other] - q_other[one]))


def _miss(touched: Recording, through: Recording, near_by: float) -> float:
    """Finds the clearance of one drive within some metres of where the other collided; infinite if it was not there."""
    if not touched.contact[-1]:
        return float("inf")
    place = touched.state_pose[-1, :2]
    steps = len(through.action)
    near = np.hypot(*(through.sample_pose[:, :2] - place).T) < near_by
    step = np.searchsorted(through.state_time, through.sample_time[near] - 1e-9, side="left") - 1
    return float(np.min(through.clearance[np.clip(step, 0, steps - 1)], initial=np.inf))
