"""Kernels of the shield's predictions: courses that end in a stop, and whether courses stay clear of points."""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, reach_of, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.mapping.prediction import PREDICTION_STEP
from nnql_bullet.vehicle.profiles import sample_profile, sample_ramp, turn_profile


@njit()
def drives(
    yaw_rate: float,
    speed: float,
    turn: float,
    goal: float,
    duration: float,
    max_rate: float,
    yaw_acceleration: float,
    acceleration: float,
    slides: bool = False,
) -> Array:
    """Predicts a vehicle that turns and changes its speed: its state at equal intervals, in its present frame (k, 5).

    Args:
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
        x, y [m], yaw [rad], yaw rate [rad/s] and speed [m/s].
    """
    count = max(int(np.ceil(duration / PREDICTION_STEP - 1e-9)), 1)
    times: Array = np.arange(1.0, count + 1.0) * (duration / count)
    course, headings, rates, speeds = np.empty((count, 5)), np.empty(count), np.empty(count), np.empty(count)
    peak, rise, hold, fall = turn_profile(yaw_rate, turn, max_rate, yaw_acceleration)
    sample_profile(yaw_rate, peak, rise, hold, fall, times, rates, headings)
    kept = rise + hold + fall if slides else 0.0
    sample_ramp(speed, goal, acceleration, np.maximum(times - kept, 0.0), speeds)
    x = y = heading = 0.0
    before = speed
    for k in range(count):
        length, middle = (before + speeds[k]) / 2 * (duration / count), (heading + headings[k]) / 2
        x, y = x + length * np.cos(middle), y + length * np.sin(middle)
        before, heading = speeds[k], headings[k]
        course[k] = x, y, headings[k], rates[k], speeds[k]
    return course


@njit()
def then_stops(
    driven: Array, turn: float, max_rate: float, yaw_acceleration: float, deceleration: float, slides: bool = False
) -> Array:
    """Predicts a vehicle that has driven a course and then brakes until it stands: its poses on both (k, 3).

    Args:
        driven: Of `drives` (n, 5).
        turn: Heading change that is asked for while it brakes [rad].
        max_rate: Limit on the yaw rate [rad/s].
        yaw_acceleration: Limit on the yaw acceleration [rad/s2].
        deceleration: That the vehicle reaches when it brakes [m/s2].
        slides: See `drives`.
    """
    x, y, yaw, rate, speed = driven[-1]
    brakes, turns = abs(speed) / deceleration, sum(turn_profile(rate, turn, max_rate, yaw_acceleration)[1:])
    stop = turns + brakes if slides else max(turns, brakes)
    then = drives(rate, speed, turn, 0.0, stop, max_rate, yaw_acceleration, deceleration, slides)
    c, s = np.cos(yaw), np.sin(yaw)
    poses = np.empty((len(driven) + len(then), 3))
    poses[: len(driven)] = driven[:, :3]
    for k in range(len(then)):
        ahead, left = then[k, 0], then[k, 1]
        poses[len(driven) + k] = x + c * ahead - s * left, y + s * ahead + c * left, yaw + then[k, 2]
    return poses


@njit()
def clear_courses(
    poses: Array,
    distances: Array,
    points: Array,
    closing: Array,
    times: Array,
    footprint: Array,
    margins: Array,
    stops: Array,
    look_ahead: float,
    turning_circle: float,
) -> NDArray[np.bool_]:
    """Whether courses stay clear of points for as long as they have to (n, m).

    A course has to be clear over the look-ahead, and up to where the vehicle has stopped and can turn round.

    Args:
        poses: Of n vehicles on m courses, in their present frames (n, m, k, 3).
        distances: Driven until then (n, k) [m].
        points: Around each vehicle, in its present frame (n, r, 2) [m]; NaN for none.
        closing: Speed at which each point may come nearer (n, r) [m/s].
        times: Of the poses (k,) [s].
        footprint: A row (7,) of `geometry.as_rows`, in the vehicle's frame.
        margins: Smallest clearance of each vehicle (n,) [m].
        stops: Distance in which each vehicle can stop (n,) [m].
        look_ahead: Distance over which a course has to be clear [m].
        turning_circle: Radius about the axle that is free where the vehicle can turn round [m].
    """
    n, m, steps = poses.shape[:3]
    clear = np.zeros((n, m), np.bool_)
    for i in range(n):
        for j in range(m):
            ahead = turns = False
            for k in range(steps):
                if not _keeps_distance(poses[i, j, k], points[i], closing[i], times[k], footprint, margins[i]):
                    break
                ahead = ahead or distances[i, k] >= look_ahead
                turns = turns or (distances[i, k] >= stops[i] and _has_room(poses[i, j, k], points[i], turning_circle))
                if ahead and turns:
                    clear[i, j] = True
                    break
    return clear


@njit()
def _keeps_distance(pose: Array, points: Array, closing: Array, time: float, footprint: Array, margin: float) -> bool:
    """Whether a vehicle at a pose keeps a clearance from points (r, 2), see `clear_courses`."""
    c, s, reach = np.cos(pose[2]), np.sin(pose[2]), reach_of(footprint)
    x, y = pose[0] + c * footprint[0] - s * footprint[1], pose[1] + s * footprint[0] + c * footprint[1]
    for r in range(len(points)):
        least = margin + closing[r] * time if margin > 0 else margin
        dx, dy = points[r, 0] - x, points[r, 1] - y
        if dx * dx + dy * dy < (reach + least) ** 2:  # not so for NaN
            dx, dy = points[r, 0] - pose[0], points[r, 1] - pose[1]
            if squared_distance(c * dx + s * dy, c * dy - s * dx, footprint) < least * abs(least):
                return False
    return True


@njit()
def _has_room(pose: Array, points: Array, radius: float) -> bool:
    """Whether no point (r, 2) lies within a distance of a pose's place [m]."""
    for r in range(len(points)):
        dx, dy = points[r, 0] - pose[0], points[r, 1] - pose[1]
        if dx * dx + dy * dy < radius * radius:
            return False
    return True
