"""Detection of dead sensors, which read nothing although something is there, and completion of their readings.

A sensor is found dead by contradictions. What another sensor saw a decision ago has to be seen again where the
vehicle's own motion puts it, and an obstacle that ends at both borders of a sector goes on inside.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.mapping.point_cloud import place_among_rays
from nnql_bullet.sensing import RAYS, RAYS_PER_SECTOR

ENOUGH = 3.0
"""Contradictions from which on a sensor counts as dead, until it reads something."""
NEAR, CLOSE = 8.0, 4.0
"""Distances beyond which an obstacle contradicts nothing [m]: any obstacle, which may be out of range or between two
rays, and one that ends at one border of the sector, which counts in full only if it is close."""

ALIKE = 2.0
"""Difference of the distances at both borders of a sector up to which they belong to one obstacle [m]."""


@njit()
def silent_sectors(distances: Array) -> NDArray[np.bool_]:
    """Whether each sector reads nothing on any of its rays (8,), in a scan (72,) [m]."""
    silent = np.empty(paper.SECTORS, np.bool_)
    for sector in range(paper.SECTORS):
        first = sector * RAYS_PER_SECTOR
        silent[sector] = distances[first : first + RAYS_PER_SECTOR].min() >= paper.SENSOR_RANGE
    return silent


@njit()
def contradictions(distances: Array, expected: Array, sensor: Array) -> Array:
    """Contradictions against each sector (8,) that reads nothing; 0 for those that read something.

    Args:
        distances: Of the rays (72,) [m].
        expected: Where the last scan's points should be now, in the vehicle frame (72, 2) [m]; NaN for none.
        sensor: x, y in the vehicle frame [m].
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
    """Distances of the rays next to a sector, on its right and on its left [m]."""
    first = sector * RAYS_PER_SECTOR
    return distances[(first - 1) % RAYS], distances[(first + RAYS_PER_SECTOR) % RAYS]


@njit()
def completed(distances: Array, dead: NDArray[np.bool_], expected: Array, sensor: Array) -> tuple[Array, Array]:
    """Completes a scan: a dead sector reads the nearest of the rays beside it and of what was seen there before.

    Args:
        distances: Of the rays (72,) [m].
        dead: Which sectors (8,).
        expected: Where the points that are remembered should be now, in the vehicle frame (72, 2) [m]; NaN for none.
        sensor: x, y in the vehicle frame [m].

    Returns:
        The distances (72,) [m], and for each ray of a dead sector what is remembered there (72, 2) [m].
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
