"""From rays to the paper's eight sensors: pure functions of distances."""

import numpy as np

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit

RAYS_PER_SECTOR = 9
RAYS = paper.SECTORS * RAYS_PER_SECTOR
FRONT, FRONT_LEFT, FRONT_RIGHT = 0, 1, 7
"""Sectors: sector 0 is centred straight ahead, the others follow counter-clockwise, 45 degrees each."""


def ray_angles() -> Array:
    """Directions of the rays in the vehicle frame (72,) [rad]: evenly spaced, 9 in each sector."""
    step = paper.SECTOR_ANGLE / RAYS_PER_SECTOR
    return np.asarray((np.arange(RAYS) - (RAYS_PER_SECTOR - 1) / 2) * step)


def middle_readings(distances: Array) -> Array:
    """Readings (..., 8) [m] of ray distances (..., 72) [m]; a sector reads the ray in its middle."""
    return distances[..., RAYS_PER_SECTOR // 2 :: RAYS_PER_SECTOR].copy()


def sector_readings(distances: Array) -> Array:
    """Readings (..., 8) [m] of ray distances (..., 72) [m]; a sector reads the smallest of its rays."""
    nearest: Array = _nearest(distances.reshape(-1, RAYS_PER_SECTOR))
    return nearest.reshape(*distances.shape[:-1], paper.SECTORS)


@njit()
def _nearest(distances: Array) -> Array:
    """The smallest of each row (m,). A loop, because NumPy is slow on short rows."""
    nearest = np.empty(len(distances))
    for i in range(len(distances)):
        nearest[i] = distances[i, 0]
        for j in range(1, distances.shape[1]):
            nearest[i] = min(nearest[i], distances[i, j])
    return nearest
