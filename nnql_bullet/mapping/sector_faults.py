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
from nnql_bullet.sensing import RAYS, first_ray

ENOUGH = 3.0
"""Number of contradictions from which a sensor counts as dead, until it reads something."""
NEAR, CLOSE = 0.8, 0.4
"""Largest distance of an obstacle that contradicts a sensor at all, and of one at a single border of the sector that
counts in full, over the sensor's range; a farther one may be out of range or between two rays."""
ALIKE = 0.2
"""Largest difference between the distances at both borders of a sector for one obstacle, over the sensor's range."""


@njit()
def silent_sectors(distances: Array, sensor_range: float) -> NDArray[np.bool_]:
    """Marks the sectors (8,) in which no ray of a scan (rays,) [m] is shorter than the range [m]."""
    silent, rays = np.empty(paper.SECTORS, np.bool_), len(distances)
    for sector in range(paper.SECTORS):
        silent[sector] = True
        for ray in range(first_ray(sector, rays), min(first_ray(sector + 1, rays), rays)):
            silent[sector] = silent[sector] and distances[ray] >= sensor_range
    return silent


@njit()
def contradictions(distances: Array, expected: Array, sensor: Array, sensor_range: float) -> Array:
    """Counts the contradictions against each sector (8,) that reads nothing; 0 for the others.

    The points of every scan weigh the same together, however many rays it has.

    Args:
        distances: Ray distances (rays,) [m].
        expected: Expected positions of the last scan's points in the vehicle frame (rays, 2) [m]; NaN for none.
        sensor: Origin of the rays in the vehicle frame: x, y [m].
        sensor_range: Distance of a ray that meets nothing [m].
    """
    silent, against = silent_sectors(distances, sensor_range), np.zeros(paper.SECTORS)
    near, rays = NEAR * sensor_range, len(distances)
    for k in range(len(expected)):
        x, y = expected[k, 0], expected[k, 1]
        if np.hypot(x - sensor[0], y - sensor[1]) < near:
            place = place_among_rays(x, y, sensor, rays)
            sector = _sector_of(int(place), rays)
            if silent[sector] and first_ray(sector, rays) + 1.0 <= place <= first_ray(sector + 1, rays) - 2.0:
                against[sector] += RAYS / rays
    for sector in range(paper.SECTORS):
        right, left = borders(distances, sector)
        if silent[sector]:
            both = max(right, left) < near and abs(right - left) < ALIKE * sensor_range
            close = min(right, left) < CLOSE * sensor_range
            against[sector] += 1.0 if both or close else 0.5 if min(right, left) < near else 0.0
    return against


@njit()
def borders(distances: Array, sector: int) -> tuple[float, float]:
    """Returns the distances of the rays next to a sector, on its right and on its left [m]."""
    rays = len(distances)
    return distances[(first_ray(sector, rays) - 1) % rays], distances[first_ray(sector + 1, rays) % rays]


@njit()
def _sector_of(ray: int, rays: int) -> int:
    """Finds the sector that a ray is in."""
    for sector in range(paper.SECTORS - 1):
        if ray < first_ray(sector + 1, rays):
            return sector
    return paper.SECTORS - 1


@njit()
def completed(
    distances: Array, dead: NDArray[np.bool_], expected: Array, sensor: Array, sensor_range: float
) -> tuple[Array, Array]:
    """Completes a scan: a dead sector reads the smallest distance of the rays beside it and of remembered points in it.

    Args:
        distances: Ray distances (rays,) [m].
        dead: Whether each sector is dead (8,).
        expected: Expected positions of remembered points in the vehicle frame (rays, 2) [m]; NaN for none.
        sensor: Origin of the rays in the vehicle frame: x, y [m].
        sensor_range: Distance of a ray that meets nothing [m].

    Returns:
        The distances (rays,) [m], and the remembered point of each ray in a dead sector (rays, 2) [m].
    """
    rays = len(distances)
    whole, remembered = np.empty(rays), np.full((rays, 2), np.nan)
    for ray in range(rays):
        whole[ray] = distances[ray]
    for sector in range(paper.SECTORS):
        if dead[sector]:
            right, left = borders(distances, sector)
            for ray in range(first_ray(sector, rays), min(first_ray(sector + 1, rays), rays)):
                whole[ray] = min(right, left)
    nearest = np.full(rays, sensor_range)
    for k in range(len(expected)):
        x, y = expected[k, 0], expected[k, 1]
        distance = np.hypot(x - sensor[0], y - sensor[1])
        if distance < sensor_range:
            ray = int(np.rint(place_among_rays(x, y, sensor, rays))) % rays
            if dead[_sector_of(ray, rays)] and distance < nearest[ray]:
                nearest[ray] = distance
                remembered[ray, 0], remembered[ray, 1] = x, y
                whole[ray] = min(whole[ray], distance)
    return whole, remembered
