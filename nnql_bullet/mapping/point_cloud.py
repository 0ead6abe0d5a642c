"""Converts scans to points in the plane, and finds those on moving obstacles."""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.sensing import RAYS, RAYS_PER_SECTOR, ray_angles

MOVING_POINT, MOVING_POINT_SHARE = 0.06, 0.03
"""Smallest distance of a moving point in front of the last scan [m], and the share of the point's distance that is
added, because an obstacle may be unseen between two rays."""


def seen_distances(ray_distances: Array) -> Array:
    """Replaces ray distances (..., 72) [m] by NaN where a ray met nothing."""
    return np.where(ray_distances < paper.SENSOR_RANGE, ray_distances, np.nan)


def point_cloud(ray_distances: Array, sensor: tuple[float, float, float]) -> Array:
    """Computes the points where rays met an obstacle, in the vehicle frame (..., 72, 2) [m]; NaN where they met none.

    Args:
        ray_distances: Distances (..., 72) [m].
        sensor: Origin of the rays in the vehicle frame [m].
    """
    angles = ray_angles()
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.asarray(seen_distances(ray_distances)[..., None] * directions + sensor[:2])


@njit()
def place_among_rays(x: float, y: float, sensor: Array) -> float:
    """Computes the index of the ray toward a point in the vehicle frame [m], as a fraction between two rays."""
    step = paper.SECTOR_ANGLE / RAYS_PER_SECTOR
    return float((np.arctan2(y - sensor[1], x - sensor[0]) / step + (RAYS_PER_SECTOR - 1) / 2) % RAYS)


@njit()
def moving_points(points: Array, before: Array, moved: Array, strayed: float, sensor: Array) -> NDArray[np.bool_]:
    """Marks the points of a scan (72,) on moving obstacles: those where the last scan saw free space.

    Args:
        points: Points of the scan in the vehicle frame (72, 2) [m]; NaN for none.
        before: Ray distances of the last scan (72,) [m]; NaN if there was none.
        moved: The present pose in the vehicle frame of the last scan (3,).
        strayed: Possible position error of that pose [m].
        sensor: Origin of the rays in the vehicle frame: x, y [m].
    """
    found = np.zeros(len(points), np.bool_)
    c, s = np.cos(moved[2]), np.sin(moved[2])
    for k in range(len(points)):
        if np.isnan(points[k, 0]):
            continue
        x, y = moved[0] + c * points[k, 0] - s * points[k, 1], moved[1] + s * points[k, 0] + c * points[k, 1]
        place, distance = place_among_rays(x, y, sensor), np.hypot(x - sensor[0], y - sensor[1])
        free = min(before[int(place) % RAYS], before[int(place + 1) % RAYS])
        found[k] = distance < free - MOVING_POINT - MOVING_POINT_SHARE * distance - strayed
    return found
