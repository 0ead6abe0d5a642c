"""The task over a simulator: `reset` and `step` only sequence; vehicle, sensing, task and world decide.

`Navigation` is one vehicle, whose every movement can be followed; `FleetNavigation` is many, as arrays.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnql_bullet import paper
from nnql_bullet.geometry import Array, Pose, wrap_angle, wrap_angles
from nnql_bullet.sensing import RAYS, Scan
from nnql_bullet.sim.base import Fleet, Motion, Motions, Sample, Simulator
from nnql_bullet.task import (
    ENDINGS,
    GOES_ON,
    REWARD_TERMS,
    StateProperty,
    TaskOptions,
    ending,
    readings_of,
    reward_terms,
    state_property,
)
from nnql_bullet.worlds.spec import WorldSpec

TOWARD_TARGET = len(paper.TURNS)
"""The sixth action: the paper's rule for a safe state, "changes its orientation toward the target location"."""
ACTIONS = len(paper.TURNS) + 1
STOP = ACTIONS
"""Added to an action: the same turn, while the vehicle runs down to standing, and on the spot where it stands. Agents
choose among the actions alone; these are for a policy that knows more than an agent is asked for."""
MANOEUVRES = ACTIONS + STOP
LARGEST_TURN = max(paper.TURNS)
_TURNS = np.tile([*paper.TURNS, np.nan], 2)


def heading_change(action: int | Sequence[int] | NDArray[np.int64], target_bearing: ArrayLike) -> Array:
    """The turns (...) [rad] that actions (...) ask for: one of the paper's, or toward the target up to the largest."""
    toward = np.minimum(np.maximum(target_bearing, -LARGEST_TURN), LARGEST_TURN)
    return np.where(np.isnan(_TURNS[action]), toward, _TURNS[action])


def speed_scale(action: int | NDArray[np.int64]) -> Array:
    """The speeds (...) that actions (...) ask for, as shares of the drive's."""
    return np.where(np.less(action, STOP), 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Observation:
    """What an agent is told."""

    readings: Array
    """Of the eight sensors (8,) [m]: s_t of eq. (1)."""
    target_distance: float
    """[m]"""
    target_bearing: float
    """In the vehicle frame [rad], positive to the left."""
    yaw_rate: float
    """[rad/s]"""
    state_property: StateProperty
    ray_distances: Array
    """What is behind the readings (72,) [m]. The paper's vehicle is not told: only agents that say so use it."""


@dataclass(frozen=True, slots=True)
class Transition:
    """One step. `discount_t` is 0 where the episode ended for good, and 1 otherwise, at a timeout too."""

    s_tm1: Observation
    a_tm1: int
    r_t: float
    discount_t: float
    s_t: Observation
    terms: dict[str, float]
    ending: str | None
    """One of `task.ENDINGS`, or None while the episode goes on."""
    motion: Motion


class Navigation:
    """One vehicle's episodes in whatever simulator it is given."""

    def __init__(self, simulator: Simulator, task: TaskOptions) -> None:
        self.simulator = simulator
        self.task = task

    def reset(self, world: WorldSpec) -> Observation:
        """Starts an episode in `world`."""
        self._world = world
        self._steps = 0
        self.simulator.reset(world)
        self._observation = self._observe(self.simulator.pose(), 0.0, self.simulator.scan(), None)
        return self._observation

    def step(self, action: int, trace: list[Sample] | None = None) -> Transition:
        """Carries out one decision."""
        s_tm1 = self._observation
        turn = float(heading_change(action, s_tm1.target_bearing))
        motion = self.simulator.advance(turn, trace, float(speed_scale(action)))
        s_t = self._observe(motion.pose, motion.yaw_rate, self.simulator.scan(), motion)
        self._steps += 1
        terms = reward_terms(s_tm1.state_property, s_t.state_property, s_tm1.readings, s_t.readings, self.task).tolist()
        end = int(ending(s_t.state_property, self._steps, self.task))
        self._observation = s_t
        return Transition(
            s_tm1=s_tm1,
            a_tm1=action,
            r_t=sum(terms),
            discount_t=float(s_t.state_property in (StateProperty.SAFE, StateProperty.NON_SAFE)),
            s_t=s_t,
            terms=dict(zip(REWARD_TERMS, terms, strict=True)),
            ending=None if end == GOES_ON else ENDINGS[end],
            motion=motion,
        )

    def _observe(self, pose: Pose, yaw_rate: float, scan: Scan, motion: Motion | None) -> Observation:
        touching, at_target = (motion.touching, motion.at_target) if motion else (False, False)
        before = self._observation.state_property if motion else StateProperty.SAFE
        readings = readings_of(scan.distances, self.task)
        # NumPy's functions, as for a fleet: the last bit of Python's own is another now and then.
        dx, dy = self._world.target[0] - pose.x, self._world.target[1] - pose.y
        return Observation(
            readings=readings,
            target_distance=float(np.hypot(dx, dy)),
            target_bearing=float(wrap_angle(np.arctan2(dy, dx) - pose.yaw)),
            yaw_rate=yaw_rate,
            state_property=StateProperty(int(state_property(readings, touching, at_target, self.task, before))),
            ray_distances=scan.distances,
        )


@dataclass(frozen=True, slots=True)
class Observations:
    """What an agent is told of each of n vehicles: see `Observation`."""

    readings: Array
    """(n, 8) [m]"""
    target_distance: Array
    """(n,) [m]"""
    target_bearing: Array
    """(n,) [rad]"""
    yaw_rate: Array
    """(n,) [rad/s]"""
    state_property: NDArray[np.int64]
    """`StateProperty` (n,)."""
    ray_distances: Array
    """(n, 72) [m]"""


def stacked(observations: Sequence[Observation]) -> Observations:
    """Observations of single vehicles as one record."""
    return Observations(
        *(np.array([getattr(one, field.name) for one in observations]) for field in fields(Observations))
    )


MOST_YAW_RATE = 10.0
"""A larger one is told as this [rad/s]."""


def as_numbers(observations: Observation | Observations) -> NDArray[np.float32]:
    """Observations as float32 (..., 11): the eight readings, target distance, target bearing, yaw rate (clipped)."""
    o = observations
    numbers = np.empty((*o.readings.shape[:-1], paper.SECTORS + 3), np.float32)
    numbers[..., : paper.SECTORS] = o.readings
    numbers[..., -3], numbers[..., -2] = o.target_distance, o.target_bearing
    numbers[..., -1] = np.clip(o.yaw_rate, -MOST_YAW_RATE, MOST_YAW_RATE)
    return numbers


@dataclass(frozen=True, slots=True)
class Transitions:
    """One step of each of n vehicles: see `Transition`. The rows of those that stood by mean nothing."""

    s_tm1: Observations
    a_tm1: NDArray[np.int64]
    """(n,)"""
    r_t: Array
    """(n,)"""
    discount_t: Array
    """(n,)"""
    s_t: Observations
    terms: Array
    """(n, 6) in the order of `task.REWARD_TERMS`."""
    ending: NDArray[np.int64]
    """Index into `task.ENDINGS`, or `task.GOES_ON` (n,)."""
    motions: Motions
    active: NDArray[np.bool_]
    """Which vehicles took a step (n,)."""


Reward = Callable[[Transitions], Array]
"""Rewards (n,) of the transitions of n vehicles, in place of the paper's."""


class FleetNavigation:
    """Episodes of many vehicles in lockstep, in whatever fleet it is given."""

    def __init__(self, fleet: Fleet, task: TaskOptions, reward: Reward | None = None) -> None:
        self.fleet = fleet
        self.task = task
        self._reward = reward
        n = fleet.size
        self._target = np.zeros((n, 2))
        self._steps = np.zeros(n, np.int64)
        self._observations = Observations(
            np.zeros((n, paper.SECTORS)),
            np.zeros(n),
            np.zeros(n),
            np.zeros(n),
            np.zeros(n, np.int64),
            np.zeros((n, RAYS)),
        )

    @property
    def observations(self) -> Observations:
        """What there is to know of each vehicle now; the rows of those that were never reset mean nothing."""
        return self._observations

    def reset(self, worlds: Mapping[int, WorldSpec]) -> None:
        """Starts an episode in a world for each of some vehicles."""
        if not worlds:
            return
        vehicles = np.array(list(worlds))
        poses, ray_distances = self.fleet.reset(worlds)
        self._target[vehicles] = [world.target for world in worlds.values()]
        self._steps[vehicles] = 0
        nothing = np.zeros(len(vehicles), np.bool_)
        safe = np.full(len(vehicles), StateProperty.SAFE)
        self._observe(vehicles, poses, np.zeros(len(vehicles)), ray_distances, nothing, nothing, safe)

    def step(self, actions: NDArray[np.int64], active: NDArray[np.bool_] | None = None) -> Transitions:
        """Carries out one decision of each vehicle.

        Args:
            actions: What each does (n,); of no account where a vehicle is not active.
            active: Which vehicles take a step (n,); all if it is not given.
        """
        s_tm1 = self._observations
        if active is None:
            active = np.ones(self.fleet.size, np.bool_)
        turns = heading_change(actions, s_tm1.target_bearing)
        motions, ray_distances = self.fleet.advance(turns, active, speed_scale(actions))
        m = Motions(*(getattr(motions, field.name).copy() for field in fields(Motions)))
        v = np.flatnonzero(active)
        before = s_tm1.state_property[v]
        self._observe(v, m.pose[v], m.yaw_rate[v], ray_distances[v], m.touching[v], m.at_target[v], before)
        s_t = self._observations
        self._steps += active
        terms = reward_terms(s_tm1.state_property, s_t.state_property, s_tm1.readings, s_t.readings, self.task)
        t = Transitions(
            s_tm1=s_tm1,
            a_tm1=actions,
            r_t=terms.sum(axis=-1),
            discount_t=np.where(s_t.state_property <= StateProperty.NON_SAFE, 1.0, 0.0),
            s_t=s_t,
            terms=terms,
            ending=ending(s_t.state_property, self._steps, self.task),
            motions=m,
            active=active,
        )
        return t if self._reward is None else replace(t, r_t=np.asarray(self._reward(t), np.float64))

    def _observe(
        self,
        vehicles: NDArray[np.int64],
        poses: Array,
        yaw_rates: Array,
        ray_distances: Array,
        touching: NDArray[np.bool_],
        at_target: NDArray[np.bool_],
        before: NDArray[np.int64],
    ) -> None:
        """Takes down what some vehicles see now, in a record of its own: earlier ones stay as they were."""
        readings = readings_of(ray_distances, self.task)
        dx, dy = (self._target[vehicles] - poses[:, :2]).T
        seen = Observations(
            readings=readings,
            target_distance=np.hypot(dx, dy),
            target_bearing=wrap_angles(np.arctan2(dy, dx) - poses[:, 2]),
            yaw_rate=yaw_rates,
            state_property=state_property(readings, touching, at_target, self.task, before),
            ray_distances=ray_distances.copy(),
        )
        if len(vehicles) < self.fleet.size:
            everyone = Observations(*(getattr(self._observations, field.name).copy() for field in fields(Observations)))
            for field in fields(Observations):
                getattr(everyone, field.name)[vehicles] = getattr(seen, field.name)
            seen = everyone
        self._observations = seen
