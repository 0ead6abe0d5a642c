"""Detects dead sensors, which read nothing although an obstacle is there, and completes their readings.

Contradictions show that a sensor is dead: a point from the last scan must be seen again at its place after the
vehicle's motion, and an obstacle that reaches both borders of a sector continues inside it.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.mapping.point_cloud import place_among_rays
from nnql_bullet.sensing import RAYS, RAYS_PER_SECTOR

ENOUGH = 3.0
"""Number of contradictions from which a sensor counts as dead, until it reads something."""
NEAR, CLOSE = 8.0, 4.0
"""Largest distance of an obstacle that contradicts a sensor at all, and of one at a single border of the sector that
counts in full [m]; a farther one may be out of range or between two rays."""

ALIKE = 2.0
"""Largest difference between the distances at both borders of a sector for one obstacle [m]."""


@njit()
def silent_sectors(distances: Array) -> NDArray[np.bool_]:
    """Marks the sectors (8,) in which no ray of a scan (72,) [m] meets anything."""
    silent = np.empty(paper.SECTORS, np.bool_)
    for sector in range(paper.SECTORS):
        first = sector * RAYS_PER_SECTOR
        silent[sector] = distances[first : first + RAYS_PER_SECTOR].min() >= paper.SENSOR_RANGE
    return silent


@njit()
def contradictions(distances: Array, expected: Array, sensor: Array) -> Array:
    """Counts the contradictions against each sector (8,) that reads nothing; 0 for the others.

    Args:
        distances: Ray distances (72,) [m].
        expected: Expected positions of the last scan's points in the vehicle frame (72, 2) [m]; NaN for none.
        sensor: Origin of the rays in the vehicle frame: x, y [m].
    """
    silent, against = silent_sectors(distances), np.zeros(paper.SECTORS)
    for x, y in expected:
        if np.hypot(x - sensor[0], y - sensor[1]) < NEAR:
            place = place_among_rays(x, y, sensor)
            sector, inside = int(place) // RAYS_PER_SECTOR % paper.SECTORS, place % RAYS_PER_SECTOR
            if silent[sector] and 1.0 <= inside <= RAYS_PER_SECTOR - 2.0:
                against[sector] += 1.0
    for sector in range(paper.SECTORS):
        right, left = borders(distances, sector)
        if silent[sector]:
            both, close = max(right, left) < NEAR and abs(right - left) < ALIKE, min(right, left) < CLOSE
            against[sector] += 1.0 if both or close else 0.5 if min(right, left) < NEAR else 0.0
    return against


@njit()
def borders(distances: Array, sector: int) -> tuple[float, float]:
    """Returns the distances of the rays next to a sector, on its right and on its left [m]."""
    first = sector * RAYS_PER_SECTOR
    return distances[(first - 1) % RAYS], distances[(first + RAYS_PER_SECTOR) % RAYS]


@njit()
def completed(distances: Array, dead: NDArray[np.bool_], expected: Array, sensor: Array) -> tuple[Array, Array]:
    """Completes a scan: a dead sector reads the smallest distance of the rays beside it and of remembered points in it.

    Args:
        distances: Ray distances (72,) [m].
        dead: Whether each sector is dead (8,).
        expected: Expected positions of remembered points in the vehicle frame (72, 2) [m]; NaN for none.
        sensor: Origin of the rays in the vehicle frame: x, y [m].

    Returns:
        The distances (72,) [m], and the remembered point of each ray in a dead sector (72, 2) [m].
    """
    whole, remembered = distances.copy(), np.full((RAYS, 2), np.nan)
    for sector in range(paper.SECTORS):
        if dead[sector]:
            first = sector * RAYS_PER_SECTOR
            right, left = borders(distances, sector)
            whole[first : first + RAYS_PER_SECTOR] = min(right, left)
    nearest = np.full(RAYS, paper.SENSOR_RANGE)
    for x, y in expected:
        distance = np.hypot(x - sensor[0], y - sensor[1])
        if distance < paper.SENSOR_RANGE:
            ray = int(np.rint(place_among_rays(x, y, sensor))) % RAYS
            if dead[ray // RAYS_PER_SECTOR] and distance < nearest[ray]:
                nearest[ray] = distance
                remembered[ray, 0], remembered[ray, 1] = x, y
                whole[ray] = min(whole[ray], distance)
    return whole, remembered
