"""A shield around any agent: it admits only actions that leave the vehicle room to stop.

Before each decision it predicts every action against the last scan: the turn under the drive's own profile and straight
on after it, over one control period and the distance in which the vehicle, with its load and grip, comes to a stop
(`prediction`). It takes the agent's best action that stays clear. If there is none, the vehicle brakes; once it stands,
it turns on the spot, to one side, until there is one (`fallback`). It leads an agent that gets no nearer to the target
(`recovery`). It completes sensors that read nothing against all evidence, and expects moving obstacles to come nearer
(`perception`).

Admitting only what can still be stopped is that of Fox, Burgard and Thrun, "The Dynamic Window Approach to Collision
Avoidance" (IEEE Robotics and Automation Magazine 4, 1997); correcting the choice of a learner from outside that of
Alshiekh et al., "Safe Reinforcement Learning via Shielding" (AAAI 2018).
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.agents.base import Overridable
from nnql_bullet.agents.turns import nearest_turns, offered_turns
from nnql_bullet.env import STOP, Observation, heading_change
from nnql_bullet.geometry import Array, wrap_angles
from nnql_bullet.mapping.point_cloud import point_cloud
from nnql_bullet.mapping.prediction import predicted_poses
from nnql_bullet.rollout import Agent
from nnql_bullet.shield.fallback import STANDSTILL_SPEED, Spin, fallback
from nnql_bullet.shield.perception import LastScan, perceived
from nnql_bullet.shield.prediction import Predictor, ShieldOptions, Situation
from nnql_bullet.shield.recovery import Recovery
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.profiles import ramp_distances
from nnql_bullet.vehicle.spec import VehicleSpec

__all__ = ["Shield", "ShieldOptions"]


@dataclass(frozen=True, slots=True)
class Memory:
    """What the shield remembers of one vehicle."""

    speed: float
    """Commanded speed [m/s]."""
    spin: Spin = field(default_factory=Spin)
    scan: LastScan = field(default_factory=LastScan)
    recovery: Recovery = field(default_factory=Recovery)
    """Progress and recovery; the only part that changes in place."""


class Shield:
    """Drives for an agent, see the module. It is an agent that also gives manoeuvres beyond the actions."""

    def __init__(
        self, options: ShieldOptions, agent: Agent, vehicle: VehicleSpec, drive: DriveOptions, task: TaskOptions
    ) -> None:
        """Puts the shield around the agent.

        Args:
            options: Of the shield.
            agent: Its actions are taken where they stay clear.
            vehicle: The vehicle with its load and grip.
            drive: How decisions reach the wheels.
            task: Says what sensors read of rays, and which states are safe.
        """
        self.options = options
        self.agent = agent
        self.overridden = np.zeros(0, np.bool_)
        """Whether the shield replaced the agent's last decision for each vehicle (n,)."""
        self._vehicle, self._drive, self._task = vehicle, drive, task
        self._predictor = Predictor(options, vehicle, drive)
        self._memories: list[Memory] = []

    def reset(self, vehicle: int, world_seed: int) -> None:
        """Forgets a vehicle, which is put into a world at the drive's speed."""
        self._make_room(vehicle + 1)
        self._memories[vehicle] = Memory(self._drive.speed)
        self.agent.reset(vehicle, world_seed)

    def action_values(self, observations: Observation) -> Array:
        """The agent's values of the paper's five turns (n, 5)."""
        return self.agent.action_values(observations)

    def act(self, observations: Observation) -> NDArray[np.int64]:
        """The manoeuvres (n,): the agent's best action that stays clear or, where there is none, the fallback."""
        n = len(observations.yaw_rate)
        self._make_room(n)
        memories = self._memories[:n]
        o, moving, scans = self.perceived(observations)
        values = self.agent.action_values(o)  # before it acts, which changes what it remembers
        wanted, turns = self.agent.act(o), offered_turns(o.target_bearing)
        ranks = action_ranks(values, wanted, turns)
        if self.options.recovers:
            self._recover(ranks, o, turns, memories)
        points = point_cloud(o.ray_distances, self._vehicle.sensor)
        speed = np.array([memory.speed for memory in memories])
        situation = Situation(o.yaw_rate, speed, turns, points, np.where(moving[..., None], points, np.nan))
        margins = self._predictor.margins(points)
        clear = self._predictor.stays_clear(situation, margins)
        chosen: NDArray[np.int64] = np.where(clear, ranks, -np.inf).argmax(axis=-1)
        spins = [memory.spin for memory in memories]
        for i in np.flatnonzero(~clear.any(axis=-1)).tolist():
            chosen[i], spins[i] = fallback(
                self._predictor,
                self.options,
                situation.of(np.array([i])),
                ranks[i],
                margins[i],
                spins[i],
                memories[i].recovery.side,
                float(o.target_bearing[i]),
            )
        self.overridden = np.asarray(chosen != wanted)
        if isinstance(self.agent, Overridable):
            self.agent.override(chosen)
        self._memories[:n] = self._remembered(o, chosen, memories, spins, scans)
        return chosen

    def perceived(self, observations: Observation) -> tuple[Observation, NDArray[np.bool_], list[LastScan]]:
        """What the shield takes the observations of vehicles 0 to n - 1 for; see `perception.perceived`."""
        memories = self._memories[: len(observations.yaw_rate)]
        standing = [memory.speed < STANDSTILL_SPEED for memory in memories]
        last = [memory.scan for memory in memories]
        return perceived(observations, last, standing, self._vehicle.sensor, self._task)

    def _make_room(self, size: int) -> None:
        """Adds memory for vehicles that were never reset."""
        self._memories += [Memory(self._drive.speed) for _ in range(len(self._memories), size)]

    def _recover(self, ranks: Array, o: Observation, turns: Array, memories: list[Memory]) -> None:
        """Ranks the actions of vehicles that are led by their nearness to where the recovery leads, in place."""
        for i, memory in enumerate(memories):
            recovery, distance = memory.recovery, float(o.target_distance[i])
            recovery.notice(distance, o.readings[i], memory.spin.side, self._drive.decision_period)
            if recovery.leads(distance):
                heading = recovery.heading(float(o.target_bearing[i]), o.ray_distances[i])
                ranks[i] = -np.abs(wrap_angles(turns[i] - heading))

    def _remembered(
        self,
        o: Observation,
        chosen: NDArray[np.int64],
        memories: list[Memory],
        spins: Iterable[Spin],
        scans: Iterable[LastScan],
    ) -> list[Memory]:
        """The memories after the decisions, with the pose and speed that each vehicle should have then."""
        limits, times = self._vehicle.limits, np.linspace(0.0, self._drive.decision_period, 11)[1:]
        speed = np.array([memory.speed for memory in memories])
        goals = np.where(chosen < STOP, self._drive.speed, 0.0)
        distances = ramp_distances(speed, goals, limits.acceleration, times)
        turns = heading_change(chosen, o.target_bearing)
        moved = predicted_poses(o.yaw_rate, turns[:, None], distances, limits, times)[:, 0, -1]
        change = limits.acceleration * self._drive.decision_period
        speed = np.minimum(np.maximum(goals, speed - change), speed + change)
        after = []
        for memory, pose, now, spin, scan in zip(memories, moved, speed.tolist(), spins, scans, strict=True):
            if now >= 0.9 * self._drive.speed:
                spin = Spin(spin.side if memory.recovery.side else 0)
            after.append(Memory(now, spin, replace(scan, moved=pose), memory.recovery))
        return after


def action_ranks(values: Array, wanted: NDArray[np.int64], turns: Array) -> Array:
    """How good the agent holds the six actions to be (n, 6): its choice first, then by its values.

    Where there are no values, the others rank by their nearness to its choice.

    Args:
        values: The agent's values of the five turns (n, 5); NaN for none.
        wanted: Its choices (n,).
        turns: Heading changes of the six actions (n, 6) [rad].
    """
    toward = np.take_along_axis(values, nearest_turns(turns[:, -1])[:, None], axis=1)
    values, rows = np.concatenate([values, toward], axis=1), np.arange(len(wanted))
    ranks = np.where(np.isfinite(values), values, -np.abs(turns - turns[rows, wanted][:, None]))
    ranks[rows, wanted] = np.inf
    return ranks
