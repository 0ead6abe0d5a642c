"""The last scan as points in the plane."""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.sensing import RAYS, RAYS_PER_SECTOR, ray_angles

MOVING_POINT, MOVING_POINT_SHARE = 0.06, 0.03
"""Distance by which a point has to lie in front of what was seen before to count as moving [m], and the fraction of
the point's distance that is added: between two rays an obstacle may reach out unseen."""


def seen_distances(ray_distances: Array) -> Array:
    """Ray distances (..., 72) [m]; NaN where a ray met nothing."""
    return np.where(ray_distances < paper.SENSOR_RANGE, ray_distances, np.nan)


def point_cloud(ray_distances: Array, sensor: tuple[float, float, float]) -> Array:
    """Points where the rays met an obstacle, in the vehicle frame (..., 72, 2) [m]; NaN where they met none.

    Args:
        ray_distances: (..., 72) [m]
        sensor: Where the rays start, in the vehicle frame [m].
    """
    angles = ray_angles()
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.asarray(seen_distances(ray_distances)[..., None] * directions + sensor[:2])


@njit()
def place_among_rays(x: float, y: float, sensor: Array) -> float:
    """Index of the ray toward a point of the vehicle frame [m], with a fraction between two rays."""
    step = paper.SECTOR_ANGLE / RAYS_PER_SECTOR
    return float((np.arctan2(y - sensor[1], x - sensor[0]) / step + (RAYS_PER_SECTOR - 1) / 2) % RAYS)


@njit()
def moving_points(points: Array, before: Array, moved: Array, strayed: float, sensor: Array) -> NDArray[np.bool_]:
    """Which points of a scan (72,) belong to moving obstacles: they lie where the scan before saw free space.

    Args:
        points: In the vehicle frame (72, 2) [m]; NaN for none.
        before: Ray distances of the scan before (72,) [m]; NaN if there was none.
        moved: The pose of now in the vehicle frame of then (3,).
        strayed: Position error that pose may have [m].
        sensor: x, y in the vehicle frame [m].
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
