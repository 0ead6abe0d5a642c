"""How fast what a scan shows moves: each connected group of points is matched with the scan before.

The shift is the one that brings the group nearest to the outline seen before (scan matching as in Lu and Milios, "Robot
pose estimation in unknown environments by matching 2D range scans", 1997, by trying all shifts of a coarse fan). Along
a straight side the shift is not told by the points; the least is taken.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.mapping.point_cloud import moving_points

CONNECTED = 0.5
"""Largest distance between neighbouring points of one group, over the length scale [m]."""
FEWEST = 2
"""Least number of points of a group that may move; one alone may be a pole that stood between two rays."""
FARTHEST = 0.3
"""Distance from the outline beyond which a point counts alike, over the length scale [m]. It may be newly in view."""
RELUCTANCE = 0.2
"""What a shift costs beside the distance that remains, as a share of its length."""
_DIRECTIONS, _LENGTHS = 24, 6
"""Directions, and lengths in each, of the shifts that are tried."""


@njit(nogil=True)
def velocities(
    rays: Array,
    before: Array,
    poses: Array,
    poses_then: Array,
    sensor: Array,
    angles: Array,
    sensor_range: float,
    period: float,
    fastest: float,
    scale: float,
) -> Array:
    """Estimates the velocity of each point of n scans, in the present vehicle frame (n, r, 2) [m/s]; 0 if it stands.

    Args:
        rays: Distances of the scans, evenly spaced all around (n, r) [m]; NaN for rays that are not seen.
        before: Of the scans before (n, r) [m]; NaN where there was none.
        poses: Of the vehicles, in any fixed frame (n, 3).
        poses_then: Of then (n, 3).
        sensor: Origin of the rays in the vehicle frame (2,) [m].
        angles: Of the rays (r,) [rad].
        sensor_range: Distance of a ray that meets nothing [m].
        period: Time between the scans [s].
        fastest: Largest speed of an obstacle [m/s].
        scale: Length scale; see `vehicle.scale`.
    """
    n, r = rays.shape
    found = np.zeros((n, r, 2))
    gap, cap = CONNECTED * scale, FARTHEST * scale
    for i in range(n):
        now, then = _points(rays[i], sensor, angles, sensor_range), _points(before[i], sensor, angles, sensor_range)
        moved = _moved(poses_then[i], poses[i])
        moving = moving_points(now, before[i], moved, 0.0, sensor)
        if not moving.any():
            continue
        c, s = np.cos(moved[2]), np.sin(moved[2])
        places = np.empty_like(now)
        places[:, 0] = moved[0] + c * now[:, 0] - s * now[:, 1]
        places[:, 1] = moved[1] + s * now[:, 0] + c * now[:, 1]
        group = _groups(now, gap)
        for g in range(group.max() + 1):
            members = np.flatnonzero(group == g)
            if len(members) < FEWEST or not moving[members].any():
                continue
            x, y = _shift(places[members], then, gap, cap, period * fastest)
            found[i, members, 0], found[i, members, 1] = (c * x + s * y) / period, (c * y - s * x) / period
    return found


@njit(nogil=True)
def _moved(before: Array, now: Array) -> Array:
    """A pose in the frame of another (3,)."""
    c, s = np.cos(before[2]), np.sin(before[2])
    dx, dy = now[0] - before[0], now[1] - before[1]
    return np.array((c * dx + s * dy, c * dy - s * dx, now[2] - before[2]))


@njit(nogil=True)
def _points(rays: Array, sensor: Array, angles: Array, sensor_range: float) -> Array:
    """The points where rays ended (r, 2) [m]; NaN where they met nothing."""
    points = np.full((len(rays), 2), np.nan)
    for j in range(len(rays)):
        if rays[j] < sensor_range:
            points[j, 0] = sensor[0] + rays[j] * np.cos(angles[j])
            points[j, 1] = sensor[1] + rays[j] * np.sin(angles[j])
    return points


@njit(nogil=True)
def _groups(points: Array, gap: float) -> NDArray[np.int64]:
    """Numbers the groups of neighbouring points that are at most a gap apart (r,); -1 for no point."""
    r = len(points)
    group, number = np.full(r, -1), -1
    for j in range(r):
        if np.isnan(points[j, 0]):
            continue
        if j == 0 or not np.hypot(points[j, 0] - points[j - 1, 0], points[j, 1] - points[j - 1, 1]) <= gap:
            number += 1
        group[j] = number
    if group[0] == 0 and np.hypot(points[0, 0] - points[-1, 0], points[0, 1] - points[-1, 1]) <= gap:
        group[group == number] = 0
    return group


@njit(nogil=True)
def _shift(places: Array, outline: Array, gap: float, cap: float, most: float) -> tuple[float, float]:
    """The shift, up to `most`, by which places (k, 2) came from an outline of points (r, 2) [m]."""
    best, best_x, best_y = np.inf, 0.0, 0.0
    for length in range(_LENGTHS + 1):
        way = most * length / _LENGTHS
        for direction in range(_DIRECTIONS if length > 0 else 1):
            x = way * np.cos(direction * 2 * np.pi / _DIRECTIONS)
            y = way * np.sin(direction * 2 * np.pi / _DIRECTIONS)
            cost = RELUCTANCE * way
            for k in range(len(places)):
                cost += _distance(places[k, 0] - x, places[k, 1] - y, outline, gap, cap) / len(places)
            if cost < best:
                best, best_x, best_y = cost, x, y
    return best_x, best_y


@njit(nogil=True)
def _distance(x: float, y: float, outline: Array, gap: float, most: float) -> float:
    """The distance of a place from points (r, 2) and the lines between neighbours, up to `most`."""
    nearest = most * most
    for j in range(len(outline)):
        ax, ay = outline[j - 1]  # the last is the neighbour of the first
        bx, by = outline[j]
        dx, dy = x - bx, y - by
        if not dx * dx + dy * dy < (gap + most) ** 2:  # nor is a ray without a point
            continue
        along_x, along_y = ax - bx, ay - by
        squared = along_x * along_x + along_y * along_y
        if 0.0 < squared <= gap * gap:
            share = min(max((dx * along_x + dy * along_y) / squared, 0.0), 1.0)
            dx, dy = dx - share * along_x, dy - share * along_y
        nearest = min(nearest, dx * dx + dy * dy)
    return float(np.sqrt(nearest))
