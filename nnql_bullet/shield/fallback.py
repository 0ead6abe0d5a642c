"""What a vehicle does when no action stays clear: it brakes, and once it stands it turns on the spot.

Where it cannot, or has turned all round in vain, it backs out the way it came until it can turn round.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.agents.symmetry import LEFT_TURNS, RIGHT_TURNS
from nnql_bullet.env import ACTIONS, STOP
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.shield.prediction import (
    can_stop,
    can_turn_round,
    carried_out,
    clear_actions,
    course,
    first_safe,
    open_side,
    reverses,
    sort,
)
from nnql_bullet.shield.setting import BACKS, DECISIONS, MOVING, SIDE, Memory, Setting

FULL_TURN = 14
"""Decisions to turn on the spot after which a vehicle has looked all round, and makes do with less clearance."""
_LEFT_FIRST, _RIGHT_FIRST = (*LEFT_TURNS, *RIGHT_TURNS), (*RIGHT_TURNS, *LEFT_TURNS)


@njit()
def first_choice(
    p: Setting,
    m: Memory,
    turns: Array,
    order: NDArray[np.int64],
    admitted: NDArray[np.bool_],
    slowly: NDArray[np.bool_],
    target_bearing: float,
    yaw_rate: float,
    speed: float,
    margin: float,
    preferred_side: int,
) -> int:
    """The best admitted manoeuvre of a vehicle or, where there is none, the fallback; see both."""
    chosen = -1
    if m.numbers[BACKS] == 0 or can_turn_round(p, m):
        chosen = first_safe(p, m, turns, order, admitted, slowly, yaw_rate, speed, min(margin, p.tight))
    if chosen < 0:
        chosen = fall_back(p, m, turns, order, target_bearing, yaw_rate, speed, margin, preferred_side)
    return chosen


@njit()
def fall_back(
    p: Setting,
    m: Memory,
    turns: Array,
    order: NDArray[np.int64],
    target_bearing: float,
    yaw_rate: float,
    speed: float,
    margin: float,
    preferred_side: int,
) -> int:
    """Brakes or turns a vehicle on the spot; beside a moving obstacle, what stays out of contact longest.

    A vehicle that slides when it turns on the spot has no tighter margin than the one it keeps elsewhere.

    Args:
        p: The setting.
        m: The memory; its turning on the spot is changed.
        turns: Heading changes of the six actions (6,) [rad].
        order: The actions, the best first (6,).
        target_bearing: Bearing of the target [rad].
        yaw_rate: Of the vehicle [rad/s].
        speed: Of the vehicle [m/s].
        margin: Clearance that it keeps if it can [m].
        preferred_side: Side to which it turns on the spot if it has none yet: 1 left, -1 right, 0 for none.
    """
    tight = margin if p.slides else min(margin, p.tight)
    if m.numbers[MOVING] > 0:
        return longest_clear(p, m, turns, yaw_rate, speed, tight)
    if speed >= p.standstill:
        return best_stop(p, m, turns, yaw_rate, speed, tight)
    if m.numbers[BACKS] == 1 and not can_turn_round(p, m):
        action = reverses(p, m, turns, yaw_rate, speed, tight)
        if action >= 0:
            return action
    side = m.numbers[SIDE]
    if side == 0:
        side = preferred_side
    if side == 0:
        side = open_side(p, m, target_bearing)
    m.numbers[SIDE], m.numbers[DECISIONS], m.numbers[BACKS] = side, m.numbers[DECISIONS] + 1, 0
    turn = turn_on_the_spot(p, m, turns, side, yaw_rate, speed, tight)
    if turn < 0 or m.numbers[DECISIONS] > FULL_TURN:
        clear, safe = np.empty(ACTIONS, np.bool_), np.empty(ACTIONS, np.int64)
        for a in range(ACTIONS):
            safe[a] = carried_out(p, m, a, turns[a], True, True, yaw_rate, speed, tight)
        for distance in (margin, margin / 2, tight):
            clear_actions(p, m, turns, yaw_rate, speed, distance, False, clear)
            for place in range(ACTIONS):
                if clear[order[place]] and safe[order[place]] >= 0:
                    return int(safe[order[place]])
        action = reverses(p, m, turns, yaw_rate, speed, tight)
        if action >= 0:
            m.numbers[DECISIONS], m.numbers[BACKS] = 0, 1
            return action
    if turn < 0:
        return STOP
    m.numbers[SIDE] = 1 if turns[turn] > 0 else -1
    return STOP + turn


@njit()
def turn_on_the_spot(
    p: Setting, m: Memory, turns: Array, side: int, yaw_rate: float, speed: float, tight: float
) -> int:
    """The first turn on the spot that leaves enough clearance, to one side before the other; -1 if there is none."""
    for a in range(len(_LEFT_FIRST)):
        turn = _LEFT_FIRST[a] if side > 0 else _RIGHT_FIRST[a]
        smallest, _ = course(p, m, turns[turn], yaw_rate, speed, 0.0, False)
        if smallest >= tight and can_stop(p, m, STOP + turn, turns[turn], yaw_rate, speed, tight):
            return turn
    return -1


@njit()
def longest_clear(p: Setting, m: Memory, turns: Array, yaw_rate: float, speed: float, tight: float) -> int:
    """Beside a moving obstacle: what stays out of contact longest, of what can be stopped after, or else of stops."""
    safe, found = np.empty(2 * ACTIONS, np.bool_), False
    for manoeuvre in range(2 * ACTIONS):
        safe[manoeuvre] = can_stop(p, m, manoeuvre, turns[manoeuvre % ACTIONS], yaw_rate, speed, tight)
        found = found or safe[manoeuvre]
    best, most = 0, -2.0
    for manoeuvre in range(2 * ACTIONS):
        score = -1.0
        if safe[manoeuvre] or (manoeuvre >= STOP and not found):
            goal = p.speed if manoeuvre < STOP else 0.0
            score = course_score(p, m, turns[manoeuvre % ACTIONS], yaw_rate, speed, goal, True, p.margin)
        if score > most:
            best, most = manoeuvre, score
    return best


@njit()
def best_stop(p: Setting, m: Memory, turns: Array, yaw_rate: float, speed: float, tight: float) -> int:
    """How a vehicle that drives brakes: on the best course, of equal ones the straightest."""
    order, ranks = np.empty(ACTIONS, np.int64), np.empty(ACTIONS)
    for a in range(ACTIONS):
        ranks[a] = -abs(turns[a])
    sort(order, ranks)
    enough = p.tight if p.slides else p.margin  # sliding, it brakes best straight ahead
    best, most = 0, -1.0
    for place in range(ACTIONS):
        a = order[place]
        score = course_score(p, m, turns[a], yaw_rate, speed, 0.0, False, enough)
        if can_stop(p, m, STOP + a, turns[a], yaw_rate, speed, tight):
            score += 1.0
        if score > most:
            best, most = a, score
    return STOP + best


@njit()
def course_score(
    p: Setting, m: Memory, turn: float, yaw_rate: float, speed: float, goal: float, moves: bool, enough: float
) -> float:
    """The score of a course: the number of steps without contact, then the clearance.

    The second part is less than 1, so that it decides only between courses with the same number of steps.
    """
    smallest, contact = course(p, m, turn, yaw_rate, speed, goal, moves)
    return contact + min(smallest, min(enough, 0.99))
