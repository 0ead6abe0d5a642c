"""A shield around any agent: it admits only actions that leave the vehicle room to stop.

Before each decision it predicts every action from the measured speed: the turn under the drive's own profile and
straight on after it. It takes the agent's best action that stays clear of what recent scans saw, and after which the
vehicle, with its load and grip, can stop before it comes near to where an obstacle may stand unseen (`prediction`,
`mapping.seen_space`); it drives slowly where that is only so at low speed. If there is none, the vehicle brakes; once
it stands, it turns on the spot, to one side, until there is one, or backs out (`fallback`). It leads an agent that gets
no nearer to the target on the shortest way through what was seen (`recovery`, `mapping.way`) and, where it is narrow or
leads back, one on a plan. It completes sensors that read nothing against all evidence, and expects moving obstacles to
come nearer (`perception`).

Admitting only what can still be stopped is that of Fox, Burgard and Thrun, "The Dynamic Window Approach to Collision
Avoidance" (IEEE Robotics and Automation Magazine 4, 1997); correcting the choice of a learner from outside that of
Alshiekh et al., "Safe Reinforcement Learning via Shielding" (AAAI 2018).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import radians

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import Knowing, Overridable
from nnql_bullet.agents.turns import nearest_turns, offered_turns
from nnql_bullet.env import ACTIONS, LARGEST_TURN, SLOW, STOP, Observation
from nnql_bullet.geometry import Array, wrap_angles
from nnql_bullet.mapping.way import first_surroundings, moved_on, place_seen, way_ahead, with_scan
from nnql_bullet.rollout import Actions, Policy, PolicyState
from nnql_bullet.sensing import smallest
from nnql_bullet.shield.fallback import first_choice
from nnql_bullet.shield.lengths import ShieldOptions, lengths_of
from nnql_bullet.shield.perception import perceive
from nnql_bullet.shield.prediction import can_stop, clear_by_margin, foresee
from nnql_bullet.shield.recovery import Recovery
from nnql_bullet.shield.setting import BACKS, DECISIONS, MOVING, SIDE, WORKED_IN, memory_of, setting_of
from nnql_bullet.shield.setting import Memory as Known
from nnql_bullet.task import NON_SAFE, SAFE, TaskOptions, is_safe
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

__all__ = ["Shield", "ShieldOptions"]

ALONG = radians(45.0)
"""Largest angle between the way of a recovery or plan and an action that drives along it [rad]."""
BEND = 0.7
"""Distance of the point on a plan, as a share of what it is on straight ways, below which the plan bends so much that
the vehicle drives slowly."""
NARROW = 1.25
"""Distance of the nearest obstacle from the sensor within which a plan leads, not the agent, in turning radii."""


@dataclass(frozen=True, slots=True)
class Memory:
    """The shield's memory of one vehicle."""

    known: Known
    """What its kernels remember."""
    recovery: Recovery = field(default_factory=Recovery)
    """Progress and recovery."""


@dataclass(frozen=True, slots=True)
class ShieldState:
    """The shield's memory of n vehicles, and the state of its agent."""

    memories: tuple[Memory, ...]
    overridden: NDArray[np.bool_]
    """Whether the shield replaced the agent's last decision for each vehicle (n,)."""
    agent: PolicyState


class Shield:
    """Drives for an agent, see the module. It is a policy that also chooses manoeuvres beyond the actions."""

    def __init__(
        self,
        options: ShieldOptions,
        agent: Policy,
        vehicle: VehicleSpec,
        drive: DriveOptions,
        task: TaskOptions,
        carrot: float | None = None,
    ) -> None:
        """Puts the shield around the agent.

        Args:
            options: Of the shield.
            agent: Its actions are taken where they stay clear.
            vehicle: The vehicle with its load and grip.
            drive: How decisions reach the wheels.
            task: Says what sensors read of rays, and which states are safe.
            carrot: Distance at which the target, a point on a plan, moves on ahead of the vehicle [m]; None for a
                target that stays.
        """
        self.options = options
        self.agent = agent
        # Asked once: the answer takes a while.
        self._overridable = agent if isinstance(agent, Overridable) else None
        self._knowing = agent if isinstance(agent, Knowing) else None
        self._vehicle, self._drive, self._task, self._carrot = vehicle, drive, task, carrot
        self._lengths = lengths_of(options, vehicle, drive)
        self._setting = setting_of(self._lengths, vehicle, drive, task)
        self._nothing = Memory(memory_of(self._setting))

    def initial_state(self, size: int) -> ShieldState:
        """Returns the state of n vehicles that have seen nothing."""
        return ShieldState((self._nothing,) * size, np.zeros(size, np.bool_), self.agent.initial_state(size))

    def reset(self, state: ShieldState, world_seeds: Mapping[int, int]) -> ShieldState:
        """Forgets vehicles that are put into worlds."""
        memories = tuple(self._nothing if i in world_seeds else memory for i, memory in enumerate(state.memories))
        return replace(state, memories=memories, agent=self.agent.reset(state.agent, world_seeds))

    def action_values(self, observations: Observation, state: ShieldState) -> Array:
        """Returns the agent's values of the paper's five turns (n, 5)."""
        return self.agent.action_values(observations, state.agent)

    def overridden(self, state: ShieldState) -> NDArray[np.bool_]:
        """Returns whether the shield replaced the agent's last decision for each vehicle (n,)."""
        return state.overridden

    def act(self, observations: Observation, state: ShieldState) -> tuple[Actions, ShieldState]:
        """Chooses the agent's best action that stays clear or, where there is none, the fallback.

        What the agent wants beyond the actions (`env.MANOEUVRES`) is done where the vehicle can stop after it;
        elsewhere, and beside moving obstacles, its heading change counts alone.
        """
        o, memories = self.perceived(observations, state.memories)
        wanted, agent_state = self.agent.act(o, state.agent)
        values = (
            self._knowing.values_of(agent_state)[:, : len(paper.TURNS)]
            if self._knowing
            else self.agent.action_values(o, state.agent)
        )
        turns = offered_turns(o.target_bearing)
        ranks = action_ranks(values, wanted % ACTIONS, turns)
        led, headings = np.zeros(len(wanted), np.bool_), np.zeros(len(wanted))
        p, around = self._setting, [memory.known for memory in memories]
        motions = list(zip(o.yaw_rate.tolist(), o.speed.tolist(), strict=True))
        clear = np.empty(turns.shape, np.bool_)
        situations = zip(around, turns, motions, clear, strict=True)
        margins = [clear_by_margin(p, m, its, *motion, marks) for m, its, motion, marks in situations]
        if self._carrot is not None:
            bends = (o.target_distance < BEND * self._carrot) & (o.distance_left > self._carrot)
            clear &= ~bends[:, None]  # slowly there
            at_speed = np.take_along_axis(clear, (wanted % ACTIONS)[:, None], axis=1)[:, 0]
            led, headings = ~at_speed | self._is_led_by_plan(o), o.target_bearing
        elif self.options.recovers:
            memories, led, headings = self._recovering(o, memories)
        away = np.abs(wrap_angles(turns - headings[:, None]))
        ranks, along = np.where(led[:, None], -away, ranks), ~led[:, None] | (away <= ALONG)
        chosen = np.empty(len(wanted), np.int64)
        orders, bearings = np.argsort(-ranks, axis=-1, kind="stable"), o.target_bearing.tolist()
        for i, (m, motion, margin) in enumerate(zip(around, motions, margins, strict=True)):
            admitted, action = clear[i] & along[i], int(wanted[i] % ACTIONS)
            calm = (wanted[i] >= SLOW and clear[i, action]) or not m.numbers[MOVING]
            follows = wanted[i] >= ACTIONS and calm and not led[i]
            chosen[i] = wanted[i]
            if not (follows and can_stop(p, m, int(wanted[i]), float(turns[i, action]), *motion, min(margin, p.tight))):
                chosen[i] = first_choice(
                    *(p, m, turns[i], orders[i], admitted, along[i] if led[i] else admitted),
                    *(bearings[i], *motion, margin, int(np.sign(headings[i]))),
                )
            if self._carrot is not None and not STOP <= chosen[i] < SLOW:
                m.numbers[[SIDE, DECISIONS, BACKS]] = 0
            foresee(p, m, int(chosen[i]), float(turns[i, chosen[i] % ACTIONS]), *motion)
        if self._overridable is not None:
            agent_state = self._overridable.override(agent_state, chosen)
        return chosen, ShieldState(memories, np.asarray(chosen != wanted), agent_state)

    def perceived(self, o: Observation, memories: Sequence[Memory]) -> tuple[Observation, tuple[Memory, ...]]:
        """Takes the scans of n vehicles in: what they see, with dead sensors completed, and their memories of it."""
        p, rays, readings, after = self._setting, o.ray_distances.copy(), np.empty_like(o.readings), []
        sights = zip(o.landmark_distance.tolist(), o.landmark_bearing.tolist(), o.speed.tolist(), strict=True)
        for memory, scan, sight, reading in zip(memories, rays, sights, readings, strict=True):
            members = memory.known._asdict().items()
            known = Known(**{name: its if name in WORKED_IN else its.copy() for name, its in members})
            perceive(p, known, scan, *sight, reading)
            after.append(replace(memory, known=known))
        unsafe = (o.state_property == SAFE) & ~is_safe(readings, self._task) & (readings < o.readings).any(axis=-1)
        state = np.where(unsafe, NON_SAFE, o.state_property)
        return replace(o, ray_distances=rays, readings=readings, state_property=state), tuple(after)

    def _is_led_by_plan(self, o: Observation) -> NDArray[np.bool_]:
        """Whether the plan, not the agent, leads each vehicle (n,): where it is narrow, or the plan leads back."""
        narrow = smallest(o.readings) < NARROW * self._lengths.turning_radius
        return np.asarray(narrow | (np.abs(o.target_bearing) > LARGEST_TURN))

    def _recovering(
        self, o: Observation, memories: Sequence[Memory]
    ) -> tuple[tuple[Memory, ...], NDArray[np.bool_], Array]:
        """Updates the recoveries; also whether each leads its vehicle (n,), and to which heading change (n,) [rad]."""
        after = []
        led, headings = np.zeros(len(memories), np.bool_), np.zeros(len(memories))
        for i, memory in enumerate(memories):
            left, place = float(o.distance_left[i]), (float(o.landmark_distance[i]), float(o.landmark_bearing[i]))
            recovery = memory.recovery.updated(left, self._drive.decision_period, self._lengths.scale)
            around = None
            if recovery.leads(left):
                rays = np.where(memory.known.moving, 0.0, memory.known.scans[0])
                around = recovery.surroundings
                around = moved_on(around, memory.known.moved, *place) if around else None
                around = with_scan(around or first_surroundings(*place), rays, self._vehicle)
                tight, reach = self._lengths.tight_margin, self._lengths.turning_radius
                target = float(o.target_distance[i]), float(o.target_bearing[i])
                goal = np.zeros(2) if target == place else place_seen(around.pose, *target)
                led[i], headings[i] = True, way_ahead(around, self._vehicle, tight, reach, goal)
            after.append(replace(memory, recovery=replace(recovery, surroundings=around)))
        return tuple(after), led, headings


def action_ranks(values: Array, wanted: NDArray[np.int64], turns: Array) -> Array:
    """How good the agent holds the six actions to be (n, 6): its choice first, then by its values.

    Where there are no values, the others rank by their nearness to its choice.

    Args:
        values: The agent's values of the five turns (n, 5); NaN for none.
        wanted: Its choices (n,), below `env.ACTIONS`.
        turns: Heading changes of the six actions (n, 6) [rad].
    """
    toward = np.take_along_axis(values, nearest_turns(turns[:, -1])[:, None], axis=1)
    values, rows = np.concatenate([values, toward], axis=1), np.arange(len(wanted))
    ranks = np.where(np.isfinite(values), values, -np.abs(turns - turns[rows, wanted][:, None]))
    ranks[rows, wanted] = np.inf
    return ranks
