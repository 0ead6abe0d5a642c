"""Why a drive went another way: what its recording says of slip, lag and near misses.

Each control period of a recording is taken apart. From its true start, the drive's profile leads to an ideal end; the
turning of the wheels, taken at their word, leads to the end that odometry knows (Siegwart and Nourbakhsh, Autonomous
Mobile Robots, 5.2.4); the vehicle ended where it did. From the ideal end to odometry's the wheels lagged; from there to
the true end they slipped.
"""

from dataclasses import dataclass
from math import hypot
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import TOWARD_TARGET
from nnql_bullet.geometry import Array
from nnql_bullet.recording import Recording
from nnql_bullet.vehicle.controller import COMMAND_RATE
from nnql_bullet.vehicle.profiles import plan_turn, rolled_path, sample_turn
from nnql_bullet.vehicle.spec import VehicleSpec

Cause = Literal["slip", "tracking lag", "grazing contact", "other"]
CAUSES: tuple[Cause, ...] = ("slip", "tracking lag", "grazing contact", "other")

NOTABLE = 0.03
"""What a control period may end off for its way, before it counts as slip or lag: a share. The shipped vehicle keeps to
0.016 on a floor that it grips."""
DRIFT = 0.1
"""Drives that are farther apart than this when they part have drifted there, little by little [m]."""
GRAZE = 0.05
"""A miss by less is as good as a hit [m]."""
TOGETHER = 0.3
"""Vehicles closer than this are at the same place [m]."""


@dataclass(frozen=True, slots=True)
class Departures:
    """How far each control period ended from where it should have (n,) [m]."""

    lag: Array
    """From the ideal end to odometry's."""
    slip: Array
    """From odometry's end to the true one."""
    way: Array
    """What was driven."""


def departures(recording: Recording, vehicle: VehicleSpec, speed: float) -> Departures:
    """Takes the control periods of a recording apart.

    Args:
        recording: The drive.
        vehicle: What drove.
        speed: Of the drive [m/s].
    """
    n = len(recording.action)
    times = np.concatenate([[0.0], recording.sample_time])
    wheels = np.concatenate([np.zeros((1, 2)), recording.joint_angles[:, :2]]) * vehicle.wheel_radius
    rate, lag, slip, way = 0.0, np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(n):
        begin, end = recording.state_time[k], recording.state_time[k + 1]
        start, reached = recording.state_pose[k], recording.state_pose[k + 1]
        turn = plan_turn(rate, float(recording.heading_command[k]), vehicle.limits)
        instants = np.arange(round((end - begin) * COMMAND_RATE) + 1) / COMMAND_RATE
        instants[-1] = end - begin
        rates, headings = sample_turn(turn, instants)
        rate = float(rates[-1])
        ideal = rolled_path(start[2], np.diff(instants) * speed, np.diff(headings))[-1]
        within = (times > begin - 1e-9) & (times < end + 1e-9)
        left, right = np.diff(wheels[within], axis=0).T
        known = rolled_path(start[2], (left + right) / 2, (right - left) / vehicle.track)[-1]
        lag[k], slip[k] = hypot(*(known - ideal)), hypot(*(reached[:2] - start[:2] - known))
        way[k] = (end - begin) * speed
    return Departures(lag, slip, way)


def apart(first: Recording, second: Recording) -> tuple[Array, Array]:
    """How far two drives through one world are apart, at the decisions that both came to.

    Returns:
        Times (m,) [s] and distances (m,) [m]; the last step of a drive, which its ending cuts short, is left out.
    """
    m = min(len(first.action), len(second.action))
    return first.state_time[:m], np.hypot(*(first.state_pose[:m, :2] - second.state_pose[:m, :2]).T)


def parting(first: Recording, second: Recording) -> int:
    """The first decision in which two drives differ; the number of common ones if there is none.

    "Toward the target" turns by what bearing it finds, so it counts as the same decision.
    """
    m = min(len(first.action), len(second.action))
    differ: NDArray[np.bool_] = first.action[:m] != second.action[:m]
    return int(np.argmax(differ)) if differ.any() else m


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why two drives through one world ended differently."""

    cause: Cause
    time: float
    """When they decided differently for the first time, or when the first of them ended [s]."""
    apart: float
    """How far apart they were then [m]."""
    slip: float
    """The largest up to then, as a share of a control period's way."""
    lag: float
    """Likewise."""
    q_margin: float
    """How much the network preferred its choice over the other's, where they decided differently: the smaller of both;
    NaN where one found the state safe and did not ask it, or they never did."""
    miss: float
    """Clearance of the drive that got through where the other touched [m]; infinite where nothing was touched there."""


def explain(first: Recording, second: Recording, vehicle: VehicleSpec, speed: float) -> Explanation:
    """The first of the causes that holds: slip or lag before the drives part, a near miss, or something else.

    Slip and lag count if a control period shows much of one, or if the drives have drifted apart; of the two, what adds
    up to more. "Other" is what is left: decisions that hang on differences too small to be either.
    """
    k = parting(first, second)
    until = max(k, 1)
    parts = [departures(recording, vehicle, speed) for recording in (first, second)]
    slip = max(float(np.max((part.slip / part.way)[:until])) for part in parts)
    lag = max(float(np.max((part.lag / part.way)[:until])) for part in parts)
    slipped = sum(float(np.sum(part.slip[:until])) for part in parts)
    lagged = sum(float(np.sum(part.lag[:until])) for part in parts)
    miss = min(_miss(first, second), _miss(second, first))
    times, distances = apart(first, second)
    there = min(k, len(distances) - 1)
    cause: Cause = "other"
    if max(slip, lag) > NOTABLE or distances[there] > DRIFT:
        cause = "slip" if slipped >= lagged else "tracking lag"
    elif miss < GRAZE:
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
    """How close the call was that two drives made differently in decision k."""
    if k == min(len(first.action), len(second.action)):
        return float("nan")
    one, other = int(first.action[k]), int(second.action[k])
    if TOWARD_TARGET in (one, other):
        return float("nan")
    q_one, q_other = first.q_values[k], second.q_values[k]
    return float(min(q_one[one] - q_one[other], q_other[other] - q_other[one]))


def _miss(touched: Recording, through: Recording) -> float:
    """By how little one drive missed what the other touched, if it came by the same place [m]."""
    if not touched.contact[-1]:
        return float("inf")
    place = touched.state_pose[-1, :2]
    steps = len(through.action)
    near = np.hypot(*(through.sample_pose[:, :2] - place).T) < TOGETHER
    step = np.searchsorted(through.state_time, through.sample_time[near] - 1e-9, side="left") - 1
    return float(np.min(through.clearance[np.clip(step, 0, steps - 1)], initial=np.inf))
