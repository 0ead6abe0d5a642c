"""Converts scans to points in the plane, and finds those on moving obstacles."""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.sensing import Sensor, first_ray

MOVING_POINT, MOVING_POINT_SHARE = 0.06, 0.03
"""Smallest distance of a moving point in front of the last scan [m], and the share of the point's distance that is
added, because an obstacle may be unseen between two rays."""


def seen_distances(ray_distances: Array, sensor: Sensor) -> Array:
    """Replaces ray distances (..., rays) [m] by NaN where a ray met nothing."""
    return np.where(sensor.met(ray_distances), ray_distances, np.nan)


def point_cloud(ray_distances: Array, sensor: Sensor) -> Array:
    """Computes the points where rays met an obstacle, in the vehicle frame (..., rays, 2) [m]; NaN where they met none.

    Args:
        ray_distances: Distances (..., rays) [m].
        sensor: That read them.
    """
    return np.asarray(seen_distances(ray_distances, sensor)[..., None] * sensor.directions + sensor.position[:2])


@njit()
def place_among_rays(x: float, y: float, sensor: Array, rays: int) -> float:
    """Computes the index of the ray, of `rays`, toward a point in the vehicle frame [m], as a fraction between two."""
    step = paper.SECTOR_ANGLE / (rays / paper.SECTORS)
    return float((np.arctan2(y - sensor[1], x - sensor[0]) / step + (first_ray(1, rays) - 1) / 2) % rays)


@njit()
def moving_points(points: Array, before: Array, moved: Array, strayed: float, sensor: Array) -> NDArray[np.bool_]:
    """Marks the points of a scan (rays,) on moving obstacles: those where the last scan saw free space.

    Args:
        points: Points of the scan in the vehicle frame (rays, 2) [m]; NaN for none.
        before: Ray distances of the last scan (rays,) [m]; NaN for one that is not known.
        moved: The present pose in the vehicle frame of the last scan (3,).
        strayed: Possible position error of that pose [m].
        sensor: Origin of the rays in the vehicle frame: x, y [m].
    """
    found = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        if not np.isnan(points[k, 0]):
            found[k] = is_moving(points[k, 0], points[k, 1], before, moved, strayed, sensor)
    return found


@njit()
def is_moving(x: float, y: float, before: Array, moved: Array, strayed: float, sensor: Array) -> bool:
    """Whether the last scan saw free space at a point of a scan [m], see `moving_points`."""
    c, s = np.cos(moved[2]), np.sin(moved[2])
    x, y = moved[0] + c * x - s * y, moved[1] + s * x + c * y
    place, distance = place_among_rays(x, y, sensor, len(before)), np.hypot(x - sensor[0], y - sensor[1])
    right, left = before[int(place) % len(before)], before[int(place + 1) % len(before)]
    free = np.minimum(right, left)  # NaN if either is
    return bool(distance < free - MOVING_POINT - MOVING_POINT_SHARE * distance - strayed)
