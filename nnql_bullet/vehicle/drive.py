"""From a commanded heading change to wheel speeds: a yaw-rate profile inside the vehicle's limits.

A turn goes from the present yaw rate to a peak, holds it, and comes back to zero when the heading change is reached:
the trapezoidal velocity profile of Lynch and Park, Modern Robotics, 9.2.2, applied to the yaw rate. It is the quickest
turn within the limits on yaw rate and yaw acceleration. A turn that a control period cuts short hands its yaw rate on
to the next one.
"""

from dataclasses import dataclass
from math import copysign, sqrt

import numpy as np

from nnql_bullet.geometry import Array
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
        """Time until the vehicle runs straight again [s]."""
        return self.rise + self.hold + self.fall


def plan_turn(yaw_rate: float, heading_change: float, limits: Limits) -> Turn:
    """The quickest turn by `heading_change` that starts at `yaw_rate` and ends running straight.

    At acceleration `a`, the ramps to the peak and to zero cover (2 peak^2 - start^2) / 2a; the hold covers the rest.
    """
    a = limits.yaw_acceleration
    # The heading that ending this turn at once still covers tells on which side the peak has to be.
    side = copysign(1.0, heading_change - yaw_rate * abs(yaw_rate) / (2 * a))
    start, change = side * yaw_rate, side * heading_change
    peak = min(sqrt(max(a * change + start * start / 2, 0.0)), limits.yaw_rate)
    hold = 0.0
    if peak > 0:
        hold = max((change - (2 * peak * peak - start * start) / (2 * a)) / peak, 0.0)
    return Turn(yaw_rate, side * peak, abs(peak - start) / a, hold, peak / a)


def sample_turn(turn: Turn, times: Array) -> tuple[Array, Array]:
    """Yaw rate [rad/s] and heading since the start of the turn [rad] at `times` (n,) [s]."""
    rise = np.clip(times, 0.0, turn.rise)
    hold = np.clip(times - turn.rise, 0.0, turn.hold)
    fall = np.clip(times - turn.rise - turn.hold, 0.0, turn.fall)
    rate_up, heading_up = _ramp(turn.start, turn.peak, turn.rise, rise)
    rate_down, heading_down = _ramp(turn.peak, 0.0, turn.fall, fall)
    rate = np.where(times < turn.rise, rate_up, rate_down)
    return rate, heading_up + turn.peak * hold + heading_down


def _ramp(first: float, last: float, duration: float, time: Array) -> tuple[Array, Array]:
    """A linear ramp and its integral, `time` within it."""
    if duration == 0.0:
        return np.full_like(time, last), np.zeros_like(time)
    slope = (last - first) / duration
    return first + slope * time, (first + slope * time / 2) * time


def wheel_speeds(speed: float, yaw_rate: float, track: float, wheel_radius: float) -> tuple[float, float]:
    """Left and right wheel speed [rad/s] of a differential drive (Siegwart and Nourbakhsh, Autonomous Robots, 3.2)."""
    half = yaw_rate * track / 2
    return (speed - half) / wheel_radius, (speed + half) / wheel_radius
