"""Kernels of the shield's predictions: courses that end in a stop, and whether courses stay clear of points."""

import numpy as np

from nnql_bullet.geometry import Array, reach_of, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.mapping.prediction import PREDICTION_STEP
from nnql_bullet.vehicle.profiles import profile_at, ramp_at, turn_profile


@njit()
def fill_drive(
    course: Array,
    yaw_rate: float,
    speed: float,
    turn: float,
    goal: float,
    duration: float,
    max_rate: float,
    yaw_acceleration: float,
    acceleration: float,
    slides: bool,
) -> int:
    """Predicts a vehicle that turns and changes its speed: its state at equal intervals, in its present frame.

    Args:
        course: Room for x, y [m], yaw [rad], yaw rate [rad/s] and speed [m/s] (k, 5); what it has no room for is left
            out.
        yaw_rate: At the start [rad/s].
        speed: At the start [m/s].
        turn: Heading change that is asked for [rad].
        goal: Speed that is asked for [m/s].
        duration: [s]
        max_rate: Limit on the yaw rate [rad/s].
        yaw_acceleration: Limit on the yaw acceleration [rad/s2].
        acceleration: Limit on acceleration and deceleration [m/s2].
        slides: Whether its turn leaves no grip to change the speed with before the turn has ended.

    Returns:
        How many rows were written.
    """
    count = max(int(np.ceil(duration / PREDICTION_STEP - 1e-9)), 1)
    peak, rise, hold, fall = turn_profile(yaw_rate, turn, max_rate, yaw_acceleration)
    kept = rise + hold + fall if slides else 0.0
    x = y = heading = 0.0
    before = speed
    for k in range(min(count, len(course))):
        time = (k + 1.0) * (duration / count)
        rate, after = profile_at(yaw_rate, peak, rise, hold, fall, time)
        now = ramp_at(speed, goal, acceleration, max(time - kept, 0.0))
        length, middle = (before + now) / 2 * (duration / count), (heading + after) / 2
        x, y = x + length * np.cos(middle), y + length * np.sin(middle)
        before, heading = now, after
        course[k] = x, y, heading, rate, now
    return min(count, len(course))


@njit()
def fill_course(
    course: Array,
    yaw_rate: float,
    speed: float,
    turn: float,
    goal: float,
    max_rate: float,
    yaw_acceleration: float,
    acceleration: float,
    times: Array,
    steps: Array,
) -> None:
    """Predicts a vehicle that turns while it changes its speed: its poses at given times, in its present frame.

    Args:
        course: Room for x, y [m], yaw [rad] and the distance driven until then [m] (k, 4).
        yaw_rate: At the start [rad/s].
        speed: At the start [m/s].
        turn: Heading change that is asked for [rad].
        goal: Speed that is asked for [m/s].
        max_rate: Limit on the yaw rate [rad/s].
        yaw_acceleration: Limit on the yaw acceleration [rad/s2].
        acceleration: Limit on acceleration and deceleration [m/s2].
        times: Of the poses (k,) [s].
        steps: From each time to the next, the first from 0 (k,) [s].
    """
    peak, rise, hold, fall = turn_profile(yaw_rate, turn, max_rate, yaw_acceleration)
    x, y, before, was, along = 0.0, 0.0, 0.0, speed, 0.0
    for k in range(len(times)):
        _, heading = profile_at(yaw_rate, peak, rise, hold, fall, times[k])
        now = ramp_at(speed, goal, acceleration, times[k])
        length, middle = (now + was) / 2 * steps[k], heading - (heading - before) / 2
        x, y, along = x + length * np.cos(middle), y + length * np.sin(middle), along + length
        before, was = heading, now
        course[k] = x, y, heading, along


@njit()
def time_to_stop(
    rate: float, speed: float, turn: float, max_rate: float, yaw_acceleration: float, deceleration: float, slides: bool
) -> float:
    """Time until a vehicle that brakes stands and no longer turns [s], see `fill_drive`."""
    _, rise, hold, fall = turn_profile(rate, turn, max_rate, yaw_acceleration)
    brakes, turns = abs(speed) / deceleration, rise + hold + fall
    return turns + brakes if slides else max(turns, brakes)


@njit()
def join(poses: Array, first: Array, count: int, then: Array, more: int) -> int:
    """Writes the poses on a course (k, 5) and on one that begins at its end into an array (m, 3); tells how many."""
    end = min(count, len(first)) - 1
    x, y, yaw = first[end, 0], first[end, 1], first[end, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    for k in range(min(count, len(first))):
        poses[k] = first[k, 0], first[k, 1], first[k, 2]
    for k in range(min(more, len(then))):
        ahead, left = then[k, 0], then[k, 1]
        poses[count + k] = x + c * ahead - s * left, y + s * ahead + c * left, yaw + then[k, 2]
    return count + min(more, len(then))


@njit()
def is_clear(
    course: Array,
    points: Array,
    closing: Array,
    count: int,
    times: Array,
    footprint: Array,
    margin: float,
    stop: float,
    look_ahead: float,
    turning_circle: float,
) -> bool:
    """Whether a course stays clear of points for as long as it has to.

    It has to be clear over the look-ahead, and up to where the vehicle has stopped and can turn round.

    Args:
        course: Poses of the vehicle, in its present frame, and distances driven, see `fill_course` (k, 4).
        points: Around the vehicle, in its present frame (r, 2) [m].
        closing: Speed at which each point may come nearer (r,) [m/s].
        count: Number of the points.
        times: Of the poses (k,) [s].
        footprint: A row (7,) of `geometry.as_rows`, in the vehicle's frame.
        margin: Smallest clearance of the vehicle [m].
        stop: Distance in which it can stop [m].
        look_ahead: Distance over which the course has to be clear [m].
        turning_circle: Radius about the axle that is free where the vehicle can turn round [m].
    """
    ahead = turns = False
    for k in range(len(course)):
        x, y, yaw, along = course[k, 0], course[k, 1], course[k, 2], course[k, 3]
        if not _keeps_distance(x, y, yaw, points, closing, count, times[k], footprint, margin):
            return False
        ahead = ahead or along >= look_ahead
        turns = turns or (along >= stop and _has_room(x, y, points, count, turning_circle))
        if ahead and turns:
            return True
    return False


@njit()
def _keeps_distance(
    x: float,
    y: float,
    yaw: float,
    points: Array,
    closing: Array,
    count: int,
    time: float,
    footprint: Array,
    margin: float,
) -> bool:
    """Whether a vehicle at a pose keeps a clearance from points (r, 2), see `is_clear`."""
    c, s, reach = np.cos(yaw), np.sin(yaw), reach_of(footprint)
    middle_x, middle_y = x + c * footprint[0] - s * footprint[1], y + s * footprint[0] + c * footprint[1]
    for r in range(min(count, len(points))):
        least = margin + closing[r] * time if margin > 0 else margin
        dx, dy = points[r, 0] - middle_x, points[r, 1] - middle_y
        if dx * dx + dy * dy < (reach + least) ** 2:  # not so for NaN
            dx, dy = points[r, 0] - x, points[r, 1] - y
            if squared_distance(c * dx + s * dy, c * dy - s * dx, footprint) < least * abs(least):
                return False
    return True


@njit()
def _has_room(x: float, y: float, points: Array, count: int, radius: float) -> bool:
    """Whether none of the first points (r, 2) lies within a distance of a place [m]."""
    for r in range(min(count, len(points))):
        dx, dy = points[r, 0] - x, points[r, 1] - y
        if dx * dx + dy * dy < radius * radius:
            return False
    return True
