"""A shield around any agent: of what the agent would do, the best that leaves room to stop is done.

Before each decision every action is driven in thought against the last scan: the turn under the drive's own profile and
straight on after it, over one control period and the distance in which the vehicle, with its load and grip, comes to
a stand. The agent's best action that stays clear is taken. If there is none, the vehicle brakes; once it stands, it
turns on the spot, to one side, until there is one. An agent that gets no nearer to the target is led on (`recovery`).

What the sensors do not tell is taken to be as bad as it may be: a sensor that reads nothing against all evidence is
completed (`sector_faults`), and what has come where nothing was is expected to come on.

Admitting only what can still be stopped is that of Fox, Burgard and Thrun, "The Dynamic Window Approach to Collision
Avoidance" (IEEE Robotics and Automation Magazine 4, 1997); correcting the choice of a learner from outside that of
Alshiekh et al., "Safe Reinforcement Learning via Shielding" (AAAI 2018).
"""

from dataclasses import dataclass, field, fields, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import Overridable
from nnql_bullet.agents.symmetry import LEFT_TURNS, RIGHT_TURNS
from nnql_bullet.agents.turns import nearest_turns, offered_turns
from nnql_bullet.config import options
from nnql_bullet.env import STOP, Observation, heading_change
from nnql_bullet.geometry import Array, as_rows, wrap_angles
from nnql_bullet.mapping.localization import TargetFix, found_pose, seen_from
from nnql_bullet.mapping.point_cloud import moving_points, point_cloud
from nnql_bullet.mapping.prediction import PREDICTION_STEP, predicted_poses, scan_clearances
from nnql_bullet.mapping.sector_faults import ENOUGH, completed, contradictions, silent_sectors
from nnql_bullet.rollout import Agent
from nnql_bullet.sensing import RAYS
from nnql_bullet.shield.recovery import Recovery
from nnql_bullet.task import StateProperty, TaskOptions, is_safe, readings_of
from nnql_bullet.types import NonNegative
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.limits import followed_limits, turning_deceleration
from nnql_bullet.vehicle.profiles import ramp_distances
from nnql_bullet.vehicle.spec import Limits, VehicleSpec

DISTANCE_STEP = 0.1
"""Distance between predicted places along a path [m]."""
GRIP_SHARE = 0.9
"""Of the hardest braking that load and friction allow, what is counted on."""
STANDSTILL_SPEED = 0.05
"""Speed below which a vehicle stands [m/s]."""
GIVING = 0.03
"""By how much a vehicle that is nearer than the margin already may get nearer still [m]."""
TOUCHING = 0.1
"""At this distance it may no more [m]."""
ALL_ROUND = 14
"""Decisions to turn on the spot after which a vehicle has looked all round, and makes do with less room."""
AXLE = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
"""The rear-axle centre as a footprint without size."""


@options
class ShieldOptions:
    """How much room it keeps.

    Percentages are goals of `straight` in it at 20 % cover / in traps / in aisles: kinematic model, validation worlds 0
    to 149. One world is 0.7 points, and less than three mean nothing. The defaults got 99.3 / 99.3 / 98.7 %; none of
    these values led to a collision there.
    """

    margin: NonNegative = 0.3
    """Least distance from the footprint to the last scan, between whose rays there is more [m]. 0.15 m got
    100 / 100 / 99.3 %, 0.4 m 99.3 / 98.0 / 98.7 %; contact physics, which strays by centimetres, needs some."""
    tight_margin: NonNegative = 0.06
    """The same for a vehicle that stands and has no other way: at arm's length rays are 4 cm apart [m]."""
    look_ahead: NonNegative = 2.0
    """Way of every action that has to be clear; more where a control period and stopping take more [m]. 0 m, which is
    1.8 m, got 100 / 98.7 / 99.3 %, 3 m 100 / 98.7 / 95.3 %."""
    corridor: NonNegative = 6.0
    """Way on which there has to be a place to turn round on the spot; else it leads into what the vehicle, which does
    not reverse, may not get out of [m]. 0 m, which is the way above, got 98.0 / 98.7 / 99.3 %."""
    box_speed: NonNegative = 1.0
    """At which what moves may come nearer [m/s]. 0 got 74.7 % among boxes that move, 1 m/s 99.3 %."""
    recovers: bool = True
    """Whether an agent that gets no nearer to the target is led on. Without, 99.3 / 72.7 / 96.0 %."""


@dataclass(slots=True)
class _Memory:
    """What is remembered of one vehicle."""

    speed: float
    """Commanded by now [m/s]."""
    side: int = 0
    """To which it turns on the spot: 1 left, -1 right, 0 while it does not."""
    turned: int = 0
    """Decisions to turn on the spot since it last went at speed."""
    recovery: Recovery = field(default_factory=Recovery)
    points: Array = field(default_factory=lambda: np.full((RAYS, 2), np.nan))
    """Of the last scan, in the vehicle frame of then (72, 2) [m]."""
    rays: Array = field(default_factory=lambda: np.full(RAYS, np.nan))
    """The last scan (72,) [m]."""
    target: TargetFix = field(default_factory=lambda: TargetFix(0.0, 0.0))
    """As seen then."""
    moved: Array = field(default_factory=lambda: np.zeros(3))
    """The pose of now in the vehicle frame of then (3,), as it should be."""
    against: Array = field(default_factory=lambda: np.zeros(paper.SECTORS))
    """What speaks against each sector since it last read something (8,)."""


@dataclass(frozen=True, slots=True)
class _Look:
    """What n vehicles foresee with."""

    yaw_rate: Array
    """(n,) [rad/s]"""
    speed: Array
    """Commanded (n,) [m/s]."""
    turns: Array
    """Of the six actions (n, 6) [rad]."""
    points: Array
    """Of the scan, in the vehicle frame (n, 72, 2) [m]; NaN for none."""
    moving: Array
    """Those of them that belong to what moves (n, 72, 2) [m]; NaN for the others."""

    def of(self, vehicles: NDArray[np.int64]) -> "_Look":
        """What some of them foresee with."""
        return _Look(*(getattr(self, its.name)[vehicles] for its in fields(self)))


class Shield:
    """Drives for an agent, see the module. It is an agent that also gives manoeuvres beyond the actions."""

    def __init__(
        self, options: ShieldOptions, agent: Agent, vehicle: VehicleSpec, drive: DriveOptions, task: TaskOptions
    ) -> None:
        """Puts the shield around the agent.

        Args:
            options: Of the shield.
            agent: Whose choices are taken where they stay clear.
            vehicle: What it drives, with its load and grip.
            drive: How decisions reach the wheels.
            task: Says what sensors read of rays, and which states are safe.
        """
        self.options = options
        self.agent = agent
        self.overridden = np.zeros(0, np.bool_)
        """Of which vehicles the last decision was not the agent's (n,)."""
        self._vehicle, self._drive, self._task = vehicle, drive, task
        self._sensor, self._footprint = np.array(vehicle.sensor[:2]), as_rows((vehicle.footprint,))[0]
        limits = vehicle.limits
        self._deceleration = min(limits.acceleration, GRIP_SHARE * turning_deceleration(vehicle, drive.speed))
        # What the drive asks for; what load and grip let the vehicle follow of it at speed, and while that changes.
        self._asked = limits
        self._followed = followed_limits(vehicle, drive.speed)
        self._followed_changing = followed_limits(vehicle, drive.speed / 2, limits.acceleration)
        self._way = max(options.look_ahead, float(self._committed(np.array(drive.speed))))
        self._turning_circle = float(np.hypot(*vehicle.footprint.corners().T).max()) + TOUCHING
        longest = max(self._way, options.corridor) / drive.speed + drive.speed / (2 * limits.acceleration)
        stop = drive.speed / self._deceleration + 2 * sqrt(max(paper.TURNS) / limits.yaw_acceleration)
        self._times = np.arange(PREDICTION_STEP, longest + PREDICTION_STEP, PREDICTION_STEP)
        self._stop_times = np.arange(PREDICTION_STEP, stop, PREDICTION_STEP)
        self._memories: list[_Memory] = []

    def reset(self, vehicle: int, world_seed: int) -> None:
        """A vehicle is put into a world, at the drive's speed: what was remembered of it is forgotten."""
        self._make_room(vehicle + 1)
        self._memories[vehicle] = _Memory(self._drive.speed)
        self.agent.reset(vehicle, world_seed)

    def action_values(self, observations: Observation) -> Array:
        """What the agent expects of the paper's five turns (n, 5)."""
        return self.agent.action_values(observations)

    def act(self, observations: Observation) -> NDArray[np.int64]:
        """The manoeuvres (n,): the agent's best action that stays clear or, where there is none, a stop."""
        self._make_room(len(observations.yaw_rate))
        memories = self._memories[: len(observations.yaw_rate)]
        o, moving = self._at_worst(observations, memories)
        values = self.agent.action_values(o)  # before it decides: what it remembers is another afterwards
        wanted, turns = self.agent.act(o), offered_turns(o.target_bearing)
        ranks = self._ranks(o, values, wanted, turns, memories)
        points = point_cloud(o.ray_distances, self._vehicle.sensor)
        speed = np.array([memory.speed for memory in memories])
        look = _Look(o.yaw_rate, speed, turns, points, np.where(moving[..., None], points, np.nan))
        kept = self._kept_distance(points)
        clear = self._stays_clear(look, kept)
        chosen: NDArray[np.int64] = np.where(clear, ranks, -np.inf).argmax(axis=-1)
        for i in np.flatnonzero(~clear.any(axis=-1)).tolist():
            chosen[i] = self._stop(memories[i], look.of(np.array([i])), ranks[i], kept[i], o.target_bearing[i])
        self.overridden = np.asarray(chosen != wanted)
        if isinstance(self.agent, Overridable):
            self.agent.override(chosen)
        self._remember(o, chosen, memories)
        return chosen

    def _make_room(self, size: int) -> None:
        """Lets so many vehicles be remembered."""
        self._memories += [_Memory(self._drive.speed) for _ in range(len(self._memories), size)]

    # What is there

    def _at_worst(self, o: Observation, memories: list[_Memory]) -> tuple[Observation, NDArray[np.bool_]]:
        """The observations with dead sectors completed, and which rays meet what moves (n, 72)."""
        rays, moving = o.ray_distances.copy(), np.zeros(o.ray_distances.shape, np.bool_)
        for i, memory in enumerate(memories):
            points = point_cloud(rays[i], self._vehicle.sensor)
            target = TargetFix(float(o.target_distance[i]), float(o.target_bearing[i]))
            moved = found_pose(memory.moved, memory.target, target)
            strayed = float(np.hypot(*(moved - memory.moved)[:2]))
            moving[i] = moving_points(points, memory.rays, moved, strayed, self._sensor)
            expected = seen_from(moved, memory.points)
            if memory.speed >= STANDSTILL_SPEED:  # else the same sight would speak against a sensor again and again
                memory.against += contradictions(rays[i], expected, self._sensor)
            memory.against[~silent_sectors(rays[i])] = 0.0
            dead = memory.against >= ENOUGH
            if dead.any():
                rays[i], remembered = completed(rays[i], dead, expected, self._sensor)
                points = np.where(np.isnan(remembered), points, remembered)
            memory.points, memory.rays, memory.target = points, rays[i], target
        readings = readings_of(rays, self._task)
        unsafe = (
            (o.state_property == StateProperty.SAFE)
            & ~is_safe(readings, self._task)
            & (readings < o.readings).any(axis=-1)
        )
        state = np.where(unsafe, StateProperty.NON_SAFE, o.state_property)
        return replace(o, ray_distances=rays, readings=readings, state_property=state), moving

    def _kept_distance(self, points: Array) -> Array:
        """What each vehicle keeps (n,) [m]: the margin or, where it is nearer to something already, nearly that."""
        here: Array = scan_clearances(np.zeros((len(points), 1, 1, 3)), points, self._footprint)[:, 0, 0]
        given = np.where(here < TOUCHING, here - GIVING / 6, np.maximum(here - GIVING, TOUCHING))
        return np.minimum(given, self.options.margin)

    # What is wanted

    def _ranks(
        self, o: Observation, values: Array, wanted: NDArray[np.int64], turns: Array, memories: list[_Memory]
    ) -> Array:
        """How good actions are held to be (n, 6): the agent's choice, then by its values or by nearness to its choice.

        For a vehicle that is led on, by nearness to where that leads.
        """
        toward = np.take_along_axis(values, nearest_turns(turns[:, -1])[:, None], axis=1)
        values, rows = np.concatenate([values, toward], axis=1), np.arange(len(wanted))
        ranks = np.where(np.isfinite(values), values, -np.abs(turns - turns[rows, wanted][:, None]))
        ranks[rows, wanted] = np.inf
        for i, memory in enumerate(memories if self.options.recovers else ()):
            recovery, distance = memory.recovery, float(o.target_distance[i])
            recovery.notice(distance, o.readings[i], memory.side, self._drive.decision_period)
            if recovery.leads(distance):
                heading = recovery.heading(float(o.target_bearing[i]), o.ray_distances[i])
                ranks[i] = -np.abs(wrap_angles(turns[i] - heading))
        return ranks

    # Where it leads

    def _committed(self, speeds: Array) -> Array:
        """Way to a stand of vehicles that go on for one more control period (...) [m]."""
        period = self._drive.decision_period
        after = np.minimum(speeds + self._vehicle.limits.acceleration * period, self._drive.speed)
        return np.asarray((speeds + after) / 2 * period + after * after / (2 * self._deceleration))

    def _predicted(self, look: _Look, goal: float, times: Array, limits: Limits) -> tuple[Array, Array, Array]:
        """Poses along the six turns (n, 6, k, 3), clearances there (n, 6, k) and the way up to them (n, 1, k) [m].

        What moves may have come nearer by then.
        """
        goals = np.full(len(look.speed), goal)
        acceleration = limits.acceleration if goal > 0 else self._deceleration
        ways = ramp_distances(look.speed, goals, acceleration, times)
        poses = predicted_poses(look.yaw_rate, look.turns, ways, limits, times)
        clearances: Array = scan_clearances(poses, look.points, self._footprint)
        if np.isfinite(look.moving).any():
            moving = scan_clearances(poses, look.moving, self._footprint) - self.options.box_speed * times
            clearances = np.minimum(clearances, np.maximum(moving, 0.0))
        return poses, clearances, np.cumsum(ways, axis=-1)[:, None, :]

    def _stays_clear(self, look: _Look, kept: Array, turns_round: bool = True) -> NDArray[np.bool_]:
        """Which actions (n, 6) keep a distance (n,) [m] up to where the vehicle can stand, and turn round on the spot.

        Where it need not turn round, to stand is enough. It may turn as asked or fall behind, and has to be clear
        either way.
        """
        clear, at_speed = self._keeps(look, kept, turns_round, self._asked), look.speed >= self._drive.speed
        for which, followed in ((at_speed, self._followed), (~at_speed, self._followed_changing)):
            some = np.flatnonzero(which & clear.any(axis=-1))
            if len(some) and followed != self._asked:
                clear[some] &= self._keeps(look.of(some), kept[some], turns_round, followed)
        return clear

    def _keeps(self, look: _Look, kept: Array, turns_round: bool, limits: Limits) -> NDArray[np.bool_]:
        """`_stays_clear` under the limits that the vehicle follows."""
        poses, clearances, ways = self._predicted(look, self._drive.speed, self._times, limits)
        free = np.logical_and.accumulate(clearances >= kept[:, None, None], axis=-1)
        stands = free & (ways >= self._committed(look.speed)[:, None, None])
        if not turns_round:
            return np.asarray(stands.any(axis=-1))
        has_room = scan_clearances(poses, look.points, AXLE) >= self._turning_circle
        return np.asarray((free & (ways >= self._way)).any(axis=-1) & (stands & has_room).any(axis=-1))

    # If nothing stays clear

    def _stop(self, memory: _Memory, look: _Look, ranks: Array, kept: float, target_bearing: float) -> int:
        """What one vehicle does: it brakes, or turns on the spot.

        Beside what moves it does whatever stays out of contact longest.
        """
        stops = self._soon(look, 0.0, self._followed_changing)
        if np.isfinite(look.moving).any():
            at_speed = look.speed[0] >= self._drive.speed
            drives = self._soon(look, self._drive.speed, self._followed if at_speed else self._followed_changing)
            return int(self._worth(np.concatenate([drives, stops])).argmax())
        if memory.speed >= STANDSTILL_SPEED:
            order = np.argsort(np.abs(look.turns[0]), kind="stable")
            return STOP + int(order[self._worth(stops)[order].argmax()])
        return self._turn_on_the_spot(memory, look, stops.min(axis=-1), ranks, kept, target_bearing)

    def _soon(self, look: _Look, goal: float, followed: Limits) -> Array:
        """Clearances of one vehicle along the six turns (6, k) [m] while it could brake, turning as asked or behind."""
        both = self._asked, followed
        asked, behind = (self._predicted(look, goal, self._stop_times, limits)[1][0] for limits in both)
        return np.asarray(np.minimum(asked, behind))

    def _worth(self, clearances: Array) -> Array:
        """How good courses with these clearances (m, k) are (m,): how long they are out of contact, then by how much.

        The first counts in whole steps, the second is less than a metre.
        """
        smallest = clearances.min(axis=-1)
        lasts = np.where(smallest > 0, clearances.shape[-1], (clearances <= 0).argmax(axis=-1))
        return np.asarray(lasts + np.minimum(smallest, min(self.options.margin, 0.99)))

    def _turn_on_the_spot(
        self, memory: _Memory, look: _Look, clearances: Array, ranks: Array, kept: float, target_bearing: float
    ) -> int:
        """A turn to the side once chosen, or to the other if there is no room; after all of them a tight way out.

        Args:
            memory: Of the vehicle.
            look: What it foresees with.
            clearances: Smallest of each turn (6,) [m].
            ranks: Of the actions (6,).
            kept: Distance that it keeps if it can [m].
            target_bearing: [rad]
        """
        tight = min(kept, self.options.tight_margin)
        memory.side = memory.side or memory.recovery.side or self._open_side(look, target_bearing)
        turns = (*LEFT_TURNS, *RIGHT_TURNS) if memory.side > 0 else (*RIGHT_TURNS, *LEFT_TURNS)
        possible = [turn for turn in turns if clearances[turn] >= tight]
        memory.turned += 1
        if not possible or memory.turned > ALL_ROUND:
            for distance in (kept, kept / 2, tight):
                ways_out = self._stays_clear(look, np.array([distance]), turns_round=False)[0]
                if ways_out.any():
                    return int(np.where(ways_out, ranks, -np.inf).argmax())
        if not possible:
            return STOP
        memory.side = 1 if possible[0] in LEFT_TURNS else -1
        return STOP + possible[0]

    def _open_side(self, look: _Look, target_bearing: float) -> int:
        """On which side less turning, with some regard to the target, leads to where the way ahead is clear."""
        angles = np.radians(np.arange(-180.0, 181.0, 15.0))
        ways = np.arange(DISTANCE_STEP, self._way, DISTANCE_STEP)
        along, turned = np.broadcast_arrays(ways, angles[:, None])
        poses = np.stack([along * np.cos(turned), along * np.sin(turned), turned], axis=-1)
        clear = scan_clearances(poses[None], look.points, self._footprint)[0].min(axis=-1) >= self.options.margin
        cost = np.abs(angles) + np.abs(wrap_angles(angles - target_bearing)) / 2
        cost = np.where(clear, cost, np.inf)
        return 1 if cost[angles >= 0].min() <= cost[angles <= 0].min() else -1

    # What is remembered

    def _remember(self, o: Observation, chosen: NDArray[np.int64], memories: list[_Memory]) -> None:
        """Reckons where the decisions take each vehicle, and at what speed."""
        limits, times = self._vehicle.limits, np.linspace(0.0, self._drive.decision_period, 11)[1:]
        speed = np.array([memory.speed for memory in memories])
        goals = np.where(chosen < STOP, self._drive.speed, 0.0)
        ways = ramp_distances(speed, goals, limits.acceleration, times)
        turns = heading_change(chosen, o.target_bearing)
        moved = predicted_poses(o.yaw_rate, turns[:, None], ways, limits, times)[:, 0, -1]
        change = limits.acceleration * self._drive.decision_period
        speed = np.minimum(np.maximum(goals, speed - change), speed + change)
        for memory, pose, now in zip(memories, moved, speed.tolist(), strict=True):
            memory.moved, memory.speed = pose, now
            if now >= 0.9 * self._drive.speed:
                memory.turned = 0
                memory.side = memory.side if memory.recovery.side else 0
