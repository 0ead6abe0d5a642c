"""A shield around any agent: of what the agent would do, the best that leaves room to stop is done.

Before each decision every action is driven in thought against the last scan: the turn under the drive's own profile,
straight on after it, over one control period and the distance in which the vehicle stops with its load on its wheels.
The agent's best action that stays clear is taken. If there is none, the vehicle brakes; once it stands, it turns on the
spot to one side until there is one. What the sensors do not tell is taken to be as bad as the readings allow it to be:
a sensor that reads nothing against all evidence (`sector_faults`), and a box that has come where nothing was.

Fox, Burgard and Thrun, "The Dynamic Window Approach to Collision Avoidance" (IEEE RAM 1997), admit speeds in this way;
a shield that corrects a learner's choice is that of Alshiekh et al., "Safe Reinforcement Learning via Shielding" (AAAI
2018).
"""

from dataclasses import dataclass, field, replace
from math import hypot
from typing import Annotated

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import Agent
from nnql_bullet.agents.escape import Escape
from nnql_bullet.agents.look_ahead import scan_clearances
from nnql_bullet.agents.scan_points import scan_points
from nnql_bullet.agents.sector_faults import ENOUGH, completed, contradictions, place_of, silent_sectors
from nnql_bullet.agents.turns import nearest_turns, offered_turns
from nnql_bullet.config import options
from nnql_bullet.env import STOP, Observations, heading_change
from nnql_bullet.geometry import Array, as_rows, wrap_angles
from nnql_bullet.sensing import RAYS
from nnql_bullet.sim.base import DriveOptions
from nnql_bullet.task import Property, TaskOptions, is_safe, readings_of
from nnql_bullet.vehicle.demand import braking
from nnql_bullet.vehicle.drive import rolled_path, turn_headings
from nnql_bullet.vehicle.spec import VehicleSpec

LOOK_EVERY = 0.1
"""From one foreseen pose to the next [s]: 0.2 m at 2 m/s, less than the margin."""
STANDING = 0.05
"""Speed below which a vehicle is taken to stand [m/s]."""
GRIP_SHARE = 0.9
"""Of the hardest braking that load and friction allow, what is counted on."""
NEWCOMER, NEWCOMER_SHARE = 0.06, 0.03
"""How far in front of what was seen before something has to be, to have come there [m], and the share of its distance
that this grows by: between two rays there is more than they tell."""
ALL_ROUND = 14
"""Decisions to turn on the spot after which a vehicle has looked all round, and takes less room."""
AXLE = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
"""The rear-axle centre as a footprint without size."""


@options
class ShieldOptions:
    """How much room it keeps."""

    margin: Annotated[float, Field(ge=0)] = 0.3
    """Least distance from the footprint to the last scan, between whose rays there is more [m]."""
    tight_margin: Annotated[float, Field(ge=0)] = 0.06
    """The same for a vehicle that stands and has no other way: at arm's length rays are 4 cm apart [m]."""
    look_ahead: Annotated[float, Field(ge=0)] = 2.0
    """Way of every action that has to be clear; more where stopping takes more [m]."""
    corridor: Annotated[float, Field(ge=0)] = 6.0
    """Way within which there has to be room to turn round on the spot: else it leads into what the vehicle, which does
    not reverse, may not get out of [m]."""
    box_speed: Annotated[float, Field(ge=0)] = 1.0
    """At which whatever moves may come nearer [m/s]."""


@dataclass(slots=True)
class _Memory:
    """What is remembered of one vehicle."""

    speed: float
    """Commanded by now [m/s]."""
    side: int = 0
    """To which it turns on the spot: 1 left, -1 right, 0 while it does not."""
    turned: int = 0
    """Decisions to turn on the spot since it last went at speed."""
    escape: Escape = field(default_factory=Escape)
    points: Array = field(default_factory=lambda: np.full((RAYS, 2), np.nan))
    """Of the last scan, in the vehicle frame of now, had nothing moved but the vehicle (72, 2) [m]."""
    rays: Array = field(default_factory=lambda: np.full(RAYS, np.nan))
    """The last scan (72,) [m]."""
    moved: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of now in the vehicle frame of the last scan."""
    against: Array = field(default_factory=lambda: np.zeros(paper.SECTORS))
    """Contradictions of each sector since it last read something (8,)."""


class Shield:
    """Drives for an agent, see the module. It is a `rollout.Driver`."""

    def __init__(
        self, options: ShieldOptions, agent: Agent, vehicle: VehicleSpec, drive: DriveOptions, task: TaskOptions
    ) -> None:
        self.options = options
        self.agent = agent
        self.overruled = np.zeros(0, np.bool_)
        """Of which vehicles the last decision was not the agent's (n,)."""
        self._vehicle, self._drive, self._task = vehicle, drive, task
        self._footprint = as_rows((vehicle.footprint,))[0]
        box, limit = vehicle.footprint, vehicle.limits.acceleration
        self._round = hypot(abs(box.x) + box.half_length, abs(box.y) + box.half_width) + options.margin / 3
        self._deceleration = min(limit, GRIP_SHARE * braking(vehicle).deceleration)
        self._way = max(options.look_ahead, self._committed(np.array(drive.speed)).item())
        longest = max(self._way, options.corridor) / drive.speed + drive.speed / (2 * limit)
        self._times = np.arange(LOOK_EVERY, longest + LOOK_EVERY, LOOK_EVERY)
        quickest = 2 * (max(paper.TURNS) / vehicle.limits.yaw_acceleration) ** 0.5
        self._stop_times = np.arange(LOOK_EVERY, drive.speed / self._deceleration + quickest, LOOK_EVERY)
        self._memories: list[_Memory] = []

    def begin(self, vehicle: int, world_seed: int) -> None:
        """A vehicle is put into a world: what was remembered of it is forgotten."""
        more = vehicle + 1 - len(self._memories)
        self._memories += [_Memory(self._drive.speed) for _ in range(more)]
        self._memories[vehicle] = _Memory(self._drive.speed)
        self.agent.begin(vehicle, world_seed)

    def action_values(self, observations: Observations) -> Array:
        """What the agent expects of the paper's five turns (n, 5)."""
        return self.agent.action_values(observations)

    def exploit(self, observations: Observations) -> NDArray[np.int64]:
        """The manoeuvres (n,): the agent's best actions that stay clear or, beyond the actions, stops."""
        n = len(observations.yaw_rate)
        memories = self._memories[:n]
        o, moving = self._as_bad_as_may_be(observations, memories)
        points = scan_points(o.ray_distances, self._vehicle.sensor)
        wanted = self.agent.exploit(o)
        turns = offered_turns(o.target_bearing)
        ranks = self._ranks(o, wanted, turns, memories)
        speeds = np.array([memory.speed for memory in memories])
        look = _Look(o.yaw_rate, speeds, turns, points, np.where(moving[..., None], points, np.nan))
        least = self._least(points)
        clear = self._stays_clear(look, least)
        chosen = np.where(clear, ranks, -np.inf).argmax(axis=-1)
        for i in np.flatnonzero(~clear.any(axis=-1)).tolist():
            chosen[i] = self._last_resort(i, look, ranks[i], least[i], o.target_bearing[i])
        self.overruled = chosen != wanted
        self._remember(o, chosen)
        return np.asarray(chosen)

    # What is there

    def _as_bad_as_may_be(self, o: Observations, memories: list[_Memory]) -> tuple[Observations, NDArray[np.bool_]]:
        """The observations with dead sectors completed, and which rays meet what was not there before (n, 72)."""
        rays, moving = o.ray_distances.copy(), np.zeros(o.ray_distances.shape, np.bool_)
        sensor = np.array(self._vehicle.sensor[:2])
        for i, memory in enumerate(memories):
            if memory.speed >= STANDING:
                memory.against += contradictions(rays[i], memory.points, sensor)
            memory.against[~silent_sectors(rays[i])] = 0.0
            dead = memory.against >= ENOUGH
            moving[i] = newcomers(scan_points(rays[i], self._vehicle.sensor), memory.rays, memory.moved, sensor)
            points = scan_points(rays[i], self._vehicle.sensor)
            if dead.any():
                rays[i], remembered = completed(rays[i], dead, memory.points, sensor)
                points = np.where(np.isfinite(remembered), remembered, points)
            memory.points = points
        if not self.options.box_speed:
            moving[:] = False
        if np.array_equal(rays, o.ray_distances):
            return o, moving
        readings = readings_of(rays, self._task)
        unsafe = (o.property == Property.SAFE) & ~is_safe(readings, self._task)
        seen = np.where(unsafe, Property.NON_SAFE, o.property)
        return replace(o, ray_distances=rays, readings=readings, property=seen), moving

    def _least(self, points: Array) -> Array:
        """What each vehicle keeps (n,) [m]: the margin or, where it is nearer to something already, nearly that."""
        here: Array = scan_clearances(np.zeros((len(points), 1, 1, 3)), points, self._footprint)[:, 0, 0]
        close = np.where(here < 0.1, here - 0.005, np.maximum(here - 0.03, 0.1))
        return np.minimum(close, self.options.margin)

    # What is wanted

    def _ranks(self, o: Observations, wanted: NDArray[np.int64], turns: Array, memories: list[_Memory]) -> Array:
        """How good actions are held to be (n, 6): the agent's choice, then by its values, or by how near they are.

        For a vehicle that escapes, or is guided after that, by how near they are to where that leads.
        """
        values = self.agent.action_values(o)
        toward = np.take_along_axis(values, nearest_turns(turns[:, -1])[:, None], axis=1)
        values = np.concatenate([values, toward], axis=1)
        n = np.arange(len(wanted))
        ranks = np.where(np.isfinite(values), values, -np.abs(turns - turns[n, wanted][:, None]))
        ranks[n, wanted] = np.inf
        for i, memory in enumerate(memories):
            escape, distance = memory.escape, float(o.target_distance[i])
            escape.notice(distance, o.readings[i], memory.side, self._drive.decision_period)
            if escape.guides(distance):
                heading = escape.heading(float(o.target_bearing[i]), o.ray_distances[i])
                ranks[i] = -np.abs(wrap_angles(turns[i] - heading))
        return ranks

    # Where it leads

    def _committed(self, speeds: Array) -> Array:
        """Way to a stand of vehicles that go on for one more control period (...) [m]."""
        period = self._drive.decision_period
        after = np.minimum(speeds + self._vehicle.limits.acceleration * period, self._drive.speed)
        return np.asarray((speeds + after) / 2 * period + after**2 / (2 * self._deceleration))

    def _foreseen(self, look: "_Look", goal: float, times: Array) -> tuple[Array, Array]:
        """Poses (n, 6, k, 3) along the six turns, and the way up to each (n, k) [m]."""
        headings = turn_headings(look.yaw_rates[:, None], look.turns, self._vehicle.limits, times)
        limit = self._vehicle.limits.acceleration if goal > 0 else self._deceleration
        change, start = limit * np.concatenate([[0.0], times]), look.speeds[:, None]
        speeds = np.minimum(np.maximum(goal, start - change), start + change)
        ways = (speeds[:, 1:] + speeds[:, :-1]) / 2 * LOOK_EVERY
        places = rolled_path(0.0, ways[:, None, :], np.diff(headings, prepend=0.0))
        return np.concatenate([places, headings[..., None]], axis=-1), np.cumsum(ways, axis=-1)

    def _clearances(self, look: "_Look", poses: Array, times: Array) -> Array:
        """From the footprint to the nearest point (n, 6, k) [m], as near as what moves may have come by then."""
        clearances: Array = scan_clearances(poses, look.points, self._footprint)
        if np.isfinite(look.moving).any():
            moving = scan_clearances(poses, look.moving, self._footprint) - self.options.box_speed * times
            clearances = np.minimum(clearances, np.maximum(moving, 0.0))
        return clearances

    def _stays_clear(self, look: "_Look", least: Array, turn_round: bool = True) -> NDArray[np.bool_]:
        """Which actions (n, 6) keep clear, and lead to where the vehicle can turn round on the spot."""
        poses, ways = self._foreseen(look, self._drive.speed, self._times)
        clearances = self._clearances(look, poses, self._times)
        free = np.logical_and.accumulate(clearances >= least[:, None, None], axis=-1)
        far = ways[:, None, :]
        stands = free & (far >= self._committed(look.speeds)[:, None, None])
        if not turn_round:
            return np.asarray(stands.any(axis=-1))
        room = scan_clearances(poses, look.points, AXLE) > self._round
        return np.asarray((free & (far >= self._way)).any(axis=-1) & (stands & room).any(axis=-1))

    # If nothing is clear

    def _last_resort(self, i: int, looks: "_Look", ranks: Array, least: float, target_bearing: float) -> int:
        """A stop; for a vehicle that stands, a turn on the spot or, where there is no room for one, a tight way out."""
        memory, look = self._memories[i], looks.only(i)
        standing = memory.speed < STANDING
        stops = self._soon(look, 0.0)
        if np.isfinite(look.moving).any():
            return int(self._held(np.concatenate([self._soon(look, self._drive.speed), stops])).argmax())
        if not standing:
            order = np.argsort(np.abs(look.turns[0]), kind="stable")
            return STOP + int(order[self._held(stops)[order].argmax()])
        smallest = stops.min(axis=-1)
        tight = min(least, self.options.tight_margin)
        memory.side = memory.side or memory.escape.side or self._open_side(look, target_bearing)
        turns = [turn for side in (memory.side, -memory.side) for turn in ((1, 2) if side > 0 else (3, 4))]
        clear = [turn for turn in turns if smallest[turn] >= tight]
        memory.turned += 1
        if not clear or memory.turned > ALL_ROUND:
            for margin in (least, least / 2, tight):
                ways_out = self._stays_clear(look, np.array([margin]), turn_round=False)[0]
                if ways_out.any():
                    return int(np.where(ways_out, ranks, -np.inf).argmax())
        if not clear:
            return STOP
        memory.side = 1 if clear[0] in (1, 2) else -1
        return STOP + clear[0]

    def _soon(self, look: "_Look", goal: float) -> Array:
        """Clearances of one vehicle along the six turns (6, k) [m] while it would come to a stand."""
        poses, _ = self._foreseen(look, goal, self._stop_times)
        return self._clearances(look, poses, self._stop_times)[0]

    def _held(self, clearances: Array) -> Array:
        """How good courses (m,) with these clearances (m, k) are: how long until contact, then how much room."""
        smallest = clearances.min(axis=-1)
        lasts = np.where(smallest > 0, clearances.shape[-1], (clearances <= 0).argmax(axis=-1))
        return np.asarray(lasts + np.minimum(smallest, self.options.margin))

    def _open_side(self, look: "_Look", target_bearing: float) -> int:
        """On which side less turning, with some regard to the target, leads to where the way ahead is clear."""
        angles = np.radians(np.arange(0.0, 181.0, 15.0)) * np.array([[1.0], [-1.0]])
        ways = np.arange(LOOK_EVERY, self._way, LOOK_EVERY)
        places = np.stack([np.multiply.outer(np.cos(angles), ways), np.multiply.outer(np.sin(angles), ways)], axis=-1)
        poses = np.concatenate([places, np.broadcast_to(angles[..., None, None], (*places.shape[:-1], 1))], axis=-1)
        rays = scan_clearances(poses.reshape(1, -1, len(ways), 3), look.points, self._footprint)
        clear = (rays.min(axis=-1) >= self.options.margin).reshape(angles.shape)
        cost = np.where(clear, np.abs(angles) + np.abs(wrap_angles(angles - target_bearing)) / 2, np.inf).min(axis=-1)
        return 1 if cost[0] <= cost[1] else -1

    # What is remembered

    def _remember(self, o: Observations, chosen: NDArray[np.int64]) -> None:
        """What the decisions leave, and where they take the scan's points."""
        period, limit = self._drive.decision_period, self._vehicle.limits.acceleration
        turns = heading_change(chosen, o.target_bearing)
        times = np.arange(1, 11) * period / 10
        headings = turn_headings(o.yaw_rate, turns, self._vehicle.limits, times)
        for i, memory in enumerate(self._memories[: len(chosen)]):
            goal = self._drive.speed if chosen[i] < STOP else 0.0
            change = limit * np.concatenate([[0.0], times])
            speeds = np.minimum(np.maximum(goal, memory.speed - change), memory.speed + change)
            ways = (speeds[1:] + speeds[:-1]) / 2 * period / 10
            x, y = rolled_path(0.0, ways, np.diff(headings[i], prepend=0.0))[-1]
            yaw = headings[i, -1]
            c, s = np.cos(yaw), np.sin(yaw)
            memory.points = (memory.points - (x, y)) @ np.array([[c, -s], [s, c]])
            memory.rays, memory.moved = o.ray_distances[i].copy(), (float(x), float(y), float(yaw))
            memory.speed = float(speeds[-1])
            if memory.speed >= 0.9 * self._drive.speed:
                memory.turned = 0
                if not memory.escape.side:
                    memory.side = 0


def overruled(driver: object, size: int) -> NDArray[np.bool_]:
    """Of which of so many vehicles a driver's last decision was not its agent's (n,): of none without a shield."""
    return driver.overruled if isinstance(driver, Shield) else np.zeros(size, np.bool_)


@numba.njit(cache=True)
def newcomers(points: Array, before: Array, moved: tuple[float, float, float], sensor: Array) -> NDArray[np.bool_]:
    """Which points of a scan (72,) lie where the scan before saw nothing.

    Args:
        points: In the vehicle frame (72, 2) [m]; NaN for none.
        before: Ray distances of the scan before (72,) [m]; NaN if there was none.
        moved: The pose of now in the vehicle frame of then.
        sensor: x, y in the vehicle frame [m].
    """
    found = np.zeros(len(points), np.bool_)
    c, s = np.cos(moved[2]), np.sin(moved[2])
    for k in range(len(points)):
        x, y = points[k]
        if np.isnan(x):
            continue
        x, y = moved[0] + c * x - s * y, moved[1] + s * x + c * y
        place = place_of(x, y, sensor)
        free = min(before[int(np.floor(place)) % RAYS], before[int(np.ceil(place)) % RAYS])
        distance = np.hypot(x - sensor[0], y - sensor[1])
        found[k] = distance < free - NEWCOMER - NEWCOMER_SHARE * distance
    return found


@dataclass(frozen=True, slots=True)
class _Look:
    """What n vehicles foresee with."""

    yaw_rates: Array
    """(n,) [rad/s]"""
    speeds: Array
    """Commanded (n,) [m/s]."""
    turns: Array
    """Of the six actions (n, 6) [rad]."""
    points: Array
    """Of the scan, in the vehicle frame (n, 72, 2) [m]; NaN for none."""
    moving: Array
    """Those of them that have come where nothing was (n, 72, 2) [m]; NaN for the others."""

    def only(self, i: int) -> "_Look":
        """What one of them foresees with."""
        one = slice(i, i + 1)
        return _Look(self.yaw_rates[one], self.speeds[one], self.turns[one], self.points[one], self.moving[one])
