"""The scan as a shield takes it: silent sensors completed, points of moving obstacles told apart, the past remembered.

The scan before judges both: a sensor that reads nothing against all evidence counts as dead (`sector_faults`), and a
point where nothing was seen before belongs to a moving obstacle. Points that stand still are remembered where the rays
miss them for a while, and whole scans for what they showed to be free (`seen_space`).
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.mapping.localization import found_pose
from nnql_bullet.mapping.point_cloud import is_moving
from nnql_bullet.mapping.sector_faults import ENOUGH, completed, contradictions, silent_sectors
from nnql_bullet.mapping.seen_space import APART, SCANS, TURNED, is_missed
from nnql_bullet.sensing import first_ray
from nnql_bullet.shield.setting import BEGUN, KNOWN, MOVING, POINTS, REMEMBERED, STANDING, Memory, Setting


@njit()
def perceive(
    p: Setting,
    m: Memory,
    distances: Array,
    target_distance: float,
    target_bearing: float,
    speed: float,
    readings: Array,
) -> None:
    """Takes a scan in: completes it, tells what moves, and remembers.

    Args:
        p: The setting.
        m: The memory; it is changed. `moved` becomes the present pose in the vehicle frame of the last decision.
        distances: Of the rays (rays,) [m]; they are completed.
        target_distance: Distance of a target that stays [m].
        target_bearing: Its bearing [rad].
        speed: Of the vehicle [m/s].
        readings: Room for the readings of the sectors by the completed scan (8,) [m].
    """
    target_x, target_y = target_distance * np.cos(target_bearing), target_distance * np.sin(target_bearing)
    if m.numbers[BEGUN] == 0:
        m.numbers[BEGUN] = 1
        for k in range(p.rays):
            m.rays[k] = -1.0
            m.points[k] = np.nan, np.nan
    moved = np.empty(3)
    found_pose(moved, m.moved, m.target, target_distance, target_bearing)
    strayed = np.hypot(moved[0] - m.moved[0], moved[1] - m.moved[1])
    c, s = np.cos(moved[2]), np.sin(moved[2])
    expected, seen = np.empty((p.rays, 2)), np.empty((p.rays, 2))
    for k in range(p.rays):
        m.moving[k] = False
        seen[k] = np.nan, np.nan
        if distances[k] < p.range:
            x = distances[k] * p.directions[k, 0] + p.sensor[0]
            y = distances[k] * p.directions[k, 1] + p.sensor[1]
            seen[k] = x, y
            m.moving[k] = is_moving(x, y, m.rays, moved, strayed, p.sensor)
        expected[k] = np.nan, np.nan
        if not np.isnan(m.points[k, 0]):
            dx, dy = m.points[k, 0] - moved[0], m.points[k, 1] - moved[1]
            expected[k] = dx * c + dy * s, dx * (-s) + dy * c
    dead = np.zeros(paper.SECTORS, np.bool_)
    if judge(p, m, distances, expected, speed, dead):
        whole, remembered = completed(distances, dead, expected, p.sensor, p.range)
        for k in range(p.rays):
            distances[k] = whole[k]
            if np.isnan(remembered[k, 0]):
                m.points[k] = seen[k, 0], seen[k, 1]
            else:
                m.points[k] = remembered[k, 0], remembered[k, 1]
            seen[k] = np.nan, np.nan
            if distances[k] < p.range:
                x = distances[k] * p.directions[k, 0] + p.sensor[0]
                y = distances[k] * p.directions[k, 1] + p.sensor[1]
                seen[k] = x, y
    else:
        for k in range(p.rays):
            m.points[k] = seen[k, 0], seen[k, 1]
    remember_scan(p, m, distances, moved, strayed)
    remember_points(p, m, seen, moved)
    m.target[0], m.target[1] = target_x, target_y
    m.moved[0], m.moved[1], m.moved[2] = moved[0], moved[1], moved[2]
    read(p, distances, readings)


@njit()
def judge(p: Setting, m: Memory, distances: Array, expected: Array, speed: float, dead: NDArray[np.bool_]) -> bool:
    """Updates the evidence against each sensor, marks the dead ones (8,), and tells whether there are any."""
    against = contradictions(distances, expected, p.sensor, p.range)
    silent = silent_sectors(distances, p.range)
    found = False
    for sector in range(paper.SECTORS):
        if not silent[sector]:
            m.evidence[sector] = 0.0
        elif speed >= p.standstill:
            m.evidence[sector] = m.evidence[sector] + against[sector]
        dead[sector] = m.evidence[sector] >= ENOUGH
        found = found or dead[sector]
    return found


@njit()
def remember_scan(p: Setting, m: Memory, distances: Array, moved: Array, strayed: float) -> None:
    """Puts a scan in front of those before; it replaces one from the same place, which tells no more."""
    c, s = np.cos(moved[2]), np.sin(moved[2])
    stands = np.hypot(moved[0], moved[1]) < APART and abs(moved[2]) < TURNED
    known = min(m.numbers[KNOWN], SCANS)
    for back in range(SCANS):
        j = SCANS - 1 - back  # the oldest first
        source = j if stands else j - 1
        if j >= 1 and source < known:
            dx, dy = m.poses[source, 0] - moved[0], m.poses[source, 1] - moved[1]
            m.poses[j] = dx * c + dy * s, dx * (-s) + dy * c, m.poses[source, 2] - moved[2]
            m.strayed[j] = m.strayed[source] + strayed
            for k in range(p.rays):
                m.scans[j, k] = m.scans[source, k]
    m.poses[0] = 0.0, 0.0, 0.0
    m.strayed[0] = 0.0
    m.numbers[KNOWN] = max(known, 1) if stands else min(known + 1, SCANS)
    for k in range(p.rays):
        m.scans[0, k] = distances[k] if p.seen[k] else 0.0
        m.rays[k] = distances[k] if p.seen[k] else -1.0


@njit()
def remember_points(p: Setting, m: Memory, seen: Array, moved: Array) -> None:
    """Keeps the points that the scan misses, adds those that it sees, and gathers all that there are now."""
    c, s = np.cos(moved[2]), np.sin(moved[2])
    count = 0
    for k in range(p.rays):
        if m.moving[k]:
            m.cloud[count] = seen[k, 0], seen[k, 1]
            m.closing[count] = p.box_speed
            count += 1
    m.numbers[MOVING] = count
    for k in range(p.rays):
        if not m.moving[k] and not np.isnan(seen[k, 0]):
            m.cloud[count] = seen[k, 0], seen[k, 1]
            m.closing[count] = 0.0
            count += 1
    kept = 0
    telling = np.empty(p.rays)
    for k in range(p.rays):
        telling[k] = m.scans[0, k]
    for k in range(min(m.numbers[STANDING], len(m.standing))):
        dx, dy, age = m.standing[k, 0] - moved[0], m.standing[k, 1] - moved[1], m.standing[k, 2]
        x, y = dx * c + dy * s, dx * (-s) + dy * c
        if age < REMEMBERED and is_missed(
            x, y, telling, p.sensor, p.first_angle, p.corridor, p.least_width / 4, p.margin / 2
        ):
            m.standing[kept] = x, y, age + 1.0
            kept += 1
            m.cloud[count] = x, y
            m.closing[count] = 0.0
            count += 1
    for k in range(p.rays):
        if not m.moving[k] and not np.isnan(seen[k, 0]):
            m.standing[kept] = seen[k, 0], seen[k, 1], 0.0
            kept += 1
    m.numbers[STANDING], m.numbers[POINTS] = kept, count


@njit()
def read(p: Setting, distances: Array, readings: Array) -> None:
    """The readings of the sectors (8,) [m]."""
    for sector in range(paper.SECTORS):
        first, last = first_ray(sector, p.rays), first_ray(sector + 1, p.rays)
        if p.middle:
            readings[sector] = min(distances[(first + last - 1) // 2], distances[(first + last) // 2])
        else:
            readings[sector] = distances[first]
            for k in range(p.rays):
                if first < k and k < last:
                    readings[sector] = min(readings[sector], distances[k])
