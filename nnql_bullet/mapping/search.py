"""A search over several manoeuvres in a row: what each first manoeuvre is worth, by the best that can follow it.

A beam search (Lowerre, 1976) with the vehicle's own model: of all states after k manoeuvres, those with the best
scores are driven on. A score is the cost of the way left through the map of what was seen, the unseen counted as free,
and what lacked in room on the way there. It is the same for every vehicle but for its lengths.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.mapping.body_map import FARTHER, Cells, Lengths, Offsets, cost_at
from nnql_bullet.mapping.foresight import Mover, State, costs_from, course, is_thin, points_near, visits

WORST = -30.0
"""Least score, of a manoeuvre that meets something, over the length scale [m]: far below the others."""
_LAST_RESORT = 10.0
"""How much better than that the best of such manoeuvres is, likewise [m]; see `_tried`."""
_FIRST, _POSES, _STOPPING = 6, 3, 4
"""Poses at which clearances are computed while the first manoeuvre is driven, and while a later one is, and while the
vehicle then brakes."""
_MOST_OF_ONE = 3
"""Most states of one first manoeuvre among those that are driven on, so that several stay."""
_AHEAD = 0.5
"""What the way from a place ahead counts beside that from the end of a course."""
_EARLIER = 0.1
"""What the way left after every manoeuvre counts beside that in the end: progress at once is better than later."""
_AGAIN = 0.5
"""What it costs to come back to a pose, each time, over the length scale [m]; without it plans repeat each other."""
_BACKING = 0.1
"""What a manoeuvre backwards costs beside its way, likewise [m]."""
KEPT = 0.7
"""Share of the present clearance that a vehicle keeps where it has less than its margin."""
_DROPPED = 0.3
"""What a first manoeuvre loses with every level at which nothing that follows it is driven on, likewise [m]."""
_DONE = 4.0
"""Way left at which the target is as good as reached [cells]."""


@njit(nogil=True)
def searched(
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
    follow: NDArray[np.int64],
    planned: NDArray[np.int64],
    depth: int,
    width: int,
    room: float,
    wide: float,
    weight: float,
    haste: float,
    caution: float,
    margin: float,
    constancy: float,
    mover: Mover,
) -> tuple[Array, NDArray[np.int64]]:
    """Scores the manoeuvres of n vehicles (n, m) [m], the greatest is the best; and says what is to follow it (n,).

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
        turns: Heading changes of the manoeuvres (n, m) [rad].
        goals: Speeds that they ask for (m,) [m/s].
        follow: Manoeuvres that may follow the first (k,).
        planned: Manoeuvres that were to come now; -1 for none (n,).
        depth: Number of manoeuvres in a row.
        width: Number of states that are driven on.
        room: Clearance below which a manoeuvre costs [m].
        wide: Clearance, not less, from which on the drive's speed costs nothing [m].
        weight: What each metre of clearance costs that lacks.
        haste: What a manoeuvre costs by its squared speed where there is no clearance at all [s2/m].
        caution: The same near something thin, whatever the clearance: there may be more that the rays miss [s2/m].
        margin: Clearance below which a manoeuvre counts as meeting something [m].
        constancy: What it is worth to keep to the plan [m].
        mover: The vehicle.
    """
    n, m = turns.shape
    then = np.full(n, -1)
    scores, points = np.empty((n, m)), np.empty((cells.shape[1] ** 2 + rays.shape[1], 5))
    most = max(m, width * len(follow))
    states, costs, values = np.empty((2, most, 5)), np.empty((2, most)), np.empty(most)
    roots, seconds = np.empty((2, most), np.int64), np.full((2, most), -1)
    taken, nexts = np.empty(m, np.int64), np.empty(m, np.int64)
    for i in range(n):
        here = cost_at(left[i], corners[i], poses[i, 0], poses[i, 1], mover.cell, np.inf)
        count = points_near(cells[i], offsets[i], corners[i], poses[i], rays[i], moving[i], mover, points)
        near = points[:count]
        doubt = caution if is_thin(near, mover.scale) else 0.0
        _, now, _ = course((0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 1, near, mover, room)
        least = min(margin, KEPT * now)
        count = 1
        states[0, 0] = 0.0, 0.0, 0.0, speeds[i], yaw_rates[i]
        costs[0, 0] = 0.0
        scores[i], nexts[:] = WORST * mover.scale, -1
        for level in range(depth):
            old, new = level % 2, (level + 1) % 2
            time, poses_each = level * mover.period, _FIRST if level == 0 else _POSES
            made = 0
            if level > 0:  # those that are driven on are worth what follows; the others were worse, and stay so
                scores[i] -= _DROPPED * mover.scale
                for j in range(count):
                    scores[i, roots[old, j]] = WORST / 2 * mover.scale
            for j in range(count):
                start = (states[old, j, 0], states[old, j, 1], states[old, j, 2], states[old, j, 3], states[old, j, 4])
                for k in range(m if level == 0 else len(follow)):
                    action = k if level == 0 else follow[k]
                    turn, goal = turns[i, action], goals[action]
                    end, cost, lasts = _tried(
                        start, time, turn, goal, poses_each, near, room, wide, weight, haste, doubt, least, mover
                    )
                    if lasts < 1.0:
                        if level == 0:
                            scores[i, k] = (WORST + _LAST_RESORT * lasts) * mover.scale
                        continue
                    value = _way(end, left[i], factors[i], corners[i], poses[i], here, mover)
                    if goals[action] < 0.0:
                        cost += _BACKING * mover.scale
                    cost += _AGAIN * mover.scale * visits(end, trails[i], poses[i], mover.scale)
                    states[new, made] = end
                    costs[new, made] = costs[old, j] + cost + _EARLIER * value
                    roots[new, made] = k if level == 0 else roots[old, j]
                    seconds[new, made] = action if level == 1 else seconds[old, j] if level > 1 else -1
                    values[made] = -value - costs[new, made]
                    made += 1
            order = np.argsort(-values[:made])
            taken[:] = 0
            count = 0
            for j in order:
                root = roots[new, j]
                if taken[root] == 0:
                    scores[i, root], nexts[root] = values[j], seconds[new, j]
                if level < depth - 1 and taken[root] < _MOST_OF_ONE and count < width:
                    states[old, count], costs[old, count], roots[old, count] = states[new, j], costs[new, j], root
                    seconds[old, count] = seconds[new, j]
                    count += 1
                taken[root] += 1
            states[new, :count], costs[new, :count] = states[old, :count], costs[old, :count]
            roots[new, :count], seconds[new, :count] = roots[old, :count], seconds[old, :count]
            if count == 0:
                break
        if planned[i] >= 0:
            scores[i, planned[i]] += constancy
        then[i] = nexts[np.argmax(scores[i])]
    return scores, then


@njit(nogil=True)
def _tried(
    start: State,
    time: float,
    turn: float,
    goal: float,
    poses: int,
    points: Array,
    room: float,
    wide: float,
    weight: float,
    haste: float,
    doubt: float,
    least: float,
    mover: Mover,
) -> tuple[State, float, float]:
    """Drives a manoeuvre, then to a stand: its end, what it costs, and how good it is as a last resort (0 to 1).

    That is 1 for one that is none. Of the others those without a contact are the better, then those that meet something
    later.
    """
    end, clear, lasts = course(start, time, turn, goal, mover.period, poses, points, mover, wide)
    if lasts < poses:
        return end, 0.0, 0.5 * lasts / (poses + _STOPPING)
    stop = abs(end[3]) / mover.acceleration
    if stop > 0.0:
        _, then, more = course(end, time + mover.period, 0.0, 0.0, stop, _STOPPING, points, mover, wide)
        if more < _STOPPING:
            return end, 0.0, 0.5 * (poses + more) / (poses + _STOPPING)
        clear = min(clear, then)
    if clear < least:
        return end, 0.0, 0.5 + 0.49 * clear / least
    cost = weight * max(room - clear, 0.0)
    return end, cost + max(haste * (1.0 - clear / wide), doubt) * end[3] ** 2, 1.0


@njit(nogil=True)
def _way(
    end: State,
    left: Lengths,
    factors: Lengths,
    corner: NDArray[np.int64],
    pose: Array,
    here: float,
    mover: Mover,
) -> float:
    """How much longer the way left is from a state than from here [m]: from its place, and from a place ahead of it."""
    place, ahead = costs_from(end, left, factors, corner, pose, here + 2 * FARTHER, mover)
    if place < _DONE:
        return -here * mover.cell - mover.scale
    return ((1 - _AHEAD) * place + _AHEAD * ahead - here) * mover.cell
