"""Predicts the poses that actions lead to, and their clearance from the last scan."""

import numpy as np

from nnql_bullet.geometry import Array, reach_of, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.vehicle.profiles import sample_profile, turn_profile
from nnql_bullet.vehicle.spec import Limits

PREDICTION_STEP = 0.1
"""Time between predicted poses [s]."""
ROUNDING = 1e-6
"""Largest error of squared distances by rounding [m2]."""


def predicted_poses(yaw_rates: Array, turns: Array, lengths: Array, limits: Limits, times: Array) -> Array:
    """Predicts poses along turns with the controller's profiles, in the present frame of each vehicle (n, m, k, 3).

    Args:
        yaw_rates: Yaw rates at the start (n,) [rad/s].
        turns: Heading changes (n, m) [rad].
        lengths: Path lengths from each time to the next (n, k) [m].
        limits: The vehicle's limits.
        times: Times of the poses (k,) [s].
    """
    return _predicted_poses(yaw_rates, turns, lengths, limits.yaw_rate, limits.yaw_acceleration, times)


@njit()
def _predicted_poses(
    yaw_rates: Array, turns: Array, lengths: Array, max_rate: float, yaw_acceleration: float, times: Array
) -> Array:
    """`predicted_poses` as a kernel; each chord has its arc's middle heading."""
    (n, m), k = turns.shape, len(times)
    poses, rates, headings = np.empty((n, m, k, 3)), np.empty(k), np.empty(k)
    for i in range(n):
        for j in range(m):
            peak, rise, hold, fall = turn_profile(yaw_rates[i], turns[i, j], max_rate, yaw_acceleration)
            sample_profile(yaw_rates[i], peak, rise, hold, fall, times, rates, headings)
            x = y = before = 0.0
            for step in range(k):
                heading = headings[step]
                middle = heading - (heading - before) / 2
                x, y = x + lengths[i, step] * np.cos(middle), y + lengths[i, step] * np.sin(middle)
                poses[i, j, step] = x, y, heading
                before = heading
    return poses


@njit()
def scan_clearances(poses: Array, points: Array, footprint: Array) -> Array:
    """Computes distances from the footprint to the nearest point of the scan (n, m, k) [m]; infinite without points.

    Args:
        poses: Poses of each vehicle, in its present frame (n, m, k, 3).
        points: Points of each vehicle's scan, in its present frame (n, r, 2) [m]; NaN for none.
        footprint: A row (7,) of `geometry.as_rows`, in the vehicle's frame.
    """
    clearances = np.empty(poses.shape[:-1])
    for i in range(len(poses)):
        seen = points[i][np.isfinite(points[i, :, 0])]
        for j in range(poses.shape[1]):
            for k in range(poses.shape[2]):
                x, y, yaw = poses[i, j, k]
                clearances[i, j, k] = clearance_at(x, y, yaw, seen, len(seen), footprint)
    return clearances


@njit()
def clearance_at(x: float, y: float, yaw: float, points: Array, count: int, footprint: Array) -> float:
    """The distance from the footprint at a pose to the nearest of the first points (r, 2) [m]; infinite without any."""
    c, s, reach = np.cos(yaw), np.sin(yaw), reach_of(footprint)
    middle_x, middle_y = x + c * footprint[0] - s * footprint[1], y + s * footprint[0] + c * footprint[1]
    nearest = within = np.inf  # a point farther from the middle than that is not the nearest
    for r in range(min(count, len(points))):
        dx, dy = points[r, 0] - middle_x, points[r, 1] - middle_y
        if dx * dx + dy * dy > within:
            continue
        dx, dy = points[r, 0] - x, points[r, 1] - y
        squared = squared_distance(c * dx + s * dy, c * dy - s * dx, footprint)
        if squared < nearest:
            nearest, within = squared, (np.sqrt(squared) + reach) ** 2 + ROUNDING
    clearance: float = np.sqrt(nearest)
    return clearance
