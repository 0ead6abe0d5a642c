"""Where a vehicle has the room that a drive at full speed asks for; elsewhere it drives slowly.

It has to keep a margin over a look-ahead, and up to where it can stop and turn round on the spot. A shield asks the
same of the actions that it admits (`shield.prediction.stays_clear`): an agent that asks first is overruled less.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.mapping.body_map import Cells, Offsets
from nnql_bullet.mapping.foresight import Mover, points_near
from nnql_bullet.mapping.prediction import PREDICTION_STEP, clearance_at
from nnql_bullet.vehicle.profiles import profile_at, ramp_at, turn_profile

_SIGHT = 8.0
"""Distance up to which what the last scan saw is looked at, over the length scale [m]."""
_AXLE = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
"""The rear-axle centre as a footprint without size."""


class Pace(NamedTuple):
    """What full speed asks for."""

    speed: float
    """Of the drive [m/s]."""
    margin: float
    """Clearance of the footprint [m]."""
    least: float
    """Clearance below which the vehicle may hardly get nearer [m]."""
    approach: float
    """How much nearer than now it may get where it has less than the margin [m]."""
    look_ahead: float
    """Length of the course that has to be clear [m]."""
    corridor: float
    """Length within which it has to be able to turn round [m]."""
    circle: float
    """Free distance round the axle that turning round takes [m]."""


@njit(nogil=True)
def keeps_pace(
    cells: Cells,
    offsets: Offsets,
    corners: NDArray[np.int64],
    poses: Array,
    rays: Array,
    moving: Array,
    speeds: Array,
    yaw_rates: Array,
    turns: Array,
    mover: Mover,
    pace: Pace,
) -> NDArray[np.bool_]:
    """Whether n vehicles that turn by m heading changes have room for full speed (n, m); what moves is left out.

    Args:
        cells: Maps (n, SIDE, SIDE).
        offsets: See `body_map.add_scans`.
        corners: First cells of the maps (n, 2).
        poses: Of the vehicles, in the landmark's frame (n, 3).
        rays: Distances of the last scan (n, r) [m].
        moving: Velocities of its points in the vehicle frame (n, r, 2) [m/s].
        speeds: (n,) [m/s]
        yaw_rates: (n,) [rad/s]
        turns: Heading changes (n, m) [rad].
        mover: The vehicle.
        pace: What full speed asks for.
    """
    found = np.empty(turns.shape, np.bool_)
    room = np.empty((cells.shape[1] ** 2 + rays.shape[1], 5))
    points = np.empty((cells.shape[1] ** 2 + 2 * rays.shape[1], 2))
    for i in range(len(cells)):
        count = 0
        for k in range(points_near(cells[i], offsets[i], corners[i], poses[i], rays[i], moving[i], mover, room)):
            if room[k, 2] == 0.0 and room[k, 3] == 0.0:
                points[count] = room[k, :2]
                count += 1
        for j in range(rays.shape[1]):
            still = moving[i, j, 0] == 0.0 and moving[i, j, 1] == 0.0
            if still and rays[i, j] < min(_SIGHT * mover.scale, mover.sensor_range):
                points[count, 0] = mover.sensor[0] + rays[i, j] * np.cos(mover.angles[j])
                points[count, 1] = mover.sensor[1] + rays[i, j] * np.sin(mover.angles[j])
                count += 1
        for j in range(turns.shape[1]):
            found[i, j] = _has_room(points, count, speeds[i], yaw_rates[i], turns[i, j], mover, pace)
    return found


@njit(nogil=True)
def _has_room(points: Array, count: int, speed: float, yaw_rate: float, turn: float, mover: Mover, pace: Pace) -> bool:
    """Whether a vehicle that turns among the first points (k, 2), and then drives straight on, has room for that."""
    here = clearance_at(0.0, 0.0, 0.0, points, count, mover.footprint)
    margin = min(max(here - pace.approach, pace.least), pace.margin)
    if here < pace.least:
        margin = min(max(here - pace.approach / 6, here / 2), pace.margin)
    after = min(speed + mover.acceleration * mover.period, pace.speed)
    stop = (speed + after) / 2 * mover.period + after * after / (2 * mover.acceleration)
    peak, rise, hold, fall = turn_profile(yaw_rate, turn, mover.max_rate, mover.yaw_acceleration)
    longest = max(pace.look_ahead, pace.corridor) / pace.speed + pace.speed / (2 * mover.acceleration)
    x = y = along = before = 0.0
    was, turns_round = speed, False
    for k in range(1, int(np.ceil(longest / PREDICTION_STEP)) + 1):
        _, heading = profile_at(yaw_rate, peak, rise, hold, fall, k * PREDICTION_STEP)
        now = ramp_at(speed, pace.speed, mover.acceleration, k * PREDICTION_STEP)
        length, middle = (was + now) / 2 * PREDICTION_STEP, (before + heading) / 2
        x, y, along = x + length * np.cos(middle), y + length * np.sin(middle), along + length
        before, was = heading, now
        if clearance_at(x, y, heading, points, count, mover.footprint) < margin:
            return False
        if along >= stop and not turns_round:
            turns_round = clearance_at(x, y, heading, points, count, _AXLE) >= pace.circle
        if along >= pace.look_ahead and turns_round:
            return True
    return False
