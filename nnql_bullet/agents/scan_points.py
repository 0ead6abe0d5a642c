"""The last scan as points in the plane."""

import numpy as np

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import ray_angles


def seen_distances(ray_distances: Array) -> Array:
    """Ray distances (..., 72) [m], NaN where a ray met nothing."""
    return np.where(ray_distances < paper.SENSOR_RANGE, ray_distances, np.nan)


def scan_points(ray_distances: Array, sensor: tuple[float, float, float]) -> Array:
    """Where the rays met something, in the vehicle frame (..., 72, 2) [m]; NaN where they met nothing.

    Args:
        ray_distances: (..., 72) [m]
        sensor: Where the rays start, in the vehicle frame [m].
    """
    angles = ray_angles()
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.asarray(seen_distances(ray_distances)[..., None] * directions + sensor[:2])
