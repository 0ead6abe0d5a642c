"""The sensor: rays in the vehicle frame, and the readings of the paper's eight sectors from ray distances."""

from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit

RAYS = 72
"""Number of rays where nothing else is said."""
MOST_RAYS = 1440
"""Four rays for each degree. PyBullet casts 16 384 rays at a time, and no more."""
LONGEST_RANGE = 100.0
"""[m]"""
WIDEST_BLIND_ARC = 270.0
"""[degrees]"""
FRONT, FRONT_LEFT, FRONT_RIGHT = 0, 1, 7
"""Indices of sectors: sector 0 is centred straight ahead, the others follow counter-clockwise."""


def _checked_arc(arc: tuple[float, float]) -> tuple[float, float]:
    """Refuses a blind arc that has no width or hides too much."""
    if not 0 < (arc[1] - arc[0]) % 360 <= WIDEST_BLIND_ARC:
        raise ValueError(
            f"a blind arc leads counter-clockwise from its first angle to its second, over at most "
            f"{WIDEST_BLIND_ARC:g} degrees, not from {arc[0]:g} to {arc[1]:g}"
        )
    return arc


_Degrees = Annotated[float, Field(ge=-360, le=360)]
RayCount = Annotated[int, Field(ge=paper.SECTORS, le=MOST_RAYS, multiple_of=4)]
SensorRange = Annotated[float, Field(gt=0, le=LONGEST_RANGE)]
BlindArc = Annotated[tuple[_Degrees, _Degrees], AfterValidator(_checked_arc)]


@options
class Sensor:
    """A range sensor: rays in one plane, evenly spaced all round. A ray that meets nothing reads the range."""

    position: tuple[float, float, float]
    """Origin of the rays: x, y, z in the chassis frame [m]."""
    rays: RayCount = RAYS
    """Number of rays, a multiple of 4. Where it is not one of 8, every other sector has a ray more."""
    range: SensorRange = paper.SENSOR_RANGE
    """Length of a ray that meets nothing [m]."""
    blind_arc_degrees: BlindArc | None = None
    """Angles, counter-clockwise from the first to the second, between which the sensor sees nothing, as behind a mast;
    0 is ahead, left is positive [degrees]. A blind ray reads the range too."""

    @cached_property
    def angles(self) -> Array:
        """Directions of the rays in the vehicle frame (rays,) [rad]."""
        return ray_angles(self.rays)

    @cached_property
    def directions(self) -> Array:
        """Directions of the rays in the vehicle frame as unit vectors (rays, 2)."""
        return np.stack([np.cos(self.angles), np.sin(self.angles)], axis=-1)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Whether each ray sees (rays,); the others are in the blind arc, and their distance says nothing."""
        if self.blind_arc_degrees is None:
            return np.ones(self.rays, np.bool_)
        begin, end = self.blind_arc_degrees
        # Rounding leaves no ray at the end of the arc outside it.
        return np.asarray((np.degrees(self.angles) - begin + 1e-6) % 360 > (end - begin) % 360 + 2e-6)

    def met(self, distances: Array) -> NDArray[np.bool_]:
        """Whether rays met something (...), of distances (...) [m]."""
        return np.asarray(distances < self.range)


def ray_angles(rays: int = RAYS) -> Array:
    """Directions of rays in the vehicle frame (rays,) [rad]: evenly spaced, the same to the left and to the right.

    The first is that of sector 0, in its right corner. Every odd multiple of 72 rays contains the same 72.
    """
    return np.asarray(_in_72(np.arange(rays), rays) * (paper.SECTOR_ANGLE / (RAYS // paper.SECTORS)))


def nearest_rays(rays: int) -> NDArray[np.int64]:
    """Of so many rays, those that are nearest to each of 72 (72,); of an odd multiple of 72, the same."""
    first, wanted = _in_72(np.array(0), rays), _in_72(np.arange(RAYS), RAYS)
    return np.rint((wanted - first) * (rays / RAYS)).astype(np.int64) % rays


def _in_72(places: NDArray[np.int64], rays: int) -> Array:
    """The places of rays among `rays` rays, as places among 72 from straight ahead; exact for common places."""
    ahead = (first_ray(1, rays) - 1) / 2
    return np.asarray((places - ahead) * (RAYS // paper.SECTORS) / (rays / paper.SECTORS))


@njit()
def first_ray(sector: int, rays: int) -> int:
    """Finds the first ray of a sector, of so many rays; that of sector 8 is the number of rays.

    Where sectors cannot have as many rays each, the numbers are such that a ray points straight ahead.
    """
    return (sector * rays + (0 if rays // paper.SECTORS % 2 else paper.SECTORS - 1)) // paper.SECTORS


def middle_readings(distances: Array) -> Array:
    """Takes the readings of sectors (..., 8) [m] from the ray in the middle of each, of distances (..., rays) [m].

    An even number of rays in a sector has two in the middle; the shorter one counts.
    """
    first = np.array([first_ray(sector, distances.shape[-1]) for sector in range(paper.SECTORS + 1)])
    twice = first[:-1] + first[1:]
    return np.minimum(distances[..., (twice - 1) // 2], distances[..., twice // 2])


def sector_readings(distances: Array) -> Array:
    """Takes the readings of sectors (..., 8) [m] from the shortest ray of each, of distances (..., rays) [m]."""
    rows: Array = _smallest_by_sector(distances.reshape(-1, distances.shape[-1]))
    return rows.reshape(*distances.shape[:-1], paper.SECTORS)


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


@njit()
def _smallest_by_sector(rows: Array) -> Array:
    """Finds the smallest value in each sector (k, 8) of each row (k, rays)."""
    found = np.empty((len(rows), paper.SECTORS))
    for i in range(len(rows)):
        for sector in range(paper.SECTORS):
            first = first_ray(sector, rows.shape[1])
            found[i, sector] = rows[i, first]
            for j in range(first + 1, first_ray(sector + 1, rows.shape[1])):
                found[i, sector] = min(found[i, sector], rows[i, j])
    return found
