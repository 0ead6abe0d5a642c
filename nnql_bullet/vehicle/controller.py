"""The vehicle's controller: it converts the decisions of an agent into wheel-speed commands.

A decision asks for a heading change and a speed. The controller plans profiles of heading, yaw rate and speed within
the vehicle's limits, and commands the wheel speeds that follow them, with proportional feedback of the heading.
"""

from dataclasses import dataclass
from math import inf
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.types import Period, Speed
from nnql_bullet.vehicle.profiles import sample_profile, sample_ramp, turn_profile, wheel_speeds
from nnql_bullet.vehicle.spec import Limits, VehicleSpec

COMMAND_RATE = 120.0
"""Wheel-speed commands per second [Hz], in every simulator."""


@options
class DriveOptions:
    """Options of the vehicle's controller."""

    decision_period: Period = 0.5
    """Time between decisions [s]; the paper states no length of "one step". A turn may last for several decisions."""
    speed: Speed = paper.SPEED
    """Speed of the rear-axle centre [m/s], unless a decision asks to stop, to reverse or to drive slowly."""
    reverse_share: Annotated[float, Field(gt=0, le=1)] = 0.25
    """Speed of reversing and of driving slowly, as a share of `speed`."""
    heading_gain: Annotated[float, Field(ge=0, le=1000)] = 4.0
    """Yaw rate per heading error [1/s]."""


class Goal(NamedTuple):
    """What a decision asks for."""

    heading_change: float
    """[rad]"""
    speed: float
    """[m/s], negative backwards."""


def own_speed(vehicle: VehicleSpec) -> float:
    """Returns the speed at which a vehicle drives unless told otherwise [m/s]."""
    return min(vehicle.limits.speed or inf, DriveOptions().speed)


@dataclass(frozen=True, slots=True)
class Plan:
    """Profiles of one control period with m wheel commands."""

    headings: Array
    """Heading since the start, at each command and at the end (m + 1,) [rad]."""
    yaw_rates: Array
    """Yaw rate at each command and at the end (m + 1,) [rad/s]."""
    speeds: Array
    """Speed at each command and at the end (m + 1,) [m/s], negative backwards."""
    feed_forward: Array
    """Mean speed [m/s] and mean yaw rate [rad/s] from each command to the next (m, 2)."""

    def until(self, command: int, later: "Plan") -> "Plan":
        """Returns this plan up to a command, and from there on a later one, which begins there."""
        k = command
        return Plan(
            np.concatenate([self.headings[:k], self.headings[k] + later.headings]),
            np.concatenate([self.yaw_rates[:k], later.yaw_rates]),
            np.concatenate([self.speeds[:k], later.speeds]),
            np.concatenate([self.feed_forward[:k], later.feed_forward]),
        )


def command_times(drive: DriveOptions) -> Array:
    """Computes the times of the m wheel commands of a control period, and of its end (m + 1,) [s].

    Raises:
        UserError: If the period is not a whole number of commands.
    """
    return np.arange(whole_steps(drive.decision_period, 1 / COMMAND_RATE) + 1) / COMMAND_RATE


def plan_period(
    yaw_rate: float, speed: float, heading_change: float, wanted_speed: float, limits: Limits, times: Array
) -> Plan:
    """Plans one control period.

    Args:
        yaw_rate: Yaw rate at the start [rad/s].
        speed: Speed at the start [m/s].
        heading_change: Wanted change of heading [rad].
        wanted_speed: Wanted speed [m/s], negative backwards.
        limits: Limits of the vehicle.
        times: See `command_times`.
    """
    bounds = limits.yaw_rate, limits.yaw_acceleration, limits.acceleration
    return Plan(*_profiles(yaw_rate, speed, heading_change, wanted_speed, *bounds, times))


@njit()
def _profiles(
    yaw_rate: float,
    speed: float,
    heading_change: float,
    wanted_speed: float,
    max_yaw_rate: float,
    yaw_acceleration: float,
    acceleration: float,
    times: Array,
) -> tuple[Array, Array, Array, Array]:
    """Computes the fields of a `Plan`, as a kernel."""
    headings, yaw_rates, speeds = np.empty(len(times)), np.empty(len(times)), np.empty(len(times))
    peak, rise, hold, fall = turn_profile(yaw_rate, heading_change, max_yaw_rate, yaw_acceleration)
    sample_profile(yaw_rate, peak, rise, hold, fall, times, yaw_rates, headings)
    sample_ramp(speed, wanted_speed, acceleration, times, speeds)
    feed_forward = np.empty((len(times) - 1, 2))
    for k in range(len(feed_forward)):
        feed_forward[k, 0] = (speeds[k] + speeds[k + 1]) / 2
        feed_forward[k, 1] = (headings[k + 1] - headings[k]) * COMMAND_RATE
    return headings, yaw_rates, speeds, feed_forward


def plan_late(
    yaw_rate: float, speed: float, goals: tuple[Goal, Goal], delay: int, limits: Limits, times: Array
) -> Plan:
    """Plans a control period in which the vehicle keeps to its former decision for a while.

    Args:
        yaw_rate: Yaw rate at the start [rad/s].
        speed: Speed at the start [m/s].
        goals: Of the former decision and of this one, the changes of heading from the start of the period.
        delay: Number of wheel commands that still follow the former decision.
        limits: Limits of the vehicle.
        times: See `command_times`.
    """
    former, now = goals
    kept = plan_period(yaw_rate, speed, *former, limits, times)
    change = now.heading_change - float(kept.headings[delay])
    rates, speeds = float(kept.yaw_rates[delay]), float(kept.speeds[delay])
    return kept.until(delay, plan_period(rates, speeds, change, now.speed, limits, times[: len(times) - delay]))


@njit()
def command_wheels(
    feed_forward: Array, heading_error: float, heading_gain: float, track: float, wheel_radius: float, speeds: Array
) -> None:
    """Computes the wheel speeds of k successive commands, with feedback of the heading at the first.

    Args:
        feed_forward: Rows of `Plan.feed_forward` (k, 2).
        heading_error: Wanted heading minus the present one [rad].
        heading_gain: Yaw rate per heading error [1/s].
        track: Distance between the drive wheels [m].
        wheel_radius: Radius of the drive wheels [m].
        speeds: Array to fill with left and right wheel speeds (k, 2) [rad/s].
    """
    correction = heading_gain * heading_error
    for k in range(len(speeds)):
        speed, yaw_rate = feed_forward[k]
        speeds[k, 0], speeds[k, 1] = wheel_speeds(speed, yaw_rate + correction, track, wheel_radius)


def whole_steps(period: float, time_step: float) -> int:
    """Computes the number of physics steps in a control period.

    Raises:
        UserError: If it is not a whole number of at least one.
    """
    steps = round(period / time_step)
    if steps < 1 or abs(steps * time_step - period) > 1e-9:
        raise UserError(f"a control period of {period:g} s is not a whole number of physics steps of {time_step:g} s")
    return steps
