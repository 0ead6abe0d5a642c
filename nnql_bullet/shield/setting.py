"""What a shield's decisions depend on, and what it remembers of one vehicle, as its kernels take them."""

from math import hypot, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import LARGEST_TURN, MOST_YAW_RATE
from nnql_bullet.geometry import Array, as_rows
from nnql_bullet.mapping.prediction import PREDICTION_STEP
from nnql_bullet.mapping.seen_space import SCANS
from nnql_bullet.shield.lengths import Lengths
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.limits import followed_limits, side_grip
from nnql_bullet.vehicle.spec import Limits, VehicleSpec

DISTANCE_STEP = 0.1
"""Distance between predicted places along a straight line, for the shipped vehicle [m]."""
APPROACH = 0.03
"""Distance by which that vehicle may get nearer still in a decision if it is nearer than the margin [m]."""
LEAST_CLEARANCE = 0.1
"""Clearance below which it may hardly get nearer [m]."""
REMEMBERED = 20
"""Number of scans for which a point is remembered that their rays miss."""

BEGUN, KNOWN, STANDING, MOVING, POINTS, SIDE, DECISIONS, BACKS = range(8)
"""Places in `Memory.numbers`: whether a scan was seen, how many scans are known, points remembered, points that move
and points in all; then how it turns on the spot: to which side, 1 left, -1 right, 0 while it does not; decisions to do
so since it last drove on; whether it backs out of where it can neither drive on nor turn round."""
ASKED, FOLLOWED, SLOWLY_FOLLOWED, CHANGING, ON_THE_SPOT = range(5)
"""Rows of `Setting.limits`."""
FASTEST = 2.0
"""Largest speed and yaw rate that are taken, over the drive's and over the vehicle's limit."""


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
    variants: NDArray[np.int64]
    """Numbers of the ways to turn that the vehicle may have, see `prediction.variant`."""
    slides: bool
    """Whether load and grip do not let the vehicle follow its turns on the spot: it slides as they end."""
    brakes_straight_above: float
    turning_circle: float
    """Free distance round the axle that turning round on the spot takes [m]."""
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
    most_cells: int
    """Most of them all that are looked into: of a course that has more, none is known to be free."""


class Memory(NamedTuple):
    """What is remembered of one vehicle, and room to work in. All zero when a drive begins."""

    numbers: NDArray[np.int64]
    moved: Array
    """Pose of now in the vehicle frame of the last decision (3,), as predicted until the scan of now corrects it."""
    target: Array
    """The target in that frame (2,) [m]."""
    evidence: Array
    """Contradictions against each sensor since it last read something (8,)."""
    points: Array
    """Of the last scan (rays, 2) [m]."""
    rays: Array
    """Of the last scan (rays,) [m]; -1 for a blind one."""
    standing: Array
    """Points that stand still: x, y in the vehicle frame [m], and the number of scans since they were seen (m, 3)."""
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
    cells: Array
    """See `seen_space.unseen_cells` (k, 5)."""


WORKED_IN = "courses", "driven", "then", "frames", "cells"
"""Members of `Memory` that are room to work in."""


def setting_of(lengths: Lengths, vehicle: VehicleSpec, drive: DriveOptions, task: TaskOptions) -> Setting:
    """What a shield's decisions depend on.

    Args:
        lengths: Of the shield.
        vehicle: The vehicle with its load and grip.
        drive: How decisions reach the wheels.
        task: Says how sectors read rays.
    """
    asked, sensor, box = vehicle.limits, vehicle.sensor, as_rows((vehicle.footprint,))[0]
    # What the drive asks for; what load and grip let the vehicle follow of it at speed, slowly, while that changes, and
    # on the spot.
    rows: list[Limits] = [
        asked,
        followed_limits(vehicle, drive.speed),
        followed_limits(vehicle, drive.speed * drive.reverse_share),
        followed_limits(vehicle, drive.speed / 2, asked.acceleration),
        followed_limits(vehicle, lengths.standstill),
    ]
    longest = max(lengths.look_ahead, lengths.corridor) / drive.speed + drive.speed / (2 * asked.acceleration)
    stop = drive.speed / lengths.deceleration + 2 * sqrt(max(paper.TURNS) / asked.yaw_acceleration)
    times = np.arange(PREDICTION_STEP, longest + PREDICTION_STEP, PREDICTION_STEP)
    stop_times = np.arange(PREDICTION_STEP, stop, PREDICTION_STEP)
    moved = np.linspace(0.0, drive.decision_period, 11)[1:]
    step = lengths.times(DISTANCE_STEP)
    fastest, largest = FASTEST * drive.speed, min(FASTEST * asked.yaw_rate, MOST_YAW_RATE)
    yaw = min(its.yaw_acceleration for its in rows)
    slowest = min(its.yaw_rate for its in rows)
    turned = LARGEST_TURN + largest**2 / yaw
    braking = (2 * largest + asked.yaw_rate) / yaw + turned / slowest + (fastest + drive.speed) / lengths.deceleration
    driven = int(np.ceil(drive.decision_period / PREDICTION_STEP)) + 1
    far = fastest * drive.decision_period + fastest**2 / lengths.deceleration
    reach = far + 2 * hypot(abs(box[0]) + box[2], abs(box[1]) + box[3]) + hypot(*sensor.position[:2]) + lengths.margin
    alike = np.array([[a == b for b in rows] for a in rows])
    slides = rows[ON_THE_SPOT] != asked
    straight_above = side_grip(vehicle, asked.acceleration) / asked.yaw_rate
    falls_behind = not alike[ASKED, [CHANGING, ON_THE_SPOT]].all()
    variants = np.flatnonzero([True, falls_behind, slides, fastest > straight_above])
    along = int(np.ceil(2 * reach / lengths.least_width)) + 1
    beside = int(np.ceil(2 * (lengths.turning_radius + lengths.tight_margin) / lengths.least_width)) + 1
    return Setting(
        range=sensor.range,
        rays=sensor.rays,
        middle=task.sector_reading == "middle",
        seen=sensor.seen,
        directions=sensor.directions,
        sensor=np.array(sensor.position[:2]),
        first_angle=float(sensor.angles[0]),
        footprint=box,
        speed=drive.speed,
        period=drive.decision_period,
        reverse_share=drive.reverse_share,
        acceleration=asked.acceleration,
        braking=lengths.deceleration,
        limits=np.array([(its.yaw_rate, its.yaw_acceleration) for its in rows]),
        alike=alike,
        variants=variants,
        slides=slides,
        brakes_straight_above=straight_above,
        turning_circle=lengths.turning_radius + lengths.times(LEAST_CLEARANCE),
        look_ahead=lengths.look_ahead,
        margin=lengths.margin,
        tight=lengths.tight_margin,
        least_width=lengths.least_width,
        corridor=lengths.corridor,
        box_speed=lengths.box_speed,
        standstill=lengths.standstill,
        least_clearance=lengths.times(LEAST_CLEARANCE),
        approach=lengths.times(APPROACH),
        times=times,
        steps=np.diff(np.concatenate([[0.0], times])),
        stop_times=stop_times,
        stop_steps=np.diff(np.concatenate([[0.0], stop_times])),
        moved_times=moved,
        moved_steps=np.diff(np.concatenate([[0.0], moved])),
        around=np.radians(np.arange(-180.0, 181.0, 15.0)),
        reaches=np.arange(step, lengths.look_ahead, step),
        most_yaw_rate=largest,
        most_driven=driven,
        most_braking=int(np.ceil(braking / PREDICTION_STEP)) + 1,
        most_along=along,
        most_across=int(np.ceil(4 * reach * np.sin(np.pi / sensor.rays) / lengths.least_width)) + 1,
        # Twice those all round the vehicle, and those on a straight course to either side of it.
        most_cells=2 * (sensor.rays + 2 * along) * beside,
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
        cells=np.zeros((p.most_cells, 5)),
    )
