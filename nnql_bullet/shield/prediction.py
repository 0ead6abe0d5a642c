"""Which actions leave a vehicle room to stop, predicted from its speed, load and grip.

What recent scans saw has to stay clear of the course. Where they saw nothing at all, an obstacle of the least width may
stand: the vehicle has to be able to stop before it comes near such a place.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import ACTIONS, REVERSE, SLOW, STOP
from nnql_bullet.geometry import Array, wrap_angle
from nnql_bullet.jit import njit
from nnql_bullet.mapping.prediction import clearance_at
from nnql_bullet.mapping.seen_space import RecentScans, comes_near
from nnql_bullet.shield.courses import fill_course, fill_drive, is_clear, join, time_to_stop
from nnql_bullet.shield.setting import (
    ASKED,
    BACKS,
    CHANGING,
    DECISIONS,
    FASTEST,
    FOLLOWED,
    KNOWN,
    MOVING,
    ON_THE_SPOT,
    POINTS,
    SIDE,
    SLOWLY_FOLLOWED,
    Memory,
    Setting,
)

SLIDING = 0.1
"""Share of the drive's speed below which a vehicle that is to stop turns as on the spot."""
SLOWLY = 1.2
"""Share of the speed of slow driving up to which a vehicle that slides is expected to turn before it brakes."""

AXLE = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
"""The rear-axle centre as a footprint without size."""


@njit()
def sort(order: NDArray[np.int64], ranks: Array) -> None:
    """Puts the places of six numbers into `order` (6,), that of the largest first; of equal ones in their order."""
    for a in range(ACTIONS):
        place = 0
        for b in range(ACTIONS):
            if ranks[b] > ranks[a] or (ranks[b] == ranks[a] and b < a):
                place += 1
        order[place] = a


@njit()
def margin_here(p: Setting, m: Memory) -> float:
    """The clearance that a vehicle has to keep [m]: the margin or, where it has less already, about that."""
    here = clearance_at(0.0, 0.0, 0.0, m.cloud, m.numbers[POINTS], p.footprint)
    if here < p.least_clearance:
        return min(max(here - p.approach / 6, here / 2), p.margin)  # a margin of 0 would let it touch
    return min(max(here - p.approach, p.least_clearance), p.margin)


@njit()
def can_turn_round(p: Setting, m: Memory) -> bool:
    """Whether a vehicle has room to turn round on the spot."""
    return clearance_at(0.0, 0.0, 0.0, m.cloud, m.numbers[POINTS], AXLE) >= p.turning_circle


@njit()
def clear_by_margin(
    p: Setting, m: Memory, turns: Array, yaw_rate: float, speed: float, clear: NDArray[np.bool_]
) -> float:
    """Marks the actions (6,) that keep the clearance that a vehicle has to keep, and tells it [m]; see both."""
    margin = margin_here(p, m)
    clear_actions(p, m, turns, yaw_rate, speed, margin, True, clear)
    return margin


@njit()
def clear_actions(
    p: Setting,
    m: Memory,
    turns: Array,
    yaw_rate: float,
    speed: float,
    margin: float,
    turns_round: bool,
    clear: NDArray[np.bool_],
) -> None:
    """Marks the actions (6,) that keep a clearance up to where the vehicle can stop and turn round on the spot.

    Args:
        p: The setting.
        m: The memory.
        turns: Heading changes of the six actions (6,) [rad].
        yaw_rate: Of the vehicle [rad/s].
        speed: Of the vehicle [m/s].
        margin: Clearance that it has to keep [m].
        turns_round: Whether it has to turn round on the spot; else it is enough that it can stop.
        clear: Room for the marks (6,).
    """
    for action in range(ACTIONS):
        clear[action] = stays_clear(p, m, turns[action], yaw_rate, speed, margin, turns_round)


@njit()
def stays_clear(
    p: Setting, m: Memory, turn: float, yaw_rate: float, speed: float, margin: float, turns_round: bool
) -> bool:
    """Whether a vehicle stays clear on a course, see `clear_actions`: turning as asked, and falling behind."""
    followed = followed_on(p, speed)
    period = p.period
    after = min(speed + p.acceleration * period, p.speed)
    stop = (speed + after) / 2 * period + after * after / (2 * p.braking)
    return keeps(p, m, turn, yaw_rate, speed, margin, stop, turns_round, ASKED) and (
        p.alike[ASKED, followed] or keeps(p, m, turn, yaw_rate, speed, margin, stop, turns_round, followed)
    )


@njit()
def keeps(
    p: Setting,
    m: Memory,
    turn: float,
    yaw_rate: float,
    speed: float,
    margin: float,
    stop: float,
    turns_round: bool,
    which: int,
) -> bool:
    """`stays_clear` under the limits that the vehicle follows."""
    course = np.empty((len(p.times), 4))
    most, sharpest = p.limits[which, 0], p.limits[which, 1]
    fill_course(course, yaw_rate, speed, turn, p.speed, most, sharpest, p.acceleration, p.times, p.steps)
    return is_clear(
        course,
        m.cloud,
        m.closing,
        m.numbers[POINTS],
        p.times,
        p.footprint,
        margin,
        stop,
        p.look_ahead if turns_round else 0.0,
        p.turning_circle if turns_round else 0.0,
    )


@njit()
def first_safe(
    p: Setting,
    m: Memory,
    turns: Array,
    order: NDArray[np.int64],
    admitted: NDArray[np.bool_],
    slowly: NDArray[np.bool_],
    yaw_rate: float,
    speed: float,
    margin: float,
) -> int:
    """The best of the admitted actions after which the vehicle can stop; -1 if there is none.

    It carries an action out slowly where it can stop after that and not after full speed.

    Args:
        p: The setting.
        m: The memory.
        turns: Heading changes of the six actions (6,) [rad].
        order: The actions, the best first (6,).
        admitted: Whether each action is admitted at full speed (6,).
        slowly: Whether it is admitted slowly (6,).
        yaw_rate: Of the vehicle [rad/s].
        speed: Of the vehicle [m/s].
        margin: Clearance that it keeps up to the stop [m].
    """
    for place in range(ACTIONS):
        a = order[place]
        manoeuvre = carried_out(p, m, a, turns[a], admitted[a], slowly[a], yaw_rate, speed, margin)
        if manoeuvre >= 0:
            return manoeuvre
    return -1


@njit()
def carried_out(
    p: Setting,
    m: Memory,
    action: int,
    turn: float,
    admitted: bool,
    slowly: bool,
    yaw_rate: float,
    speed: float,
    margin: float,
) -> int:
    """How a vehicle carries an action out so that it can stop after it, see `first_safe`; -1 if it cannot."""
    if admitted and can_stop(p, m, action, turn, yaw_rate, speed, margin):
        return action
    if slowly and can_stop(p, m, action + SLOW, turn, yaw_rate, speed, margin):
        return action + SLOW
    return -1


@njit()
def can_stop(p: Setting, m: Memory, manoeuvre: int, turn: float, yaw_rate: float, speed: float, margin: float) -> bool:
    """Whether a vehicle that carries out a manoeuvre and then brakes straight ahead stays clear.

    It stays clear of what was seen, and keeps to where nothing can stand unseen. It may fall behind in either part and
    not in the other: so what its next decision expects of braking has been expected here.

    Args:
        p: The setting.
        m: The memory.
        manoeuvre: A number below `env.MANOEUVRES`.
        turn: Its heading change [rad].
        yaw_rate: Of the vehicle [rad/s].
        speed: Of the vehicle [m/s].
        margin: Clearance from what was seen [m].
    """
    if abs(speed) > FASTEST * p.speed or abs(yaw_rate) > p.most_yaw_rate:
        return False  # beyond what courses have room for
    goal = wanted_speed(p, manoeuvre)
    change = p.acceleration if goal > speed else p.braking
    for v in range(len(p.variants)):
        turned, which, slides = variant(p, p.variants[v], turn, yaw_rate, speed, goal)
        if which >= 0:
            count = fill_drive(
                m.driven,
                yaw_rate,
                speed,
                turned,
                goal,
                p.period,
                p.limits[which, 0],
                p.limits[which, 1],
                change,
                slides,
            )
            rate, fast = m.driven[count - 1, 3], m.driven[count - 1, 4]
            for w in range(len(p.variants)):
                back, limits, skids = variant(p, p.variants[w], 0.0, rate, fast, 0.0)
                if limits >= 0 and not stops_clear(p, m, count, back, rate, fast, limits, skids, margin):
                    return False
    return True


@njit()
def stops_clear(
    p: Setting, m: Memory, count: int, turn: float, rate: float, speed: float, which: int, slides: bool, margin: float
) -> bool:
    """Whether a vehicle that has driven a course and then brakes stays clear of what was seen and what was not."""
    most, sharpest = p.limits[which, 0], p.limits[which, 1]
    stop = time_to_stop(rate, speed, turn, most, sharpest, p.braking, slides)
    more = fill_drive(m.then, rate, speed, turn, 0.0, stop, most, sharpest, p.braking, slides)
    steps = join(m.courses, m.driven, count, m.then, more)
    for k in range(min(steps, len(m.courses))):
        x, y, yaw = m.courses[k, 0], m.courses[k, 1], m.courses[k, 2]
        if clearance_at(x, y, yaw, m.cloud, m.numbers[POINTS], p.footprint) < margin:
            return False
        m.frames[k] = x, y, np.cos(yaw), np.sin(yaw)
    scans = RecentScans(m.scans, m.poses, m.strayed)
    return not comes_near(
        m.cells,
        m.frames,
        steps,
        p.footprint,
        p.tight,
        p.least_width,
        scans,
        m.numbers[KNOWN],
        p.sensor,
        p.first_angle,
        p.most_along,
        p.most_across,
    )


@njit()
def wanted_speed(p: Setting, manoeuvre: int) -> float:
    """The speed that a manoeuvre asks for [m/s]."""
    if manoeuvre < STOP:
        return p.speed
    if manoeuvre < REVERSE:
        return 0.0
    return -p.reverse_share * p.speed if manoeuvre < SLOW else p.reverse_share * p.speed


@njit()
def variant(p: Setting, v: int, turn: float, rate: float, speed: float, goal: float) -> tuple[float, int, bool]:
    """One of four ways in which a vehicle may turn: turn, limits or -1 for none, and whether it slides.

    It may turn as asked, fall behind, and turn no further where braking leaves no grip for a turn. One that slides when
    it turns on the spot does so when it drives slowly, too: the turn leaves it nothing to brake with meanwhile.
    """
    if v == 0:
        return turn, ASKED, False
    if v == 1:
        followed = followed_until(p, goal, speed)
        return turn, -1 if p.alike[ASKED, followed] else followed, False
    if v == 2:
        slowly = p.slides and max(abs(goal), abs(speed)) <= SLOWLY * p.reverse_share * p.speed
        return turn, SLOWLY_FOLLOWED if slowly else -1, abs(goal) < abs(speed)
    straight = goal < speed and speed > p.brakes_straight_above
    return rate * abs(rate) / (2 * p.limits[ASKED, 1]), ASKED if straight else -1, False


@njit()
def followed_on(p: Setting, speed: float) -> int:
    """The limits that a vehicle follows while it drives on, as a row of `Setting.limits`."""
    return FOLLOWED if speed >= p.speed else CHANGING


@njit()
def followed_until(p: Setting, goal: float, speed: float) -> int:
    """The limits that a vehicle follows while its speed changes to another [m/s], as a row of `Setting.limits`."""
    return ON_THE_SPOT if goal == 0.0 and abs(speed) < SLIDING * p.speed else CHANGING


@njit()
def reverses(p: Setting, m: Memory, turns: Array, yaw_rate: float, speed: float, margin: float) -> int:
    """How a vehicle reverses, as straight as it can; -1 if it cannot."""
    best, least = -1, np.inf
    for a in range(ACTIONS):
        if can_stop(p, m, REVERSE + a, turns[a], yaw_rate, speed, margin) and abs(turns[a]) < least:
            best, least = REVERSE + a, abs(turns[a])
    return best


@njit()
def course(
    p: Setting, m: Memory, turn: float, yaw_rate: float, speed: float, goal: float, moves: bool
) -> tuple[float, int]:
    """The smallest clearance on a course [m], and the steps before a contact, for as long as braking takes.

    They are the smaller ones of a vehicle that turns as asked and of one that falls behind.

    Args:
        p: The setting.
        m: The memory.
        turn: Heading change [rad].
        yaw_rate: Of the vehicle [rad/s].
        speed: Of the vehicle [m/s].
        goal: Speed that it goes on to [m/s].
        moves: Whether moving obstacles may have come nearer by then.
    """
    worst = np.full(len(p.stop_times), np.inf)
    follow(p, m, worst, turn, yaw_rate, speed, goal, moves, ASKED)
    followed = followed_on(p, speed) if goal > 0 else followed_until(p, 0.0, speed)
    if not p.alike[ASKED, followed]:
        follow(p, m, worst, turn, yaw_rate, speed, goal, moves, followed)
    smallest, contact = np.inf, len(p.stop_times)
    for back in range(len(p.stop_times)):
        k = len(p.stop_times) - 1 - back
        smallest = min(smallest, worst[k])
        if worst[k] <= 0:
            contact = k
    return smallest, contact


@njit()
def follow(
    p: Setting,
    m: Memory,
    worst: Array,
    turn: float,
    yaw_rate: float,
    speed: float,
    goal: float,
    moves: bool,
    which: int,
) -> None:
    """Lowers the clearances along a course (k,) [m] to those under the limits that the vehicle follows."""
    course, change = np.empty((len(p.stop_times), 4)), p.acceleration if goal > 0 else p.braking
    most, sharpest = p.limits[which, 0], p.limits[which, 1]
    fill_course(course, yaw_rate, speed, turn, goal, most, sharpest, change, p.stop_times, p.stop_steps)
    for k in range(len(p.stop_times)):
        x, y, heading = course[k, 0], course[k, 1], course[k, 2]
        worst[k] = min(worst[k], clearance_at(x, y, heading, m.cloud, m.numbers[POINTS], p.footprint))
        if moves:
            came = clearance_at(x, y, heading, m.cloud, m.numbers[MOVING], p.footprint)
            came -= p.box_speed * p.stop_times[k]
            worst[k] = min(worst[k], max(came, 0.0))


@njit()
def open_side(p: Setting, m: Memory, target_bearing: float) -> int:
    """The side, 1 left or -1 right, on which a vehicle has to turn less for a clear path ahead.

    Directions near the target's cost less.
    """
    left, right = np.inf, np.inf
    for a in range(len(p.around)):
        angle = p.around[a]
        c, s, clear = np.cos(angle), np.sin(angle), True
        for k in range(len(p.reaches)):
            along = p.reaches[k]
            here = clearance_at(along * c, along * s, angle, m.cloud, m.numbers[POINTS], p.footprint)
            if here < p.margin:
                clear = False
                break
        if clear:
            cost = abs(angle) + abs(wrap_angle(angle - target_bearing)) / 2
            if angle >= 0:
                left = min(left, cost)
            if angle <= 0:
                right = min(right, cost)
    return 1 if left <= right else -1


@njit()
def foresee(p: Setting, m: Memory, manoeuvre: int, turn: float, yaw_rate: float, speed: float) -> None:
    """Remembers the pose that the vehicle should have at the next decision, and ends its turning on the spot."""
    goal, course = wanted_speed(p, manoeuvre), np.empty((len(p.moved_times), 4))
    most, sharpest = p.limits[ASKED, 0], p.limits[ASKED, 1]
    fill_course(course, yaw_rate, speed, turn, goal, most, sharpest, p.acceleration, p.moved_times, p.moved_steps)
    for k in range(3):
        m.moved[k] = course[len(course) - 1, k]
    if goal > 0 and speed >= 0.9 * goal:
        m.numbers[SIDE], m.numbers[DECISIONS], m.numbers[BACKS] = 0, 0, 0
