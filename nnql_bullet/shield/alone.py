"""The shield's decision for one vehicle, in the part of Python that `exports.translation` writes as other languages.

It decides as `shield.Shield` does that leads no vehicle (`ShieldOptions.recovers` off) and follows no plan, around an
agent that chooses among the six actions and is not told what it did instead. It keeps what it remembers in arrays of
fixed size, and calls the same kernels. A decision is `perceive`, then the agent by the readings and rays that it gives,
then `choose`.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import ACTIONS, LARGEST_TURN
from nnql_bullet.geometry import Array, wrap_angle
from nnql_bullet.mapping.point_cloud import is_moving
from nnql_bullet.mapping.sector_faults import ENOUGH, completed, contradictions, silent_sectors
from nnql_bullet.mapping.seen_space import APART, SCANS, TURNED, is_missed
from nnql_bullet.sensing import first_ray
from nnql_bullet.shield.fallback import first_choice
from nnql_bullet.shield.perception import REMEMBERED
from nnql_bullet.shield.prediction import clear_by_margin, sort, wanted_speed
from nnql_bullet.shield.setting import (
    ASKED,
    BACKS,
    BEGUN,
    DECISIONS,
    KNOWN,
    MOVING,
    POINTS,
    SIDE,
    STANDING,
    Memory,
    Setting,
)
from nnql_bullet.vehicle.profiles import profile_at, ramp_at, turn_profile


def perceive(
    p: Setting,
    m: Memory,
    distances: Array,
    target_distance: float,
    target_bearing: float,
    speed: float,
    readings: Array,
) -> None:
    """Takes a scan in, as `perception.perceived`: completes it, tells what moves, and remembers.

    Args:
        p: The setting.
        m: The memory; it is changed.
        distances: Of the rays (rays,) [m]; they are completed.
        target_distance: Distance of the target, which stays [m].
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
    locate(moved, m.moved, m.target, target_distance, target_bearing)
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
    read(p, distances, readings)


def locate(found: Array, predicted: Array, before: Array, distance: float, bearing: float) -> None:
    """`localization.found_pose`, of the target's place before (2,) [m], into `found` (3,)."""
    x, y, yaw = predicted[0], predicted[1], predicted[2]
    off = heading_to(x, y, yaw, before, bearing) - yaw
    c, s = np.cos(off / 2), np.sin(off / 2)
    x, y = c * x - s * y, s * x + c * y
    toward = np.arctan2(before[1] - y, before[0] - x)
    found[0] = before[0] - distance * np.cos(toward)
    found[1] = before[1] - distance * np.sin(toward)
    found[2] = heading_to(x, y, yaw, before, bearing)


def heading_to(x: float, y: float, yaw: float, place: Array, bearing: float) -> float:
    """The heading of a vehicle at (x, y) that sees a place at a bearing, near to a heading [rad]."""
    return yaw + wrap_angle(np.arctan2(place[1] - y, place[0] - x) - bearing - yaw)


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


def remember_scan(p: Setting, m: Memory, distances: Array, moved: Array, strayed: float) -> None:
    """Puts a scan in front of those before, as `seen_space.RecentScans.followed_by`."""
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


def choose(
    p: Setting,
    m: Memory,
    values: Array,
    valued: bool,
    wanted: int,
    target_bearing: float,
    yaw_rate: float,
    speed: float,
) -> int:
    """The manoeuvre in place of what an agent wants, as `Shield.act`.

    Args:
        p: The setting.
        m: The memory; it is changed.
        values: The agent's values of the five turns (5,).
        valued: Whether it has them here.
        wanted: The action that it wants.
        target_bearing: Bearing of the target [rad].
        yaw_rate: Of the vehicle [rad/s].
        speed: Of the vehicle [m/s].
    """
    turns = np.empty(ACTIONS)
    for a in range(len(paper.TURNS)):
        turns[a] = paper.TURNS[a]
    turns[ACTIONS - 1] = min(max(target_bearing, -LARGEST_TURN), LARGEST_TURN)
    order = np.empty(ACTIONS, np.int64)
    rank(order, values, valued, wanted, turns)
    clear = np.empty(ACTIONS, np.bool_)
    margin = clear_by_margin(p, m, turns, yaw_rate, speed, clear)
    chosen = first_choice(p, m, turns, order, clear, clear, target_bearing, yaw_rate, speed, margin, 0)
    foresee(p, m, chosen, turns[chosen % ACTIONS], yaw_rate, speed)
    return chosen


def rank(order: NDArray[np.int64], values: Array, valued: bool, wanted: int, turns: Array) -> None:
    """The six actions, the best first (6,); see `shield.action_ranks`."""
    toward, least = 0, abs(paper.TURNS[0] - turns[ACTIONS - 1])
    for a in range(1, len(paper.TURNS)):
        off = abs(paper.TURNS[a] - turns[ACTIONS - 1])
        if off < least:
            toward, least = a, off
    ranks = np.empty(ACTIONS)
    for a in range(ACTIONS):
        if valued:
            ranks[a] = values[a] if a < ACTIONS - 1 else values[toward]
        else:
            ranks[a] = -abs(turns[a] - turns[wanted])
    ranks[wanted] = np.inf
    sort(order, ranks)


def foresee(p: Setting, m: Memory, chosen: int, turn: float, yaw_rate: float, speed: float) -> None:
    """Remembers the pose that the vehicle should have at the next decision, and ends its turning on the spot."""
    goal = wanted_speed(p, chosen)
    peak, rise, hold, fall = turn_profile(yaw_rate, turn, p.limits[ASKED, 0], p.limits[ASKED, 1])
    x, y, heading, was = 0.0, 0.0, 0.0, speed
    for k in range(len(p.moved_times)):
        before = heading
        _, heading = profile_at(yaw_rate, peak, rise, hold, fall, p.moved_times[k])
        now = ramp_at(speed, goal, p.acceleration, p.moved_times[k])
        length, middle = (now + was) / 2 * p.moved_steps[k], heading - (heading - before) / 2
        x, y, was = x + length * np.cos(middle), y + length * np.sin(middle), now
    m.moved[0], m.moved[1], m.moved[2] = x, y, heading
    if goal > 0 and speed >= 0.9 * goal:
        m.numbers[SIDE], m.numbers[DECISIONS], m.numbers[BACKS] = 0, 0, 0
