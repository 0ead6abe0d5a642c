"""What each manoeuvre would come to, by the vehicle's own model and a map of what was seen: its room, and the way left.

Every manoeuvre is driven in thought for a decision, and then to a stand. The footprint's clearance from the points of
the map and of the last scan is exact but for what stands between two points; the way left is that of `body_map`. After
the dynamic window approach (Fox, Burgard and Thrun, 1997), with the cost to go of a map in place of the direction of
the goal (Brock and Khatib, "High-speed navigation using the global dynamic window approach", ICRA 1999).
"""

from math import floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, reach_of, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.mapping.body_map import (
    FARTHER,
    SIDE,
    UNSEEN,
    Cells,
    Lengths,
    Offsets,
    cost_at,
    open_until,
)
from nnql_bullet.vehicle.profiles import sample_profile, sample_ramp, turn_profile

ROOM, STOP_ROOM, LASTS, WAY, WAY_AHEAD, UNKNOWN, VISITS = range(7)
"""Columns of what is foreseen of a manoeuvre: smallest clearance while it is driven, and then to a stand [m], up to
`MOST_ROOM`; share of all that until the first contact, 1 if there is none; how much longer the way from its end is than
from here, and from a place as far ahead of its end as the vehicle reaches [m]; share of places under the vehicle that
were never seen; and how often the vehicle was at its end lately, up to `MOST_VISITS`."""
COLUMNS = 7
MOST_VISITS = 4
"""Number of visits that is not told from more."""
MOST_ROOM = 0.6
"""Clearance that is enough, over the length scale [m]."""
BEARINGS = 24
"""Number of directions about the vehicle in which the map is probed, from straight ahead counter-clockwise."""
REACHES = (1.25, 2.5)
"""Distances at which the way left is probed, over the length scale [m]."""
SIGHT = 5.0
"""Largest distance to what is not known to be free, over the length scale [m]."""
_DRIVEN, _STOPPING = 5, 10
"""Number of poses while a manoeuvre is driven, and most while the vehicle then brakes."""
_NEAR = 3.6
"""Distance up to which points may be met, over the length scale [m]."""
_MOVING_NEAR = 8.0
"""The same of points that move [m]."""
_WAKE = 2.0
"""Distance from a moving point up to which points of the map are the same obstacle [cells]."""
_ALONE = 0.02, 0.45
"""A point stands alone if no other is farther than the first from it and nearer than the second, over the length scale
[m]: what it is of may be wider than it looks."""
_UNSEEN_EXTENT = 0.08
"""By so much, likewise [m]."""
_THICK, _THIN_SIGHT = 0.12, 3.4
"""It is of something thin if none is farther than this and nearer than the second, likewise [m]; up to that distance
from the vehicle, for farther away, sides that are seen at a slant look like that."""
_SAME = 0.15, 0.25
"""How far from a pose counts as the same: over the length scale [m], and in heading [rad]."""


State = tuple[float, float, float, float, float]
"""A vehicle: x, y [m], heading [rad], speed [m/s] and yaw rate [rad/s]."""


class Mover(NamedTuple):
    """What the kernel knows of the vehicle and its drive."""

    cell: float
    """Side of a cell of the map [m]."""
    scale: float
    """Length scale; see `vehicle.scale`."""
    footprint: Array
    """A row (7,) of `geometry.as_rows`, in the vehicle's frame."""
    sensor: Array
    """Origin of the rays in the vehicle frame (2,) [m]."""
    angles: Array
    """Of the rays (r,) [rad]."""
    sensor_range: float
    """[m]"""
    max_rate: float
    """Limit on the yaw rate [rad/s]."""
    yaw_acceleration: float
    """Limit on the yaw acceleration [rad/s2]."""
    acceleration: float
    """Limit on acceleration and deceleration [m/s2]."""
    period: float
    """Time between decisions [s]."""


@njit(nogil=True)
def foresee(
    cells: Cells,
    offsets: Offsets,
    corners: NDArray[np.int64],
    poses: Array,
    trails: Array,
    factors: Lengths,
    left: Lengths,
    rays: Array,
    moving: Array,
    speeds: Array,
    yaw_rates: Array,
    turns: Array,
    goals: Array,
    mover: Mover,
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Looks ahead for n vehicles.

    Args:
        cells: Maps (n, SIDE, SIDE).
        offsets: See `body_map.add_scans`.
        corners: First cells of the maps (n, 2).
        poses: Of the vehicles, in the landmark's frame (n, 3).
        trails: Poses at the last decisions and now, likewise (n, t, 3); infinite for none.
        factors: See `body_map.ways_to` (n, SIDE, SIDE).
        left: Likewise (n, SIDE, SIDE).
        rays: Distances of the last scan (n, r) [m].
        moving: Velocities of its points in the vehicle frame (n, r, 2) [m/s].
        speeds: (n,) [m/s]
        yaw_rates: (n,) [rad/s]
        turns: Heading changes of the m manoeuvres (n, m) [rad].
        goals: Speeds that they ask for (m,) [m/s].
        mover: The vehicle.

    Returns:
        What is foreseen of the manoeuvres (n, m, COLUMNS); for `BEARINGS`, how much longer the way from `REACHES` is,
        and the distance up to which all is known to be free (n, 3, BEARINGS) [m]; the cost of the way left (n,) [m];
        and whether something thin stands near (n,).
    """
    n = len(cells)
    seen, around = np.empty((n, turns.shape[1], COLUMNS)), np.empty((n, 3, BEARINGS))
    ways, thin = np.empty(n), np.empty(n, np.bool_)
    points, cell = np.empty((SIDE * SIDE + rays.shape[1], 5)), mover.cell
    for i in range(n):
        corner, pose = corners[i], poses[i]
        here = cost_at(left[i], corner, pose[0], pose[1], cell, np.inf)
        most = here + FARTHER
        ways[i] = here * cell
        count = points_near(cells[i], offsets[i], corner, pose, rays[i], moving[i], mover, points)
        thin[i] = is_thin(points[:count], mover.scale)
        for j in range(turns.shape[1]):
            _drive(
                cells[i],
                corner,
                pose,
                trails[i],
                factors[i],
                left[i],
                here,
                points[:count],
                speeds[i],
                yaw_rates[i],
                turns[i, j],
                goals[j],
                mover,
                seen[i, j],
            )
        for j in range(BEARINGS):
            c, s = np.cos(pose[2] + j * 2 * np.pi / BEARINGS), np.sin(pose[2] + j * 2 * np.pi / BEARINGS)
            for k in range(2):
                steps = int(REACHES[k] * mover.scale / cell)
                around[i, k, j] = FARTHER * cell
                if open_until(factors[i], corner, pose[0] / cell, pose[1] / cell, c, s, steps) == steps:
                    way = steps * cell
                    there = cost_at(left[i], corner, pose[0] + c * way, pose[1] + s * way, cell, most)
                    around[i, k, j] = (there - here) * cell
            around[i, 2, j] = _known_free(cells[i], corner, pose, c, s, mover)
    return seen, around, ways, thin


@njit(nogil=True)
def points_near(
    cells: Cells,
    offsets: Offsets,
    corner: NDArray[np.int64],
    pose: Array,
    rays: Array,
    moving: Array,
    mover: Mover,
    points: Array,
) -> int:
    """Lists the points of a map and of the last scan near a vehicle, in its frame, into `points`; returns how many.

    Each with its velocity, and how far it may reach (k, 5) [m, m/s]. What the map holds near a moving point is that, or
    where it was, and left out.
    """
    most, cell, count = _NEAR * mover.scale, mover.cell, 0
    for j in range(len(rays)):
        moves = moving[j, 0] != 0.0 or moving[j, 1] != 0.0
        if rays[j] < min(_MOVING_NEAR * mover.scale if moves else most, mover.sensor_range):
            points[count, 0] = mover.sensor[0] + rays[j] * np.cos(mover.angles[j])
            points[count, 1] = mover.sensor[1] + rays[j] * np.sin(mover.angles[j])
            points[count, 2:4] = moving[j]
            count += 1
    movers = points[:count][(points[:count, 2] != 0.0) | (points[:count, 3] != 0.0)]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] / cell - corner[0], pose[1] / cell - corner[1]
    for a in range(max(int(x - most / cell), 0), min(int(x + most / cell) + 1, SIDE)):
        for b in range(max(int(y - most / cell), 0), min(int(y + most / cell) + 1, SIDE)):
            if cells[a, b] > 0:
                dx, dy = (a + offsets[a, b, 0] / 256 - x) * cell, (b + offsets[a, b, 1] / 256 - y) * cell
                at_x, at_y = c * dx + s * dy, c * dy - s * dx
                if not _beside(at_x, at_y, movers, _WAKE * cell):
                    points[count] = at_x, at_y, 0.0, 0.0, 0.0
                    count += 1
    _widen(points[:count], mover.scale)
    return count


@njit(nogil=True)
def _widen(points: Array, scale: float) -> None:
    """Writes how far what is seen at each point may reach beyond it, unseen between two rays, into the last column."""
    least, most = (_ALONE[0] * scale) ** 2, (_ALONE[1] * scale) ** 2
    for j in range(len(points)):
        points[j, 4] = _UNSEEN_EXTENT * scale if _is_alone(points, j, least, most) else 0.0


@njit(nogil=True)
def _is_alone(points: Array, j: int, least: float, most: float) -> bool:
    """Whether no other point is farther from one than the first distance, and nearer than the second, squared [m2]."""
    for k in range(len(points)):
        squared = (points[j, 0] - points[k, 0]) ** 2 + (points[j, 1] - points[k, 1]) ** 2
        if least < squared < most:
            return False
    return True


@njit(nogil=True)
def is_thin(points: Array, scale: float) -> bool:
    """Whether one of the points (k, 5) near a vehicle is of something thinner than the rays are apart."""
    least, most, sight = (_THICK * scale) ** 2, (_ALONE[1] * scale) ** 2, (_THIN_SIGHT * scale) ** 2
    for j in range(len(points)):
        if points[j, 0] ** 2 + points[j, 1] ** 2 < sight and _is_alone(points, j, least, most):
            return True
    return False


@njit(nogil=True)
def costs_from(
    end: State, left: Lengths, factors: Lengths, corner: NDArray[np.int64], pose: Array, most: float, mover: Mover
) -> tuple[float, float]:
    """The costs of the ways to the target from a state, and from as far ahead of it as the vehicle reaches [cells].

    Args:
        end: The state, in the frame of the vehicle's present pose.
        left: See `body_map.costs_to_go` (SIDE, SIDE).
        factors: See `body_map.cost_factors` (SIDE, SIDE).
        corner: The map's first cell (2,).
        pose: Of the vehicle now (3,).
        most: Largest cost that counts [cells].
        mover: The vehicle.
    """
    cell = mover.cell
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + c * end[0] - s * end[1], pose[1] + s * end[0] + c * end[1]
    place = cost_at(left, corner, x, y, cell, most)
    c, s = np.cos(pose[2] + end[2]), np.sin(pose[2] + end[2])
    way = cell * open_until(factors, corner, x / cell, y / cell, c, s, int(mover.scale / cell))
    return place, cost_at(left, corner, x + c * way, y + s * way, cell, most)


@njit(nogil=True)
def visits(end: State, trail: Array, pose: Array, scale: float) -> int:
    """How often a vehicle was at a state's pose (k, 3)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + c * end[0] - s * end[1], pose[1] + s * end[0] + c * end[1]
    count = 0
    for k in range(len(trail)):
        near = (trail[k, 0] - x) ** 2 + (trail[k, 1] - y) ** 2 < (_SAME[0] * scale) ** 2
        count += near and np.cos(trail[k, 2] - pose[2] - end[2]) > np.cos(_SAME[1])
    return count


@njit(nogil=True)
def _beside(x: float, y: float, points: Array, most: float) -> bool:
    """Whether a place is less than a distance from one of the points (k, 5) [m]."""
    found = False
    for k in range(len(points)):
        found = found or (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 < most * most
    return found


@njit(nogil=True)
def _drive(
    cells: Cells,
    corner: NDArray[np.int64],
    pose: Array,
    trail: Array,
    factors: Lengths,
    left: Lengths,
    here: float,
    points: Array,
    speed: float,
    yaw_rate: float,
    turn: float,
    goal: float,
    mover: Mover,
    seen: Array,
) -> None:
    """Drives one manoeuvre in thought, then to a stand, and writes what is foreseen into `seen` (COLUMNS,)."""
    most_room = MOST_ROOM * mover.scale
    here_now = (0.0, 0.0, 0.0, speed, yaw_rate)
    driven, seen[ROOM], lasts = course(here_now, 0.0, turn, goal, mover.period, _DRIVEN, points, mover, most_room)
    stop = abs(driven[3]) / mover.acceleration
    count = min(int(np.ceil(stop / mover.period * _DRIVEN)), _STOPPING)
    stopped, seen[STOP_ROOM], more = course(driven, mover.period, 0.0, 0.0, stop, count, points, mover, most_room)
    seen[LASTS] = (lasts + (more if lasts == _DRIVEN else 0)) / (_DRIVEN + count)
    unseen = _unseen_corners(cells, corner, pose, driven[0], driven[1], driven[2], mover)
    unseen += _unseen_corners(cells, corner, pose, stopped[0], stopped[1], stopped[2], mover)
    place, ahead = costs_from(driven, left, factors, corner, pose, here + FARTHER, mover)
    seen[WAY], seen[WAY_AHEAD] = (place - here) * mover.cell, (ahead - here) * mover.cell
    seen[UNKNOWN] = unseen / 8
    seen[VISITS] = min(visits(driven, trail, pose, mover.scale), MOST_VISITS)


@njit(nogil=True)
def course(
    start: State,
    time: float,
    turn: float,
    goal: float,
    duration: float,
    count: int,
    points: Array,
    mover: Mover,
    most: float,
) -> tuple[State, float, int]:
    """Drives in thought: returns the state in the end, the smallest clearance, and the poses before the first contact.

    Args:
        start: Where it begins.
        time: When, from now on [s].
        turn: Heading change that is asked for [rad].
        goal: Speed that is asked for [m/s].
        duration: [s]
        count: Number of poses at which the clearance is computed.
        points: That may be met, in the frame of the state, where they are now and their velocity, and how
            far they reach (k, 5) [m, m/s].
        mover: The vehicle.
        most: Clearance that is enough [m].
    """
    x, y, heading, speed, rate = start
    begin, room, lasts = heading, most, count
    times = np.arange(1.0, count + 1.0) * (duration / max(count, 1))
    headings, rates, speeds = np.empty(count), np.empty(count), np.empty(count)
    peak, rise, hold, fall = turn_profile(rate, turn, mover.max_rate, mover.yaw_acceleration)
    sample_profile(rate, peak, rise, hold, fall, times, rates, headings)
    sample_ramp(speed, goal, mover.acceleration, times, speeds)
    for k in range(count):
        length, middle = (speed + speeds[k]) / 2 * (duration / count), (heading + begin + headings[k]) / 2
        x, y = x + length * np.cos(middle), y + length * np.sin(middle)
        heading, speed, rate = begin + headings[k], speeds[k], rates[k]
        room = min(room, _room(x, y, heading, time + times[k], points, mover.footprint, room))
        if room <= 0.0 and lasts == count:
            lasts = k
    return (x, y, heading, speed, rate), room, lasts


@njit(nogil=True)
def _room(x: float, y: float, heading: float, time: float, points: Array, footprint: Array, most: float) -> float:
    """The clearance of a vehicle at a pose and time from points (k, 5), all in one frame [m]; at most `most`."""
    c, s = np.cos(heading), np.sin(heading)
    middle_x, middle_y = x + c * footprint[0] - s * footprint[1], y + s * footprint[0] + c * footprint[1]
    nearest, within = most * most, most + reach_of(footprint)
    for r in range(len(points)):
        at_x, at_y = points[r, 0] + time * points[r, 2], points[r, 1] + time * points[r, 3]
        dx, dy = at_x - middle_x, at_y - middle_y
        if dx * dx + dy * dy < (within + points[r, 4]) ** 2:
            dx, dy = at_x - x, at_y - y
            squared = squared_distance(c * dx + s * dy, c * dy - s * dx, footprint)
            if points[r, 4] > 0.0:
                squared = max(np.sqrt(squared) - points[r, 4], 0.0) ** 2
            nearest = min(nearest, squared)
    return float(np.sqrt(nearest))


@njit(nogil=True)
def _unseen_corners(
    cells: Cells, corner: NDArray[np.int64], pose: Array, x: float, y: float, heading: float, mover: Mover
) -> int:
    """How many of the four corners of a vehicle at a pose in its present frame lie where nothing was ever seen."""
    count = 0
    footprint = mover.footprint
    for k in range(4):
        along = footprint[0] + footprint[2] * (1 if k < 2 else -1)
        across = footprint[1] + footprint[3] * (1 if k % 2 else -1)
        ahead, beside = x + np.cos(heading) * along - np.sin(heading) * across, 0.0
        beside = y + np.sin(heading) * along + np.cos(heading) * across
        at_x = pose[0] + np.cos(pose[2]) * ahead - np.sin(pose[2]) * beside
        at_y = pose[1] + np.sin(pose[2]) * ahead + np.cos(pose[2]) * beside
        a, b = floor(at_x / mover.cell) - corner[0], floor(at_y / mover.cell) - corner[1]
        if not (0 <= a < SIDE and 0 <= b < SIDE) or cells[a, b] == UNSEEN:
            count += 1
    return count


@njit(nogil=True)
def _known_free(cells: Cells, corner: NDArray[np.int64], pose: Array, c: float, s: float, mover: Mover) -> float:
    """The distance in a direction up to which all is known to be free, beyond the vehicle itself [m]."""
    first = reach_of(mover.footprint)
    for k in range(1, int((SIGHT * mover.scale - first) / mover.cell) + 1):
        way = first + k * mover.cell
        a, b = floor((pose[0] + c * way) / mover.cell) - corner[0], floor((pose[1] + s * way) / mover.cell) - corner[1]
        if not (0 <= a < SIDE and 0 <= b < SIDE) or cells[a, b] >= UNSEEN:
            return way
    return SIGHT * mover.scale
