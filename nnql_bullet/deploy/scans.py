"""Scans of a real lidar, reduced to the rays that a policy sees: the nearest that any beam about a ray met.

What cannot be driven by is refused with a reason (`Unusable`); nothing is made up in its place.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import degrees, inf, isfinite, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.sensing import Sensor

MOST_BEAMS = 10_000
"""Beams of the largest scan that is taken."""
_MOST_ANGLE = 4 * pi
"""Largest angle of a beam that is taken: of a larger one, rounding would tell the direction [rad]."""
_SLACK = 1e-6
"""Share by which the arc about a ray is wider, so that rounding loses no beam at its end."""


class Unusable(Exception):
    """An input that cannot be driven by; its text is the reason."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One turn of a lidar in a plane, by the names of `sensor_msgs/LaserScan`.

    A distance of inf, or beyond `range_max`, met nothing; one of -inf, or below `range_min`, met something too near to
    be measured and counts as 0; NaN tells nothing (REP 117).
    """

    ranges: ArrayLike
    """Distance of each beam (beams,) [m]."""
    angle_min: float
    """Direction of the first beam, 0 ahead, left is positive [rad]."""
    angle_max: float
    """Direction of the last [rad]."""
    angle_increment: float
    """From each beam to the next [rad]; negative clockwise."""
    range_min: float
    """[m]"""
    range_max: float
    """[m]"""
    stamp: float
    """When it was made, by the clock that `Controller.step` is told of [s]."""
    frame: str = "laser"
    """Frame of the lidar."""


def rays_of(scan: Scan, sensor: Sensor, yaw: float = 0.0) -> Array:
    """Reduces a scan to the rays of a vehicle's sensor (rays,) [m].

    The arc about a ray reaches half-way to the next ray, or half-way to the next beam if beams are fewer. A ray that
    the sensor does not see (`Sensor.blind_arc_degrees`) reads the range, as in the simulators.

    Args:
        scan: Of a lidar that stands where the sensor does.
        sensor: What the policy sees by.
        yaw: Direction of the lidar's 0 in the vehicle frame [rad].

    Raises:
        Unusable: If the scan is damaged, or does not tell all that the sensor sees.
    """
    beams, first, increment, range_min, range_max = _numbers(scan)
    if not range_max >= sensor.range * (1 - _SLACK):
        raise Unusable(
            f"the scan reaches {range_max:g} m, and the vehicle's sensor {sensor.range:g} m: lower 'sensor.range'"
        )
    about = _beams_about(len(beams), first + yaw, increment, sensor.rays)
    uncovered = sensor.seen & (about[:, 0] < 0)
    if uncovered.any():
        raise Unusable(
            f"the scan has no beam at {degrees(sensor.angles[uncovered.argmax()]):.0f} degrees, where the vehicle's "
            "sensor sees: name what it does not see in 'sensor.blind_arc_degrees'"
        )
    if not beams.min() >= range_min:  # also where one is NaN
        beams = _told(beams, range_min)
    nearest = np.fmin.reduce(beams[about], axis=1)
    if np.isnan(nearest).any():
        silent = sensor.seen & np.isnan(nearest)
        if silent.any():
            at = degrees(sensor.angles[silent.argmax()])
            raise Unusable(f"{silent.sum()} of {sensor.rays} rays tell nothing: all beams are NaN at {at:.0f} degrees")
    return np.where(sensor.seen, np.minimum(nearest, sensor.range), sensor.range)


def _numbers(scan: Scan) -> tuple[Array, float, float, float, float]:
    """Distances of a scan (beams,) [m], its first angle, its increment [rad], its least and largest range [m].

    Raises:
        Unusable: If they are no such numbers, or the distances are not as many as the angles say.
    """
    try:
        beams = np.asarray(scan.ranges, np.float64)
        first, last, increment = float(scan.angle_min), float(scan.angle_max), float(scan.angle_increment)
        range_min, range_max = float(scan.range_min), float(scan.range_max)
    except (TypeError, ValueError, OverflowError):
        raise Unusable("the scan holds something else than numbers") from None
    if beams.ndim != 1 or not 0 < len(beams) <= MOST_BEAMS:
        raise Unusable(f"the scan has {beams.size} beams in {beams.ndim} dimensions")
    usable = abs(first) <= _MOST_ANGLE and abs(last) <= _MOST_ANGLE and isfinite(increment) and increment != 0
    if not (usable and 0 <= range_min < inf):
        raise Unusable("the scan has no usable angles and limits")
    steps = (last - first) / increment
    if not abs(steps + 1 - len(beams)) <= 1.5:  # some drivers count one more or one less
        raise Unusable(f"the scan has {len(beams)} beams where its angles make {steps + 1:.0f}")
    return beams, first, increment, range_min, range_max


def _told(beams: Array, range_min: float) -> Array:
    """The distances with 0 for what is too near (beams,).

    Raises:
        Unusable: If one is negative.
    """
    negative = (beams < 0) & np.isfinite(beams)
    if negative.any():
        place = int(negative.argmax())
        raise Unusable(f"beam {place} of the scan reads {beams[place]:g} m")
    return np.where(beams < range_min, 0.0, beams)


@lru_cache(maxsize=8)
def _beams_about(beams: int, first: float, increment: float, rays: int) -> NDArray[np.int64]:
    """The beams about each ray (rays, most), the first again where there are fewer, and -1 where there is none."""
    spacing = 2 * pi / rays
    half = max(spacing, abs(increment)) / 2 * (1 + _SLACK)
    angles = Sensor(position=(0.0, 0.0, 0.0), rays=rays).angles
    away = np.abs((first + increment * np.arange(beams) - angles[:, None] + pi) % (2 * pi) - pi) <= half
    most = max(int(away.sum(axis=1).max()), 1)
    order = np.argsort(~away, axis=1, kind="stable")[:, :most]
    near = np.take_along_axis(away, order, axis=1)
    return np.where(near, order, np.where(near[:, :1], order[:, :1], -1))
