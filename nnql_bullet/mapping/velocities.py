"""How fast what a scan shows moves: each connected group of points is matched with the scans before.

The velocity is the one that brings the group nearest to the outlines seen before, and what was seen where now is
nothing to the present outline (scan matching as in Lu and Milios, "Robot pose estimation in unknown environments by
matching 2D range scans", 1997, by trying a coarse fan of velocities, and finer ones about the best). Along a straight
side without an end in view the velocity is not told by the points; the least is taken.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.mapping.point_cloud import moving_points

PAST = 2
"""Number of earlier scans that a scan is matched with: as many as a slow obstacle needs to move visibly."""
CONNECTED = 1.0
"""Largest distance between neighbouring points of one group, over the length scale [m]."""
FEWEST = 2
"""Least number of points of a group that may move, and of points that show it; one alone may be a pole that stood
between two rays."""
FARTHEST = 0.5
"""Distance from the outline beyond which a point counts alike, over the length scale [m]. It may be newly in view."""
RELUCTANCE = 0.05
"""What a velocity costs beside the distance that remains, as a share of the way in a period."""
CONVINCING = 0.8
"""Share of the cost of standing still that a velocity has to undercut."""
_DIRECTIONS, _SPEEDS, _REFINEMENTS = 12, 3, 2
"""Directions and speeds of the fan that is tried, and how often the best is then refined."""


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
        before: Of k earlier scans, the newest first (n, k, r) [m]; NaN where there was none.
        poses: Of the vehicles, in any fixed frame (n, 3).
        poses_then: Of then (n, k, 3).
        sensor: Origin of the rays in the vehicle frame (2,) [m].
        angles: Of the rays (r,) [rad].
        sensor_range: Distance of a ray that meets nothing [m].
        period: Time between the scans [s].
        fastest: Largest speed of an obstacle [m/s].
        scale: Length scale; see `vehicle.scale`.
    """
    n, past, r = before.shape
    found = np.zeros((n, r, 2))
    gap = CONNECTED * scale
    for i in range(n):
        now, then = _points(rays[i], sensor, angles, sensor_range), np.full((past, r, 2), np.nan)
        signs, gone = np.zeros(r, np.int64), np.zeros((past, r), np.bool_)
        for k in range(past):
            if np.isnan(before[i, k]).all():
                continue
            moved, back = _moved(poses_then[i, k], poses[i]), _moved(poses[i], poses_then[i, k])
            points = _points(before[i, k], sensor, angles, sensor_range)
            signs += moving_points(now, before[i, k], moved, 0.0, sensor)
            gone[k] = moving_points(points, rays[i], back, 0.0, sensor)
            c, s = np.cos(back[2]), np.sin(back[2])
            then[k, :, 0] = back[0] + c * points[:, 0] - s * points[:, 1]
            then[k, :, 1] = back[1] + s * points[:, 0] + c * points[:, 1]
        if not signs.any() and not gone.any():
            continue
        group = _groups(now, gap)
        owner = _owners(now, group, then, gone, gap, fastest * period)
        for g in range(group.max() + 1):
            members, its = np.flatnonzero(group == g), owner == g
            if len(members) >= FEWEST and signs[members].sum() + its.sum() >= FEWEST:
                found[i, members] = _velocity(now, members, then, its, period, fastest, scale)
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
def _owners(
    now: Array, group: NDArray[np.int64], then: Array, gone: NDArray[np.bool_], gap: float, way: float
) -> NDArray[np.int64]:
    """The group nearest to each earlier point that is gone, and that it may have moved to (k, r); -1 for none."""
    owner = np.full(gone.shape, -1)
    for k in range(len(then)):
        for j in np.flatnonzero(gone[k]):
            nearest = (way * (k + 1) + gap) ** 2
            for m in np.flatnonzero(group >= 0):
                squared = (now[m, 0] - then[k, j, 0]) ** 2 + (now[m, 1] - then[k, j, 1]) ** 2
                if squared < nearest:
                    nearest, owner[k, j] = squared, group[m]
    return owner


@njit(nogil=True)
def _velocity(
    now: Array,
    members: NDArray[np.int64],
    then: Array,
    gone: NDArray[np.bool_],
    period: float,
    fastest: float,
    scale: float,
) -> Array:
    """The velocity of a group of points (2,) [m/s]; 0 where none is much better than to stand.

    Args:
        now: Points of the scan (r, 2) [m]; NaN for none.
        members: Those of the group.
        then: Points of the earlier scans, in the same frame (k, r, 2) [m].
        gone: Those that are no longer there, and may be the group's (k, r).
        period: Time between the scans [s].
        fastest: Largest speed [m/s].
        scale: Length scale.
    """
    past = len(then)
    sides, counts = np.empty((past + 1, now.shape[0], 4)), np.zeros(past + 1, np.int64)
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for m in members:
        low, high = np.minimum(low, now[m]), np.maximum(high, now[m])
    reach = fastest * period * past + (FARTHEST + CONNECTED) * scale
    for k in range(past + 1):
        counts[k] = _sides(then[k] if k < past else now, low - reach, high + reach, CONNECTED * scale, sides[k])
    stands = _mismatch(now, members, then, gone, sides, counts, period, 0.0, 0.0, scale)
    best, best_x, best_y = stands, 0.0, 0.0
    for k in range(1, _SPEEDS + 1):
        for j in range(_DIRECTIONS):
            x = fastest * k / _SPEEDS * np.cos(2 * np.pi * j / _DIRECTIONS)
            y = fastest * k / _SPEEDS * np.sin(2 * np.pi * j / _DIRECTIONS)
            cost = _mismatch(now, members, then, gone, sides, counts, period, x, y, scale)
            if cost < best:
                best, best_x, best_y = cost, x, y
    step = fastest / _SPEEDS
    for _ in range(_REFINEMENTS):
        step, middle_x, middle_y = step / 2, best_x, best_y
        for k in range(9):
            x, y = middle_x + (k // 3 - 1) * step, middle_y + (k % 3 - 1) * step
            cost = _mismatch(now, members, then, gone, sides, counts, period, x, y, scale)
            if x * x + y * y <= fastest * fastest and cost < best:
                best, best_x, best_y = cost, x, y
    return np.array((best_x, best_y)) if best < CONVINCING * stands else np.zeros(2)


@njit(nogil=True)
def _sides(outline: Array, low: Array, high: Array, gap: float, sides: Array) -> int:
    """Lists the points of an outline in a rectangle with the neighbours they are connected to; returns how many.

    Each with its neighbour (r, 4) [m], or with itself if they are farther apart than a gap.
    """
    count = 0
    for j in range(len(outline)):
        (ax, ay), (bx, by) = outline[j - 1], outline[j]  # the last is the neighbour of the first
        if low[0] < bx < high[0] and low[1] < by < high[1]:  # a ray without a point is not
            connected = (ax - bx) ** 2 + (ay - by) ** 2 <= gap * gap
            sides[count] = bx, by, ax if connected else bx, ay if connected else by
            count += 1
    return count


@njit(nogil=True)
def _mismatch(
    now: Array,
    members: NDArray[np.int64],
    then: Array,
    gone: NDArray[np.bool_],
    sides: Array,
    counts: NDArray[np.int64],
    period: float,
    x: float,
    y: float,
    scale: float,
) -> float:
    """Mean distance of a group, moved back by a velocity, and of what is gone, moved on, from the outlines [m]."""
    cap, past = FARTHEST * scale, len(then)
    cost, count = 0.0, 0
    for k in range(past):
        if np.isnan(then[k]).all():
            continue
        time, here = period * (k + 1), sides[k, : counts[k]]
        for m in members:
            cost += _distance(now[m, 0] - x * time, now[m, 1] - y * time, here, cap)
        there = sides[past, : counts[past]]
        for j in range(gone.shape[1]):
            if gone[k, j]:
                cost += _distance(then[k, j, 0] + x * time, then[k, j, 1] + y * time, there, cap)
                count += 1
        count += len(members)
    return float(cost / max(count, 1) + RELUCTANCE * period * np.hypot(x, y))


@njit(nogil=True)
def _distance(x: float, y: float, sides: Array, most: float) -> float:
    """The distance of a place from sides (m, 4) [m], up to `most`."""
    nearest = most * most
    for j in range(len(sides)):
        dx, dy = x - sides[j, 0], y - sides[j, 1]
        along_x, along_y = sides[j, 2] - sides[j, 0], sides[j, 3] - sides[j, 1]
        squared = along_x * along_x + along_y * along_y
        if squared > 0.0:
            share = min(max((dx * along_x + dy * along_y) / squared, 0.0), 1.0)
            dx, dy = dx - share * along_x, dy - share * along_y
        nearest = min(nearest, dx * dx + dy * dy)
    return float(np.sqrt(nearest))
