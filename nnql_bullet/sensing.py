"""The paper's eight sensors: rays in the vehicle frame, and readings of the sectors from ray distances."""

import numpy as np

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit

RAYS_PER_SECTOR = 9
RAYS = paper.SECTORS * RAYS_PER_SECTOR
FRONT, FRONT_LEFT, FRONT_RIGHT = 0, 1, 7
"""Indices of sectors: sector 0 is centred straight ahead, the others follow counter-clockwise."""


def ray_angles() -> Array:
    """Directions of the rays in the vehicle frame (72,) [rad]: evenly spaced, 9 in each sector."""
    step = paper.SECTOR_ANGLE / RAYS_PER_SECTOR
    return np.asarray((np.arange(RAYS) - (RAYS_PER_SECTOR - 1) / 2) * step)


def middle_readings(distances: Array) -> Array:
    """Takes the readings of sectors (..., 8) [m] from the ray in the middle of each, of distances (..., 72) [m]."""
    return distances[..., RAYS_PER_SECTOR // 2 :: RAYS_PER_SECTOR].copy()


def sector_readings(distances: Array) -> Array:
    """Takes the readings of sectors (..., 8) [m] from the shortest ray of each, of distances (..., 72) [m]."""
    return smallest(distances.reshape(*distances.shape[:-1], paper.SECTORS, RAYS_PER_SECTOR))


def smallest(values: Array) -> Array:
    """Finds the smallest values along the last axis, as `np.min` does; it is faster over short rows."""
    rows: Array = _smallest(values.reshape(-1, values.shape[-1]))
    return rows.reshape(values.shape[:-1])


@njit()
def _smallest(rows: Array) -> Array:
    """Finds the smallest value of each row (k, m)."""
    found = np.empty(len(rows))
    for i in range(len(rows)):
        found[i] = rows[i, 0]
        for j in range(1, rows.shape[1]):
            found[i] = min(found[i], rows[i, j])
    return found
