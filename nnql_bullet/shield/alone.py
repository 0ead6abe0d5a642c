"""The shield's decision for one vehicle, in the part of Python that `exports.translation` writes as other languages.

It decides as `shield.Shield` does that leads no vehicle (`ShieldOptions.recovers` off) and follows no plan, around an
agent that chooses among the six actions and is not told what it did instead. It keeps what it remembers in arrays of
fixed size, and calls the same kernels. A decision is `perceive`, then the agent by the readings and rays that it gives,
then `choose`.
"""

from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.symmetry import LEFT_TURNS, RIGHT_TURNS
from nnql_bullet.env import ACTIONS, LARGEST_TURN, MOST_YAW_RATE, REVERSE, SLOW, STOP
from nnql_bullet.geometry import Array, wrap_angle
from nnql_bullet.mapping.point_cloud import is_moving
from nnql_bullet.mapping.prediction import PREDICTION_STEP, clearance_at
from nnql_bullet.mapping.sector_faults import ENOUGH, completed, contradictions, silent_sectors
from nnql_bullet.mapping.seen_space import APART, SCANS, TURNED, RecentScans, comes_near, is_missed
from nnql_bullet.sensing import Sensor, first_ray
from nnql_bullet.shield.courses import fill_drive, is_clear, join, time_to_stop
from nnql_bullet.shield.fallback import FULL_TURN
from nnql_bullet.shield.perception import REMEMBERED
from nnql_bullet.shield.prediction import APPROACH, AXLE, DISTANCE_STEP, LEAST_CLEARANCE, SLIDING, SLOWLY, Predictor
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.profiles import profile_at, ramp_at, turn_profile
from nnql_bullet.vehicle.spec import Limits

BEGUN, KNOWN, STANDING, MOVING, POINTS, SIDE, DECISIONS, BACKS = range(8)
"""Places in `Memory.numbers`: whether a scan was seen, how many scans are known, points remembered, points that move
and points in all, and how it turns on the spot, see `fallback.Spin`."""
ASKED, FOLLOWED, SLOWLY_FOLLOWED, CHANGING, ON_THE_SPOT = range(5)
"""Rows of `Setting.limits`."""
FASTEST = 2.0
"""Largest speed and yaw rate that are taken, over the drive's and over the vehicle's limit."""
_LEFT_FIRST, _RIGHT_FIRST = (*LEFT_TURNS, *RIGHT_TURNS), (*RIGHT_TURNS, *LEFT_TURNS)


class Setting(NamedTuple):
    """What the decisions depend on and never changes."""

    range: float
    rays: int
    middle: bool
    """Whether sectors read their middle ray; else their nearest."""
    seen: NDArray[np.bool_]
    directions: Array
    sensor: Array
    first_angle: float
    footprint: Array
    speed: float
    period: float
    reverse_share: float
    acceleration: float
    braking: float
    limits: Array
    """Yaw rate and yaw acceleration (5, 2): asked for, followed at speed, slowly, while the speed changes, standing."""
    alike: NDArray[np.bool_]
    """Whether the limits of two rows are the same (5, 5)."""
    slides: bool
    brakes_straight_above: float
    turning_circle: float
    look_ahead: float
    margin: float
    tight: float
    least_width: float
    corridor: float
    box_speed: float
    standstill: float
    least_clearance: float
    approach: float
    times: Array
    steps: Array
    """Times between `times`."""
    stop_times: Array
    stop_steps: Array
    moved_times: Array
    moved_steps: Array
    around: Array
    """Directions that are probed for an open side [rad]."""
    reaches: Array
    """Distances that are probed there [m]."""
    most_yaw_rate: float
    """Largest yaw rate that is taken [rad/s]."""
    most_driven: int
    most_braking: int
    most_along: int
    most_across: int
    """Most cells along a ray, and across it, in which an obstacle may stand unseen."""


class Memory(NamedTuple):
    """What is remembered of one vehicle, and room to work in. All zero when a drive begins."""

    numbers: NDArray[np.int64]
    moved: Array
    """Predicted pose of now in the vehicle frame of the last decision (3,)."""
    target: Array
    """The target in that frame (2,) [m]."""
    evidence: Array
    points: Array
    """Of the last scan (rays, 2) [m]."""
    rays: Array
    """Of the last scan (rays,) [m]; -1 for a blind one."""
    standing: Array
    """See `perception.LastScan.standing` (m, 3)."""
    scans: Array
    """See `seen_space.RecentScans` (12, rays)."""
    poses: Array
    strayed: Array
    cloud: Array
    """Points of obstacles now, those that move first (k, 2) [m]."""
    closing: Array
    """Speed at which each may come nearer (k,) [m/s]."""
    moving: NDArray[np.bool_]
    courses: Array
    """Poses of a course (k, 3)."""
    driven: Array
    then: Array
    frames: Array


def setting_of(predictor: Predictor, sensor: Sensor, task: TaskOptions) -> Setting:
    """What a shield's decisions depend on.

    Args:
        predictor: Of the shield.
        sensor: Of its vehicle.
        task: Says how sectors read rays.
    """
    p, lengths, drive = predictor, predictor.lengths, predictor.drive
    rows: list[Limits] = [p.asked, p.followed, p.followed_slowly, p.followed_changing, p.followed_standing]
    moved = np.linspace(0.0, drive.decision_period, 11)[1:]
    step = lengths.times(DISTANCE_STEP)
    fastest, largest = FASTEST * drive.speed, min(FASTEST * p.asked.yaw_rate, MOST_YAW_RATE)
    yaw = min(its.yaw_acceleration for its in rows)
    slowest = min(its.yaw_rate for its in rows)
    turned = LARGEST_TURN + largest**2 / yaw
    braking = (2 * largest + p.asked.yaw_rate) / yaw + turned / slowest + (fastest + drive.speed) / lengths.deceleration
    driven = int(np.ceil(drive.decision_period / PREDICTION_STEP)) + 1
    far = fastest * drive.decision_period + fastest**2 / lengths.deceleration
    box = p.footprint
    reach = far + 2 * hypot(abs(box[0]) + box[2], abs(box[1]) + box[3]) + float(np.hypot(*p.sensor)) + lengths.margin
    return Setting(
        range=sensor.range,
        rays=sensor.rays,
        middle=task.sector_reading == "middle",
        seen=sensor.seen,
        directions=sensor.directions,
        sensor=p.sensor,
        first_angle=p.first_angle,
        footprint=p.footprint,
        speed=drive.speed,
        period=drive.decision_period,
        reverse_share=drive.reverse_share,
        acceleration=p.asked.acceleration,
        braking=lengths.deceleration,
        limits=np.array([(its.yaw_rate, its.yaw_acceleration) for its in rows]),
        alike=np.array([[a == b for b in rows] for a in rows]),
        slides=p.slides,
        brakes_straight_above=p.brakes_straight_above,
        turning_circle=p.turning_circle,
        look_ahead=lengths.look_ahead,
        margin=lengths.margin,
        tight=lengths.tight_margin,
        least_width=lengths.least_width,
        corridor=lengths.corridor,
        box_speed=lengths.box_speed,
        standstill=lengths.standstill,
        least_clearance=lengths.times(LEAST_CLEARANCE),
        approach=lengths.times(APPROACH),
        times=p.times,
        steps=np.diff(np.concatenate([[0.0], p.times])),
        stop_times=p.stop_times,
        stop_steps=np.diff(np.concatenate([[0.0], p.stop_times])),
        moved_times=moved,
        moved_steps=np.diff(np.concatenate([[0.0], moved])),
        around=np.radians(np.arange(-180.0, 181.0, 15.0)),
        reaches=np.arange(step, lengths.look_ahead, step),
        most_yaw_rate=largest,
        most_driven=driven,
        most_braking=int(np.ceil(braking / PREDICTION_STEP)) + 1,
        most_along=int(np.ceil(2 * reach / lengths.least_width)) + 1,
        most_across=int(np.ceil(4 * reach * np.sin(np.pi / sensor.rays) / lengths.least_width)) + 1,
    )


def memory_of(p: Setting) -> Memory:
    """An empty memory."""
    standing = p.rays * (REMEMBERED + 1)
    count = p.rays + standing
    course = max(len(p.times), p.most_driven + p.most_braking)
    return Memory(
        numbers=np.zeros(8, np.int64),
        moved=np.zeros(3),
        target=np.zeros(2),
        evidence=np.zeros(paper.SECTORS),
        points=np.zeros((p.rays, 2)),
        rays=np.zeros(p.rays),
        standing=np.zeros((standing, 3)),
        scans=np.zeros((SCANS, p.rays)),
        poses=np.zeros((SCANS, 3)),
        strayed=np.zeros(SCANS),
        cloud=np.zeros((count, 2)),
        closing=np.zeros(count),
        moving=np.zeros(p.rays, np.bool_),
        courses=np.zeros((course, 3)),
        driven=np.zeros((p.most_driven, 5)),
        then=np.zeros((p.most_braking, 5)),
        frames=np.zeros((course, 4)),
    )


def perceive(
    p: Setting,
    m: Memory,
    distances: Array,
    target_distance: float,
    target_bearing: float,
    speed: float,
    readings: Array,
) -> bool:
    """Takes a scan in, as `perception.perceived`: completes it, tells what moves, and remembers.

    Args:
        p: The setting.
        m: The memory; it is changed.
        distances: Of the rays (rays,) [m]; they are completed.
        target_distance: Distance of the target, which stays [m].
        target_bearing: Its bearing [rad].
        speed: Of the vehicle [m/s].
        readings: Room for the readings of the sectors by the completed scan (8,) [m].

    Returns:
        Whether anything moves.
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
    any_moves = False
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
            any_moves = any_moves or m.moving[k]
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
    return any_moves


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
    moves: bool,
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
        moves: What `perceive` told.
    """
    turns = np.empty(ACTIONS)
    for a in range(len(paper.TURNS)):
        turns[a] = paper.TURNS[a]
    turns[ACTIONS - 1] = min(max(target_bearing, -LARGEST_TURN), LARGEST_TURN)
    order = np.empty(ACTIONS, np.int64)
    rank(order, values, valued, wanted, turns)
    margin = margin_here(p, m)
    chosen, tight = -1, min(margin, p.tight)
    if m.numbers[BACKS] == 0 or can_turn_round(p, m):
        chosen = first_safe(p, m, turns, order, yaw_rate, speed, margin, True, tight)
    if chosen < 0:
        chosen = fall_back(p, m, turns, order, target_bearing, yaw_rate, speed, margin, moves)
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


def sort(order: NDArray[np.int64], ranks: Array) -> None:
    """The places of six numbers, that of the largest first; of equal ones in their order."""
    for a in range(ACTIONS):
        place = 0
        for b in range(ACTIONS):
            if ranks[b] > ranks[a] or (ranks[b] == ranks[a] and b < a):
                place += 1
        order[place] = a


def margin_here(p: Setting, m: Memory) -> float:
    """`Predictor.margins` of one vehicle [m]."""
    here = clearance_at(0.0, 0.0, 0.0, m.cloud, m.numbers[POINTS], p.footprint)
    if here < p.least_clearance:
        return min(max(here - p.approach / 6, here / 2), p.margin)
    return min(max(here - p.approach, p.least_clearance), p.margin)


def can_turn_round(p: Setting, m: Memory) -> bool:
    """`Predictor.can_turn_round` of one vehicle."""
    return clearance_at(0.0, 0.0, 0.0, m.cloud, m.numbers[POINTS], AXLE) >= p.turning_circle


def stays_clear(
    p: Setting, m: Memory, turn: float, yaw_rate: float, speed: float, margin: float, turns_round: bool
) -> bool:
    """`Predictor.stays_clear` of one vehicle on one course."""
    followed = FOLLOWED if speed >= p.speed else CHANGING
    period = p.period
    after = min(speed + p.acceleration * period, p.speed)
    stop = (speed + after) / 2 * period + after * after / (2 * p.braking)
    return keeps(p, m, turn, yaw_rate, speed, margin, stop, turns_round, ASKED) and (
        p.alike[ASKED, followed] or keeps(p, m, turn, yaw_rate, speed, margin, stop, turns_round, followed)
    )


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
    peak, rise, hold, fall = turn_profile(yaw_rate, turn, p.limits[which, 0], p.limits[which, 1])
    poses, distances = np.empty((len(p.times), 3)), np.empty(len(p.times))
    x, y, before, was, along = 0.0, 0.0, 0.0, speed, 0.0
    for k in range(len(p.times)):
        _, heading = profile_at(yaw_rate, peak, rise, hold, fall, p.times[k])
        now = ramp_at(speed, p.speed, p.acceleration, p.times[k])
        length, middle = (now + was) / 2 * p.steps[k], heading - (heading - before) / 2
        x, y, along = x + length * np.cos(middle), y + length * np.sin(middle), along + length
        poses[k] = x, y, heading
        distances[k] = along
        before, was = heading, now
    return is_clear(
        poses,
        distances,
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


def first_safe(
    p: Setting,
    m: Memory,
    turns: Array,
    order: NDArray[np.int64],
    yaw_rate: float,
    speed: float,
    margin: float,
    turns_round: bool,
    tight: float,
) -> int:
    """`Predictor.first_safe` of what stays clear by a margin [m]."""
    for place in range(ACTIONS):
        action: int = order[place]
        if stays_clear(p, m, turns[action], yaw_rate, speed, margin, turns_round):
            if can_stop(p, m, action, turns[action], yaw_rate, speed, tight):
                return action
            if can_stop(p, m, action + SLOW, turns[action], yaw_rate, speed, tight):
                return action + SLOW
    return -1


def can_stop(p: Setting, m: Memory, manoeuvre: int, turn: float, yaw_rate: float, speed: float, margin: float) -> bool:
    """`Predictor.can_stop` of one vehicle."""
    goal = wanted_speed(p, manoeuvre)
    change = p.acceleration if goal > speed else p.braking
    for v in range(4):
        turned, which, slides = variant(p, v, turn, yaw_rate, speed, goal)
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
            for w in range(4):
                back, limits, skids = variant(p, w, 0.0, rate, fast, 0.0)
                if limits >= 0 and not stops_clear(p, m, count, back, rate, fast, limits, skids, margin):
                    return False
    return True


def stops_clear(
    p: Setting, m: Memory, count: int, turn: float, rate: float, speed: float, which: int, slides: bool, margin: float
) -> bool:
    """Whether one vehicle that has driven a course and then brakes stays clear of what was seen and what was not."""
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


def wanted_speed(p: Setting, manoeuvre: int) -> float:
    """The speed that a manoeuvre asks for [m/s]."""
    if manoeuvre < STOP:
        return p.speed
    if manoeuvre < REVERSE:
        return 0.0
    return -p.reverse_share * p.speed if manoeuvre < SLOW else p.reverse_share * p.speed


def variant(p: Setting, v: int, turn: float, rate: float, speed: float, goal: float) -> tuple[float, int, bool]:
    """One of the ways in which a vehicle may turn, see `Predictor._turns`: turn, limits or -1 for none, slides."""
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


def followed_until(p: Setting, goal: float, speed: float) -> int:
    """`Predictor._followed_until` of one vehicle, as a row of the limits."""
    return ON_THE_SPOT if goal == 0.0 and abs(speed) < SLIDING * p.speed else CHANGING


def fall_back(
    p: Setting,
    m: Memory,
    turns: Array,
    order: NDArray[np.int64],
    target_bearing: float,
    yaw_rate: float,
    speed: float,
    margin: float,
    moves: bool,
) -> int:
    """`fallback.fallback` of one vehicle."""
    tight = margin if p.slides else min(margin, p.tight)
    if moves:
        return longest_clear(p, m, turns, yaw_rate, speed, tight)
    if speed >= p.standstill:
        return best_stop(p, m, turns, yaw_rate, speed, tight)
    if m.numbers[BACKS] == 1 and not can_turn_round(p, m):
        action = reverses(p, m, turns, yaw_rate, speed, tight)
        if action >= 0:
            return action
    side = m.numbers[SIDE]
    if side == 0:
        side = open_side(p, m, target_bearing)
    m.numbers[SIDE], m.numbers[DECISIONS], m.numbers[BACKS] = side, m.numbers[DECISIONS] + 1, 0
    turn = turn_on_the_spot(p, m, turns, side, yaw_rate, speed, tight)
    if turn < 0 or m.numbers[DECISIONS] > FULL_TURN:
        for distance in (margin, margin / 2, tight):
            action = first_safe(p, m, turns, order, yaw_rate, speed, distance, False, tight)
            if action >= 0:
                return action
        action = reverses(p, m, turns, yaw_rate, speed, tight)
        if action >= 0:
            m.numbers[DECISIONS], m.numbers[BACKS] = 0, 1
            return action
    if turn < 0:
        return STOP
    m.numbers[SIDE] = 1 if turns[turn] > 0 else -1
    return STOP + turn


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


def reverses(p: Setting, m: Memory, turns: Array, yaw_rate: float, speed: float, margin: float) -> int:
    """`Predictor.reverses` of one vehicle."""
    best, least = -1, np.inf
    for a in range(ACTIONS):
        if can_stop(p, m, REVERSE + a, turns[a], yaw_rate, speed, margin) and abs(turns[a]) < least:
            best, least = REVERSE + a, abs(turns[a])
    return best


def course_score(
    p: Setting, m: Memory, turn: float, yaw_rate: float, speed: float, goal: float, moves: bool, enough: float
) -> float:
    """`fallback.course_scores` of one course."""
    smallest, contact = course(p, m, turn, yaw_rate, speed, goal, moves)
    return contact + min(smallest, min(enough, 0.99))


def course(
    p: Setting, m: Memory, turn: float, yaw_rate: float, speed: float, goal: float, moves: bool
) -> tuple[float, int]:
    """A course as in `Predictor._worse`: its smallest clearance [m], and the number of its steps before a contact."""
    worst = np.full(len(p.stop_times), np.inf)
    follow(p, m, worst, turn, yaw_rate, speed, goal, moves, ASKED)
    followed = followed_until(p, 0.0, speed)
    if goal > 0:
        followed = FOLLOWED if speed >= p.speed else CHANGING
    if not p.alike[ASKED, followed]:
        follow(p, m, worst, turn, yaw_rate, speed, goal, moves, followed)
    smallest, contact = np.inf, len(p.stop_times)
    for back in range(len(p.stop_times)):
        k = len(p.stop_times) - 1 - back
        smallest = min(smallest, worst[k])
        if worst[k] <= 0:
            contact = k
    return smallest, contact


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
    peak, rise, hold, fall = turn_profile(yaw_rate, turn, p.limits[which, 0], p.limits[which, 1])
    x, y, before, was = 0.0, 0.0, 0.0, speed
    change = p.acceleration if goal > 0 else p.braking
    for k in range(len(p.stop_times)):
        _, heading = profile_at(yaw_rate, peak, rise, hold, fall, p.stop_times[k])
        now = ramp_at(speed, goal, change, p.stop_times[k])
        length, middle = (now + was) / 2 * p.stop_steps[k], heading - (heading - before) / 2
        x, y = x + length * np.cos(middle), y + length * np.sin(middle)
        before, was = heading, now
        worst[k] = min(worst[k], clearance_at(x, y, heading, m.cloud, m.numbers[POINTS], p.footprint))
        if moves:
            came = clearance_at(x, y, heading, m.cloud, m.numbers[MOVING], p.footprint)
            came -= p.box_speed * p.stop_times[k]
            worst[k] = min(worst[k], max(came, 0.0))


def open_side(p: Setting, m: Memory, target_bearing: float) -> int:
    """`Predictor.open_side` of one vehicle."""
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
