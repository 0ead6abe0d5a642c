"""The kinematic model: the same controller, sensors and endings as contact physics, but the wheels never slip or lag.

A vehicle follows the profiles of yaw rate and speed exactly, as a unicycle (Siegwart and Nourbakhsh, Autonomous Robots,
3.2). Its footprint is an oriented box; contact with obstacles, walls and patrols is checked after every wheel command.
The kernels simulate many vehicles in as many worlds on all cores, without allocating memory.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.blocks import SHAPES_PER_BLOCK, bounds_of, cast_rays, clearance_among, squared_distance_to_bounds
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import (
    COLUMNS,
    Array,
    Pose,
    as_rows,
    clearance_at,
    distance_apart,
    row_at,
    separation,
    squared_distance,
    wrap_angle,
)
from nnql_bullet.jit import announced, njit
from nnql_bullet.machine import allowed_cores
from nnql_bullet.sim.base import SAMPLE_EVERY, Motion, Sample, Traces
from nnql_bullet.vehicle.controller import COMMAND_RATE, DriveOptions, command_times
from nnql_bullet.vehicle.profiles import sample_profile, sample_ramp, turn_profile, wheel_speeds
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec, follow_tracks

VEHICLES_PER_THREAD = 16
"""Smallest number of vehicles in a thread."""
UNEVENNESS = 1e-3
"""Least angle by which the swivel of a caster that points against its motion is off [rad]. In exact balance it would
stay there for good; on any real ground it swings round."""
STILL = 1e-9
"""Lower bound on displacement per wheel command [m]; avoids division by zero."""
ROUNDING = 1e-6
"""By how much the number of commands that are skipped is smaller than it may be."""
SAME = 1e-12
"""Difference up to which clearances count as equal [m]: beside a corner the clearance stays the same but for rounding,
and one computation is enough."""

_NO_EVENT, _TOUCHING, _AT_TARGET = 0, 1, 2


class _Constants(NamedTuple):
    """Constants of all vehicles."""

    speed: float
    """Speed of the drive [m/s]."""
    times: Array
    """See `controller.command_times` (k + 1,) [s]."""
    most_rate: float
    """Limit on the yaw rate [rad/s]."""
    yaw_acceleration: float
    """Limit on the yaw acceleration [rad/s2]."""
    acceleration: float
    """Limit on the acceleration [m/s2]."""
    footprint: Array
    """A row of `as_rows` (7,)."""
    farthest: float
    """Largest distance of a point of the footprint from the axle's centre [m]."""
    sensor: Array
    """Position of the sensor in the vehicle frame: x, y (2,) [m]."""
    directions: Array
    """Directions of the rays in the vehicle frame (rays, 2)."""
    blind: NDArray[np.int64]
    """Rays that see nothing (k,)."""
    sensor_range: float
    """Length of a ray that meets nothing [m]."""


class _State(NamedTuple):
    """Vehicles and their worlds."""

    pose: Array
    """(n, 3)"""
    yaw_rate: Array
    """(n,)"""
    speed: Array
    """(n,)"""
    clearance: Array
    """Clearance at `pose` (n,) [m]."""
    solids: Array
    """Rows of each world (n, most, 7): obstacles and walls, patrols (both as in `as_rows`), and the patrols' tracks."""
    bounds: Array
    """Bounds of the blocks of solids and patrols, as of `bounds_of` (n, most blocks, 4) [m]."""
    counts: NDArray[np.int64]
    """Number of solids, of patrols among them, and of wheel commands since the reset (n, 3). They share an array, as
    solids and tracks do, because each argument of a kernel costs time."""
    target: Array
    """x, y, radius (n, 3) [m]."""


class _Period(NamedTuple):
    """Results of a control period."""

    rates: Array
    """Yaw rates at the start and after each command (n, k + 1) [rad/s]."""
    headings: Array
    """Headings relative to the start, at the same times (n, k + 1) [rad]."""
    speeds: Array
    """Speeds at the same times (n, k + 1) [m/s]."""
    path: Array
    """Poses at the same times (n, k + 1, 3)."""
    near: Array
    """Work space for the solids that may come close, and their tracks (n, most, 7)."""
    commands: NDArray[np.int64]
    """Number of executed commands (n,)."""
    path_length: Array
    """(n,) [m]"""
    clearance: Array
    """Smallest clearance (n,) [m]."""
    heading_error: Array
    """(n,) [rad]"""
    event: NDArray[np.int64]
    """The event that ended the period (n,)."""
    ray_distances: Array
    """Ray distances at the end (n, rays) [m]."""


class KinematicSimulator:
    """A `Simulator` of n ideal vehicles.

    The first one on a machine compiles the kernels, which takes a while and is kept on disk.
    """

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions, size: int, threads: int | None = None) -> None:
        """Makes the vehicles, in no world yet.

        Args:
            vehicle: The vehicle.
            drive: Options of the vehicle's controller.
            size: Number of vehicles.
            threads: Number of threads, by default one per core. The result does not depend on it.

        Raises:
            UserError: If the vehicle's drive is late.
        """
        if vehicle.delays.any:
            raise UserError("in the kinematic model the drive obeys at once; delays of it need contact physics")
        self.vehicle = vehicle
        self.drive = drive
        self.size = size
        times, footprint, sensor = command_times(drive), vehicle.footprint, vehicle.sensor
        farthest = hypot(abs(footprint.x) + footprint.half_length, abs(footprint.y) + footprint.half_width)
        self._constants = _Constants(
            speed=drive.speed,
            times=times,
            most_rate=vehicle.limits.yaw_rate,
            yaw_acceleration=vehicle.limits.yaw_acceleration,
            acceleration=vehicle.limits.acceleration,
            footprint=as_rows((footprint,))[0],
            farthest=farthest,
            sensor=np.array(sensor.position[:2]),
            directions=sensor.directions,
            blind=np.flatnonzero(~sensor.seen),
            sensor_range=sensor.range,
        )
        self._state = _empty_state(size)
        self._period = _empty_period(size, len(times) - 1, sensor.rays)
        self._time, self._joint_angles = np.zeros(size), np.zeros((size, len(vehicle.joints)))
        casters = [(its.x + its.trail, its.y, its.trail, its.radius) for its in vehicle.casters if its.swivels]
        self._casters = np.array(casters).reshape(-1, 4)
        self._threads = threads or allowed_cores()
        self._pool = ThreadPoolExecutor(self._threads)
        _compile()

    def close(self) -> None:
        """Ends its threads."""
        self._pool.shutdown()

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """See `Simulator.reset`."""
        self._make_room(max((len(its.solids) + 2 * len(its.patrols) for its in worlds.values()), default=0))
        state, footprint = self._state, self._constants.footprint
        for i, world in worlds.items():
            start, solids, moving = world.start, world.solids_at(0.0), len(world.patrols)
            count, bounds = len(solids), bounds_of(solids, moving)
            state.pose[i] = start.x, start.y, start.yaw
            state.yaw_rate[i], state.speed[i] = 0.0, world.start_speed(self.drive.speed)
            state.solids[i, :count] = solids
            state.solids[i, count : count + moving] = _padded(world.tracks)
            state.bounds[i, : len(bounds)] = bounds
            state.counts[i] = count, moving, 0
            state.target[i] = *world.targets[0], world.target_radius
            state.clearance[i] = clearance_among(start.x, start.y, start.yaw, footprint, solids, bounds)
        vehicles = np.array(list(worlds), dtype=np.int64)
        self._time[vehicles], self._joint_angles[vehicles] = 0.0, 0.0
        self._share(_scan, vehicles, self._constants, state, self._period)
        return state.pose[vehicles], self._period.ray_distances[vehicles]

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        """See `Simulator.advance`."""
        period, state = self._period, self._state
        vehicles = np.arange(self.size) if active is None else np.flatnonzero(active)
        scales = np.ones(self.size) if speed_scales is None else speed_scales
        self._share(_advance, vehicles, heading_changes, scales, self._constants, state, period)
        motion = Motion(
            pose=state.pose.copy(),
            yaw_rate=state.yaw_rate.copy(),
            speed=state.speed.copy(),
            duration=period.commands / COMMAND_RATE,
            path_length=period.path_length.copy(),
            clearance=period.clearance.copy(),
            heading_error=period.heading_error.copy(),
            touching=period.event == _TOUCHING,
            at_target=period.event == _AT_TARGET,
            overturned=np.zeros(self.size, np.bool_),
        )
        if traces:
            for i in vehicles.tolist():
                if i in traces:
                    self._extend(traces[i], i, over=bool(motion.touching[i] or motion.at_target[i]))
        self._time[vehicles] += motion.duration[vehicles]
        return motion, period.ray_distances.copy()

    def retarget(self, targets: Mapping[int, Point]) -> None:
        """See `Simulator.retarget`."""
        for i, target in targets.items():
            self._state.target[i, :2] = target

    def path(self, vehicle: int) -> Array:
        """Returns a vehicle's poses in the last control period: at its start and after each command (k + 1, 3)."""
        return self._period.path[vehicle, : self._period.commands[vehicle] + 1]

    def _extend(self, trace: list[Sample], vehicle: int, over: bool) -> None:
        """Appends samples of the last control period to a trace; the joints turn as the wheels roll."""
        path, joints = self.path(vehicle), self._joint_angles[vehicle]
        speeds = self._period.speeds[vehicle, : len(path)]
        yaw_rates = (np.diff(path[:, 2]) * COMMAND_RATE).tolist()
        casters, swivels = self._casters, range(2, len(joints), 2)
        mean_speeds = ((speeds[:-1] + speeds[1:]) / 2).tolist()
        for command, (speed, yaw_rate) in enumerate(zip(mean_speeds, yaw_rates, strict=True), 1):
            left, right = wheel_speeds(speed, yaw_rate, self.vehicle.track, self.vehicle.wheel_radius)
            rates = [_caster_rates(joints[k], speed, yaw_rate, *its) for k, its in zip(swivels, casters, strict=True)]
            joints += np.array([left, right, *(rate for pair in rates for rate in pair)]) / COMMAND_RATE
            if command % SAMPLE_EVERY == 0 or (over and command == len(yaw_rates)):
                x, y, yaw = path[command].tolist()
                time = float(self._time[vehicle]) + command / COMMAND_RATE
                trace.append(Sample(time, Pose(x, y, wrap_angle(yaw)), tuple(joints.tolist()), (left, right)))

    def _share(self, kernel: Callable[..., None], vehicles: NDArray[np.int64], *arguments: object) -> None:
        """Calls a kernel, which releases the interpreter's lock, for some of the vehicles in each thread."""
        threads = min(self._threads, len(vehicles) // VEHICLES_PER_THREAD)
        mine, *others = np.array_split(vehicles, threads) if threads > 1 else (vehicles,)
        waiting = [self._pool.submit(kernel, share, *arguments) for share in others]
        kernel(mine, *arguments)
        for future in waiting:
            future.result()

    def _make_room(self, most: int) -> None:
        """Enlarges the arrays to at least `most` rows for each world."""
        room = self._state.solids.shape[1]
        if most > room:
            grown = np.zeros((self.size, most, COLUMNS))
            grown[:, :room] = self._state.solids
            bounds = np.zeros((self.size, _blocks(most), 4))
            bounds[:, : _blocks(room)] = self._state.bounds
            self._state = self._state._replace(solids=grown, bounds=bounds)
            self._period = self._period._replace(near=np.zeros((self.size, most, COLUMNS)))


def _padded(tracks: Array) -> Array:
    """Adds a column to tracks (n, 6), so that they may stand among rows of `as_rows`."""
    return np.column_stack([tracks, np.zeros(len(tracks))])


def _empty_state(size: int) -> _State:
    return _State(
        pose=np.zeros((size, 3)),
        yaw_rate=np.zeros(size),
        speed=np.zeros(size),
        clearance=np.zeros(size),
        solids=np.zeros((size, 0, COLUMNS)),
        bounds=np.zeros((size, 0, 4)),
        counts=np.zeros((size, 3), np.int64),
        target=np.zeros((size, 3)),
    )


def _empty_period(size: int, commands: int, rays: int) -> _Period:
    return _Period(
        rates=np.zeros((size, commands + 1)),
        headings=np.zeros((size, commands + 1)),
        speeds=np.zeros((size, commands + 1)),
        path=np.zeros((size, commands + 1, 3)),
        near=np.zeros((size, 0, COLUMNS)),
        commands=np.zeros(size, np.int64),
        path_length=np.zeros(size),
        clearance=np.zeros(size),
        heading_error=np.zeros(size),
        event=np.zeros(size, np.int64),
        ray_distances=np.zeros((size, rays)),
    )


@cache
def _compile() -> None:
    """Compiles the kernels, or loads them from disk, by a call without vehicles."""
    none, some = np.zeros(0, np.int64), np.zeros(1)
    constants = _Constants(0.0, some, 1.0, 1.0, 1.0, np.zeros(6), 1.0, np.zeros(2), np.zeros((0, 2)), none, 1.0)
    with announced():
        _advance(none, some[:0], some[:0], constants, _empty_state(0), _empty_period(0, 0, 0))
        _scan(none, constants, _empty_state(0), _empty_period(0, 0, 0))


@njit(nogil=True)
def _advance(
    vehicles: NDArray[np.int64],
    heading_changes: Array,
    speed_scales: Array,
    constants: _Constants,
    state: _State,
    period: _Period,
) -> None:
    """Drives some vehicles for one control period, then scans."""
    for i in vehicles:
        _advance_one(i, heading_changes[i], speed_scales[i], constants, state, period)
        _scan_one(i, constants, state, period)


@njit(nogil=True)
def _scan(vehicles: NDArray[np.int64], constants: _Constants, state: _State, period: _Period) -> None:
    """Computes the ray distances of some vehicles."""
    for i in vehicles:
        _scan_one(i, constants, state, period)


@njit()
def _advance_one(
    i: int, heading_change: float, speed_scale: float, constants: _Constants, state: _State, period: _Period
) -> None:
    start_rate, start_speed, yaw = state.yaw_rate[i], state.speed[i], state.pose[i, 2]
    rates, headings, speeds, path = period.rates[i], period.headings[i], period.speeds[i], period.path[i]
    peak, rise, hold, fall = turn_profile(start_rate, heading_change, constants.most_rate, constants.yaw_acceleration)
    sample_profile(start_rate, peak, rise, hold, fall, constants.times, rates, headings)
    goal = speed_scale * constants.speed
    steady, stride = start_speed == goal, goal / COMMAND_RATE
    if steady:
        speeds[:] = goal
    else:
        sample_ramp(start_speed, goal, constants.acceleration, constants.times, speeds)
    path[0, 0], path[0, 1], path[0, 2] = state.pose[i]
    chord, c, s = np.nan, 0.0, 0.0
    for k in range(1, len(headings)):
        middle = yaw + (headings[k - 1] + headings[k]) / 2
        if middle != chord:  # the chord of an arc points along its middle heading; straight ahead it stays the same
            chord, c, s = middle, np.cos(middle), np.sin(middle)
        if not steady:
            stride = (speeds[k - 1] + speeds[k]) / 2 / COMMAND_RATE
        path[k, 0] = path[k - 1, 0] + stride * c
        path[k, 1] = path[k - 1, 1] + stride * s
        path[k, 2] = yaw + headings[k]
    # From one command to the next, no point of the footprint comes nearer to a solid by more than `hop` [m].
    quickest = max(abs(start_rate), abs(peak))
    hop = max(abs(start_speed), abs(goal)) / COMMAND_RATE + quickest / COMMAND_RATE * constants.farthest
    count, moving, clock = state.counts[i]
    tracks = state.solids[i, count : count + moving]
    hop = max(hop + _fastest(tracks) / COMMAND_RATE, STILL)
    near, near_tracks = _near(i, hop * (len(path) - 1), constants, state, period)
    last, event, smallest, left = _follow(
        path, state.target[i], state.clearance[i], hop, constants, near, near_tracks, clock
    )
    state.pose[i, 0], state.pose[i, 1], state.pose[i, 2] = path[last, 0], path[last, 1], wrap_angle(path[last, 2])
    state.yaw_rate[i], state.speed[i] = rates[last], speeds[last]
    state.clearance[i] = left
    state.counts[i, 2] = clock + last
    follow_tracks(tracks, (clock + last) / COMMAND_RATE, state.solids[i, count - moving : count])
    period.commands[i] = last
    period.path_length[i] = last * abs(stride)
    if not steady:  # the trapezoidal rule
        ends, paces = abs(speeds[0]) + abs(speeds[last]), np.abs(speeds[: last + 1])
        period.path_length[i] = (paces.sum() - ends / 2) / COMMAND_RATE
    period.clearance[i] = smallest
    period.heading_error[i] = wrap_angle(heading_change - headings[last])
    period.event[i] = event


@njit()
def _blocks(shapes: int) -> int:
    """The number of blocks of so many shapes."""
    return (shapes + SHAPES_PER_BLOCK - 1) // SHAPES_PER_BLOCK


@njit()
def _fastest(tracks: Array) -> float:
    """Finds the highest speed on tracks (m, 6) [m/s]; 0 without tracks."""
    fastest = 0.0
    for track in tracks:
        fastest = max(fastest, 2.0 * track[4] * np.hypot(track[2], track[3]))
    return fastest


@njit()
def _near(i: int, travel: float, constants: _Constants, state: _State, period: _Period) -> tuple[Array, Array]:
    """Finds the solids that may be the nearest ones in the control period, and the tracks of those that move.

    During the period the distance to any solid changes by `travel` [m] at most.
    """
    footprint, (x, y, yaw) = constants.footprint, state.pose[i]
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = x + c * footprint[0] - s * footprint[1], y + s * footprint[0] + c * footprint[1]
    reach = state.clearance[i] + 2 * travel + np.hypot(footprint[2], footprint[3])
    near: Array = period.near[i]
    solids, patrols, _ = state.counts[i]
    count, moving = 0, 0
    for block in range(_blocks(solids)):
        if squared_distance_to_bounds(x, y, state.bounds[i, block]) > reach * reach:
            continue
        for j in range(SHAPES_PER_BLOCK * block, min(SHAPES_PER_BLOCK * (block + 1), solids)):
            if squared_distance(x, y, state.solids[i, j]) <= reach * reach:
                for column in range(COLUMNS):  # numba takes seconds to compile the assignment of a row
                    near[count, column] = state.solids[i, j, column]
                count += 1
    for j in range(solids - patrols, solids):
        if squared_distance(x, y, state.solids[i, j]) <= reach * reach:
            for column in range(COLUMNS):
                near[count + moving, column] = state.solids[i, j + patrols, column]
            moving += 1
    return near[:count], near[count : count + moving]


@njit()
def _follow(
    path: Array,
    target: Array,
    clearance: float,
    hop: float,
    constants: _Constants,
    solids: Array,
    tracks: Array,
    clock: int,
) -> tuple[int, int, float, float]:
    """Follows a path up to the first contact or the target.

    Args:
        path: Poses (k + 1, 3).
        target: x, y, radius [m].
        clearance: Clearance at the path's start [m].
        hop: Largest change of the clearance from one pose to the next [m].
        constants: See there.
        solids: Rows (n, 7) of `as_rows`; the last m are patrols, which this moves.
        tracks: Tracks of the patrols (m, 6).
        clock: Number of commands up to the path's start.

    Returns:
        Index of the last pose reached, the event that ended it, the smallest clearance, and that at the end [m].
    """
    last, event, still = len(path) - 1, _NO_EVENT, len(solids) - len(tracks)
    to_target = np.hypot(path[0, 0] - target[0], path[0, 1] - target[1]) - target[2]
    for k in range(1, len(path) if to_target <= hop * last else 0):
        if np.hypot(path[k, 0] - target[0], path[k, 1] - target[1]) <= target[2]:
            last, event = k, _AT_TARGET
            break
    follow_tracks(tracks, (clock + last) / COMMAND_RATE, solids[still:])
    end = clearance_at(path[last, 0], path[last, 1], path[last, 2], constants.footprint, solids)
    smallest, touch = min(clearance, end), last
    for j in range(len(solids)):
        track = tracks[max(j - still, 0) : max(j - still + 1, 0)]
        touch, smallest = _pass(path[: touch + 1], solids[j : j + 1], track, smallest, hop, constants, clock)
    if touch < last or end <= 0.0:
        return touch, _TOUCHING, 0.0, 0.0
    return last, event, smallest, end


@njit()
def _pass(
    path: Array, solid: Array, track: Array, smallest: float, hop: float, constants: _Constants, clock: int
) -> tuple[int, float]:
    """Follows a path past one solid up to the first contact with it, between the path's ends.

    The distance is computed only where it may be the smallest one. Whatever separates the footprint from the solid
    along an axis shrinks by no more than the way that the vehicle goes along it, what it turns, and what the solid
    moves; nor by more than `hop` from one pose to the next. So contacts are exact, and the smallest clearance is that
    of all poses within `SAME`.

    Args:
        path: Poses (k + 1, 3).
        solid: A row (1, 7) of `as_rows`, which this moves if it has a track.
        track: Its track (1, 6), or none (0, 6).
        smallest: Smallest clearance that is known [m].
        hop: See `_follow`.
        constants: See there.
        clock: See `_follow`.

    Returns:
        Index of the last pose, and the smallest clearance [m].
    """
    last, k, drift = len(path) - 1, 1, _fastest(track) / COMMAND_RATE
    while k < last:
        follow_tracks(track, (clock + k) / COMMAND_RATE, solid)
        x, y, yaw = path[k]
        footprint = row_at(x, y, yaw, constants.footprint)
        gap, ahead_x, ahead_y = separation(footprint, solid[0])
        away = gap - footprint[6] - solid[0, 6]
        if gap > 0.0 and away < max(smallest - SAME, SAME):
            away = distance_apart(footprint, solid[0])
            smallest = min(smallest, away)
        if gap <= 0.0 or away <= 0.0:
            return k, 0.0
        gap -= footprint[6] + solid[0, 6]
        begin = k
        k += 1 + int(max((away - smallest) / hop - ROUNDING, 0.0))
        while k < last and (
            gap
            - (ahead_x * (path[k, 0] - x) + ahead_y * (path[k, 1] - y))
            - constants.farthest * abs(path[k, 2] - yaw)
            - drift * (k - begin)
            > max(smallest - SAME, SAME)
        ):
            k += 1
    return last, smallest


@njit()
def _scan_one(i: int, constants: _Constants, state: _State, period: _Period) -> None:
    (x, y, yaw), (ahead, left) = state.pose[i], constants.sensor
    c, s = np.cos(yaw), np.sin(yaw)
    count = state.counts[i, 0]
    solids, bounds = state.solids[i, :count], state.bounds[i, : _blocks(count)]
    x, y = x + c * ahead - s * left, y + s * ahead + c * left
    cast_rays(x, y, yaw, constants.directions, solids, bounds, constants.sensor_range, period.ray_distances[i])
    for ray in constants.blind:
        period.ray_distances[i, ray] = constants.sensor_range


@njit()
def _caster_rates(
    swivel: float, speed: float, yaw_rate: float, ahead: float, left: float, trail: float, radius: float
) -> tuple[float, float]:
    """Computes the rates [rad/s] of the swivel angle and the wheel of a trailing caster that rolls without slip.

    The swivel axis is `ahead` of the axle and `left` of its centre, and moves at (speed - yaw_rate * left, yaw_rate *
    ahead). The wheel is `trail` behind it along the fork and does not move sideways. Where the wheel points against the
    motion, which no caster keeps, it counts as at least `UNEVENNESS` off, to the left if nothing says to which side.
    """
    speed -= yaw_rate * left
    s = np.sin(swivel)
    if speed * np.cos(swivel) < 0.0 and abs(s) < UNEVENNESS:
        s = np.copysign(UNEVENNESS, s)
    along = speed * np.cos(swivel) + yaw_rate * ahead * s
    across = yaw_rate * ahead * np.cos(swivel) - speed * s
    return across / trail - yaw_rate, along / radius
