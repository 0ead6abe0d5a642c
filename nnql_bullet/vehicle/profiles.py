"""Yaw-rate and speed profiles within the vehicle's limits, for a commanded heading change and speed.

In a turn the yaw rate rises to a peak, stays there, and falls to zero when the heading change is reached: the
trapezoidal velocity profile of Lynch and Park, Modern Robotics, 9.2.2, applied to the yaw rate. It is the quickest turn
within the limits on yaw rate and yaw acceleration. Meanwhile the speed ramps to the commanded speed at the limit on
acceleration. If a control period ends before its profile, the next one starts at the yaw rate and speed reached.
"""

from dataclasses import dataclass
from math import copysign, sqrt

import numpy as np

from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.vehicle.spec import Limits


@dataclass(frozen=True, slots=True)
class Turn:
    """A yaw-rate profile: from `start` to `peak` in `rise`, at `peak` for `hold`, to zero in `fall` [rad/s, s]."""

    start: float
    peak: float
    rise: float
    hold: float
    fall: float

    @property
    def duration(self) -> float:
        """Time until the yaw rate is zero [s]."""
        return self.rise + self.hold + self.fall


def plan_turn(yaw_rate: float, heading_change: float, limits: Limits) -> Turn:
    """Plans the quickest turn by a heading change that ends with a yaw rate of zero.

    Args:
        yaw_rate: Yaw rate at the start [rad/s].
        heading_change: [rad]
        limits: The vehicle's limits.
    """
    return Turn(yaw_rate, *turn_profile(yaw_rate, heading_change, limits.yaw_rate, limits.yaw_acceleration))


@njit()
def turn_profile(
    yaw_rate: float, heading_change: float, max_rate: float, acceleration: float
) -> tuple[float, float, float, float]:
    """Computes peak, rise, hold and fall for `plan_turn`, as a kernel.

    At acceleration `a`, the ramps to the peak and to zero cover (2 peak^2 - start^2) / 2a; the hold covers the rest.
    """
    a = acceleration
    # The peak has the sign of the heading change that remains if the vehicle stops turning now.
    side = copysign(1.0, heading_change - yaw_rate * abs(yaw_rate) / (2 * a))
    start, change = side * yaw_rate, side * heading_change
    peak = min(sqrt(max(a * change + start * start / 2, 0.0)), max_rate)
    hold = 0.0
    if peak > 0:
        hold = max((change - (2 * peak * peak - start * start) / (2 * a)) / peak, 0.0)
    return side * peak, abs(peak - start) / a, hold, peak / a


def sample_turn(turn: Turn, times: Array) -> tuple[Array, Array]:
    """Samples a turn: yaw rates [rad/s] and headings since its start [rad] at `times` (n,) [s]."""
    rates, headings = np.empty(len(times)), np.empty(len(times))
    sample_profile(turn.start, turn.peak, turn.rise, turn.hold, turn.fall, times, rates, headings)
    return rates, headings


def turn_headings(yaw_rates: Array, heading_changes: Array, limits: Limits, times: Array) -> Array:
    """Samples the headings of several planned turns, since their start (..., k) [rad].

    Args:
        yaw_rates: Yaw rates at the start (...) [rad/s].
        heading_changes: (...) [rad]
        limits: The vehicle's limits.
        times: (k,) [s]
    """
    yaw_rates, heading_changes = np.broadcast_arrays(yaw_rates, heading_changes)
    headings: Array = _sample_profiles(
        yaw_rates.ravel(), heading_changes.ravel(), limits.yaw_rate, limits.yaw_acceleration, times
    )
    return headings.reshape(*yaw_rates.shape, len(times))


def rolled_path(yaw: float, lengths: Array, heading_changes: Array) -> Array:
    """Computes the positions after each of several arcs; a chord along its middle heading approximates each arc.

    Args:
        yaw: Heading at the start [rad].
        lengths: Lengths of the arcs (m,) [m].
        heading_changes: Heading changes of the arcs (..., m) [rad].

    Returns:
        Positions relative to the start (..., m, 2) [m].
    """
    middles = yaw + np.cumsum(heading_changes, axis=-1) - heading_changes / 2
    return np.cumsum(np.stack([lengths * np.cos(middles), lengths * np.sin(middles)], axis=-1), axis=-2)


def ramp_distances(speeds: Array, goals: Array, acceleration: float, times: Array) -> Array:
    """Computes the distances that vehicles drive between times while their speed changes as in `sample_ramp`.

    Args:
        speeds: Speeds at the start (n,) [m/s], negative backwards.
        goals: Speeds to reach (n,) [m/s], likewise.
        acceleration: Limit on acceleration and deceleration [m/s2].
        times: (k,) [s]

    Returns:
        Distances from 0 to the first time and from each time to the next (n, k) [m], by the trapezoidal rule; negative
        where the vehicle drives backwards.
    """
    times = np.concatenate([[0.0], times])
    change, start = acceleration * times, speeds[:, None]
    ramp = np.minimum(np.maximum(goals[:, None], start - change), start + change)
    return np.asarray((ramp[:, 1:] + ramp[:, :-1]) / 2 * np.diff(times))


@njit()
def sample_profile(
    start: float, peak: float, rise: float, hold: float, fall: float, times: Array, rates: Array, headings: Array
) -> None:
    """Samples a turn into `rates` and `headings` (n,), see `sample_turn`."""
    for i, time in enumerate(times):
        rates[i], headings[i] = profile_at(start, peak, rise, hold, fall, time)


@njit()
def profile_at(start: float, peak: float, rise: float, hold: float, fall: float, time: float) -> tuple[float, float]:
    """The yaw rate [rad/s] and the heading since its start [rad] of a turn at a time [s], see `Turn`."""
    t = min(time, rise)
    rate = start + (peak - start) * t / rise if rise > 0 else peak
    heading = (start + rate) / 2 * t
    heading += peak * min(max(time - rise, 0.0), hold)
    t = min(max(time - rise - hold, 0.0), fall)
    if t > 0:
        rate = peak * (1 - t / fall)
        heading += (peak + rate) / 2 * t
    return rate, heading


@njit()
def sample_ramp(start: float, goal: float, acceleration: float, times: Array, speeds: Array) -> None:
    """Samples the speed of a vehicle that changes to another speed and keeps it, through zero if their signs differ.

    Args:
        start: Speed at the start [m/s], negative backwards.
        goal: Speed to reach [m/s], likewise.
        acceleration: Limit on acceleration and deceleration [m/s2].
        times: (n,) [s]
        speeds: Array to fill (n,) [m/s].
    """
    for i, time in enumerate(times):
        speeds[i] = ramp_at(start, goal, acceleration, time)


@njit()
def ramp_at(start: float, goal: float, acceleration: float, time: float) -> float:
    """The speed of `sample_ramp` at a time [m/s]."""
    change = acceleration * time
    return min(max(goal, start - change), start + change)


@njit()
def _sample_profiles(
    yaw_rates: Array, heading_changes: Array, max_rate: float, acceleration: float, times: Array
) -> Array:
    """Computes `turn_headings` (n, k) of turns (n,), as a kernel."""
    headings, rates = np.empty((len(yaw_rates), len(times))), np.empty(len(times))
    for i in range(len(yaw_rates)):
        peak, rise, hold, fall = turn_profile(yaw_rates[i], heading_changes[i], max_rate, acceleration)
        sample_profile(yaw_rates[i], peak, rise, hold, fall, times, rates, headings[i])
    return headings


@njit()
def wheel_speeds(speed: float, yaw_rate: float, track: float, wheel_radius: float) -> tuple[float, float]:
    """Computes the wheel speeds [rad/s] of a differential drive (Siegwart and Nourbakhsh, Autonomous Robots, 3.2)."""
    half = yaw_rate * track / 2
    return (speed - half) / wheel_radius, (speed + half) / wheel_radius
