"""Optimal reciprocal collision avoidance (ORCA) among points that are seen, with the velocities that scans show.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (Robotics Research, 2011). Each
obstacle forbids a half-plane of velocities; of the others the one nearest to the preferred velocity is found by a
linear program. An obstacle is a group of points between which the vehicle does not pass. It does not give way here, so
the vehicle takes all of the responsibility, and not half of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet.agents.base import NoValues
from nnql_bullet.agents.foresight import FASTEST, displacements
from nnql_bullet.agents.turns import nearest_actions, nearest_paces
from nnql_bullet.config import options
from nnql_bullet.env import LARGEST_TURN, STOP, Observation
from nnql_bullet.geometry import Array, wrap_angle
from nnql_bullet.jit import njit
from nnql_bullet.mapping.grid_map import first_poses, tracked
from nnql_bullet.mapping.point_cloud import point_cloud
from nnql_bullet.mapping.velocities import PAST, velocities
from nnql_bullet.rollout import Actions
from nnql_bullet.types import Period, Reach, UnitInterval
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

PARALLEL = 1e-9
"""Sine of the angle between two lines, below which they count as parallel."""


@options
class OrcaOptions:
    """The article's parameters."""

    kind: Literal["orca"] = "orca"
    horizon: Period = 1.9
    """tau, time for which velocities have to be free of contact [s]."""
    margin: Reach = 0.3
    """Clearance of the circle that holds the footprint [m]."""
    window: Reach = 7.0
    """Distance from the vehicle beyond which points do not count [m]."""
    least_share: UnitInterval = 0.04
    """Share of the drive's speed below which it stands, and turns to the target."""
    spot_degrees: Annotated[float, Field(gt=0, le=180)] = 60.0
    """Direction of the permitted velocity from which it turns on the spot [degrees]; backwards it drives straight."""

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Orca":
        """Builds the agent."""
        return Orca(self, vehicle, drive)


@dataclass(frozen=True, slots=True)
class OrcaState:
    """Memory of n vehicles. While the age is 0, the other entries mean nothing."""

    age: NDArray[np.int64]
    """Decisions in the episode so far (n,)."""
    trails: Array
    """Poses at the last decisions, the newest first, in the landmark's frame (n, PAST, 3)."""
    scans: Array
    """The scans then, likewise (n, PAST, rays) [m]; NaN for a ray that tells nothing, and for no scan."""
    steps: Array
    """Displacements since then, in the vehicle frame of then (n, 2) [m]."""
    last: Observation | None = None
    """What it saw then; None before the first."""


class Orca(NoValues):
    """Takes the manoeuvre nearest to the permitted velocity that is nearest to the one straight at the target.

    It sees the rays, the speed, the yaw rate, and bearing and distance of the target and of its landmark. It knows the
    circle that holds the footprint, whose centre, ahead of the axle, can move in any direction. It remembers the last
    scans, by which it tells what moves.
    """

    def __init__(self, options: OrcaOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._sensor, self._limits, self._drive = vehicle.sensor, vehicle.limits, drive
        self._scale = scale = length_scale(vehicle.footprint)
        self._spot = np.radians(options.spot_degrees)
        box = vehicle.footprint
        self._centre = np.array([box.x, box.y])
        self._radius = float(np.hypot(box.half_length, box.half_width)) + options.margin * scale

    def initial_state(self, size: int) -> OrcaState:
        """Returns an empty memory of n vehicles."""
        scans = np.full((size, PAST, self._sensor.rays), np.nan)
        return OrcaState(np.zeros(size, np.int64), np.zeros((size, PAST, 3)), scans, np.zeros((size, 2)))

    def reset(self, state: OrcaState, world_seeds: Mapping[int, int]) -> OrcaState:
        """Forgets these vehicles."""
        age, scans = state.age.copy(), state.scans.copy()
        age[list(world_seeds)], scans[list(world_seeds)] = 0, np.nan
        return replace(state, age=age, scans=scans)

    def act(self, observations: Observation, state: OrcaState) -> tuple[Actions, OrcaState]:
        """Chooses the manoeuvres nearest to the permitted velocities."""
        o, sensor, drive = observations, self._sensor, self._drive
        first = first_poses(o.landmark_distance, o.landmark_bearing)
        later = tracked(state.trails[:, 0], state.steps, o.landmark_distance, o.landmark_bearing)
        poses = np.where((state.age == 0)[:, None], first, later)
        scan = np.where(sensor.seen, o.ray_distances, np.nan)
        moving = velocities(
            *(scan, state.scans, poses, state.trails, np.array(sensor.position[:2]), sensor.angles, sensor.range),
            *(drive.decision_period, FASTEST * drive.speed, self._scale),
        )
        points = point_cloud(o.ray_distances, sensor) - self._centre
        permitted = self.permitted(points, moving, o)
        state = replace(
            state,
            age=state.age + 1,
            trails=np.concatenate([poses[:, None], state.trails[:, :-1]], axis=1),
            scans=np.concatenate([scan[:, None], state.scans[:, :-1]], axis=1),
            last=o,
        )
        actions = self._nearest(permitted, o.target_bearing)
        return actions, self.override(state, actions)

    def permitted(self, points: Array, moving: Array, observations: Observation) -> Array:
        """The permitted velocities nearest to the preferred ones (n, 2) [m/s].

        Args:
            points: From the circle's centre (n, r, 2) [m]; NaN for none.
            moving: Their velocities (n, r, 2) [m/s].
            observations: Of the n vehicles.
        """
        o, (ahead, left) = observations, self._centre
        now = np.stack([o.speed - left * o.yaw_rate, ahead * o.yaw_rate], axis=-1)
        toward = np.stack([np.cos(o.target_bearing), np.sin(o.target_bearing)], axis=-1)
        aim = o.target_distance[:, None] * toward - self._centre
        wanted = self._drive.speed * aim / np.maximum(np.hypot(*aim.T), 1e-9)[:, None]
        found = np.empty((len(points), 2))
        window = self.options.window * self._scale
        for i in range(len(points)):
            near = np.hypot(points[i, :, 0], points[i, :, 1]) < window
            lines = half_planes(
                *(points[i, near], moving[i, near], now[i]),
                *(self._radius, self.options.horizon, self._drive.decision_period),
            )
            found[i] = nearest_permitted(lines, wanted[i], self._drive.speed)
        return found

    def override(self, state: OrcaState, actions: Actions) -> OrcaState:
        """Returns the state after these actions in place of those last chosen."""
        if state.last is None:
            return state
        return replace(state, steps=displacements(state.last, actions, self._drive, self._limits))

    def _nearest(self, permitted: Array, target_bearing: Array) -> Actions:
        """The manoeuvres nearest to velocities (n, 2) [m/s] of the circle's centre."""
        speeds, direction = np.hypot(*permitted.T), np.arctan2(permitted[:, 1], permitted[:, 0])
        stands = speeds < self.options.least_share * self._drive.speed
        backs = ~stands & (np.abs(direction) > np.pi - LARGEST_TURN)
        turns = np.where(stands, target_bearing, np.where(backs, 0.0, direction))
        slowest = self._drive.reverse_share * self._drive.speed
        paces = nearest_paces(np.where(backs, -slowest, np.maximum(speeds, slowest)), self._drive)
        on_the_spot = stands | (np.abs(turns) > self._spot)
        return nearest_actions(turns, target_bearing) + np.where(on_the_spot, STOP, paces)


@njit(nogil=True)
def half_planes(points: Array, moving: Array, now: Array, radius: float, horizon: float, period: float) -> Array:
    """The lines that bound the permitted velocities (m, 4): a point of each and its direction, permitted on the left.

    The velocity obstacle of a group of points is the cone between its tangents, cut off by the line beyond which its
    nearest point is met within the horizon. The side that is nearest to the present velocity bounds what is permitted.
    A group that reaches round the vehicle has no tangents: each of its points cuts off what meets it.

    Args:
        points: From the vehicle, in the order of their directions (k, 2) [m].
        moving: Their velocities (k, 2) [m/s].
        now: Velocity of the vehicle (2,) [m/s].
        radius: Distance to keep from each [m].
        horizon: Time for which to keep it [s].
        period: Time within which to get as far away from what is nearer [s].
    """
    lines, count = np.empty((len(points), 4)), 0
    group = _groups(points, moving, 2 * radius)
    away, bearings = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    for g in range(group.max() + 1 if len(group) else 0):
        members = np.flatnonzero(group == g)
        left = right = 0.0
        nearest, middle = members[0], bearings[members[0]]
        for k in members:
            half = np.arcsin(radius / away[k]) if away[k] > radius else np.pi / 2
            turn = wrap_angle(bearings[k] - middle)
            left, right = max(left, turn + half), min(right, turn - half)
            nearest = k if away[k] < away[nearest] else nearest
        wide = left - right >= np.pi
        for k in members:
            if wide or k == nearest:
                nx, ny = np.cos(bearings[k]), np.sin(bearings[k])
                room = away[k] - radius
                most = room / (horizon if room > 0.0 else period)
                lines[count] = moving[k, 0] + most * nx, moving[k, 1] + most * ny, -ny, nx
                count += 1
        if not wide:
            vx, vy = now[0] - moving[nearest, 0], now[1] - moving[nearest, 1]
            outside = most - vx * nx - vy * ny
            for angle, side in ((middle + left, 1.0), (middle + right, -1.0)):
                dx, dy = side * np.cos(angle), side * np.sin(angle)
                if dx * vy - dy * vx > outside:
                    outside = dx * vy - dy * vx
                    lines[count - 1] = moving[nearest, 0], moving[nearest, 1], dx, dy
    return lines[:count]


@njit(nogil=True)
def _groups(points: Array, moving: Array, gap: float) -> NDArray[np.int64]:
    """Numbers the groups of neighbours (k,) with the same velocity that are at most a gap apart, all around."""
    group, number = np.zeros(len(points), np.int64), 0
    for k in range(len(points)):
        apart = points[k] - points[k - 1]  # the last is the neighbour of the first
        same = np.hypot(apart[0], apart[1]) <= gap and (moving[k] == moving[k - 1]).all()
        if k == 0:
            closed = same
        else:
            number += not same
            group[k] = number
    return np.where(group == number, 0, group) if len(points) and closed else group


@njit(nogil=True)
def nearest_permitted(lines: Array, wanted: Array, most: float) -> Array:
    """The velocity nearest to a wanted one (2,) left of all lines (m, 4), of at most a speed [m/s].

    If there is none, the one that is least far to the right of the line that it is farthest to the right of.
    """
    found, failed = _program(lines, len(lines), wanted, most, False)
    worst = 0.0
    projected = np.empty_like(lines)
    for i in range(failed, len(lines)):
        px, py, dx, dy = lines[i]
        if dx * (py - found[1]) - dy * (px - found[0]) <= worst:
            continue
        count = 0
        for j in range(i):
            qx, qy, ex, ey = lines[j]
            turn = dx * ey - dy * ex
            if abs(turn) <= PARALLEL:
                if dx * ex + dy * ey > 0.0:
                    continue
                x, y = (px + qx) / 2, (py + qy) / 2
            else:
                along = (ex * (py - qy) - ey * (px - qx)) / turn
                x, y = px + along * dx, py + along * dy
            size = np.hypot(ex - dx, ey - dy)
            projected[count] = x, y, (ex - dx) / size, (ey - dy) / size
            count += 1
        before = found
        found, failed_at = _program(projected, count, np.array((-dy, dx)), most, True)
        if failed_at < count:  # by rounding alone
            found = before
        worst = dx * (py - found[1]) - dy * (px - found[0])
    return found


@njit(nogil=True)
def _program(lines: Array, count: int, wanted: Array, most: float, is_direction: bool) -> tuple[Array, int]:
    """The best velocity left of the first lines, and how many of these it could satisfy one after the other.

    Best is nearest to `wanted`, or farthest in that direction.
    """
    size = np.hypot(wanted[0], wanted[1])
    found = wanted * (most / size) if is_direction or size > most else wanted.copy()
    for i in range(count):
        px, py, dx, dy = lines[i]
        if dx * (py - found[1]) - dy * (px - found[0]) <= 0.0:
            continue
        middle = px * dx + py * dy
        inside = middle * middle + most * most - px * px - py * py
        if inside < 0.0:
            return found, i
        low, high = -middle - np.sqrt(inside), -middle + np.sqrt(inside)
        for j in range(i):
            qx, qy, ex, ey = lines[j]
            turn, beside = dx * ey - dy * ex, ex * (py - qy) - ey * (px - qx)
            if abs(turn) <= PARALLEL:
                if beside < 0.0:
                    return found, i
            elif turn > 0.0:
                high = min(high, beside / turn)
            else:
                low = max(low, beside / turn)
            if low > high:
                return found, i
        if is_direction:
            along = high if wanted[0] * dx + wanted[1] * dy > 0.0 else low
        else:
            along = min(max(dx * (wanted[0] - px) + dy * (wanted[1] - py), low), high)
        found = np.array((px + along * dx, py + along * dy))
    return found, count
