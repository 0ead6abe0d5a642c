"""What an episode comes to, and one episode that can be watched."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import (
    STOP,
    FleetNavigation,
    Navigation,
    Observation,
    Observations,
    Transition,
    Transitions,
    stacked,
)
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.local import as_motions
from nnql_bullet.task import ENDINGS, NO_ENDING, REWARD_TERMS, StateProperty
from nnql_bullet.worlds.spec import WorldSpec


class Policy(Protocol):
    """Decides for vehicles, of which it may remember what it saw and did. Every agent is one."""

    def reset(self, vehicle: int, world_seed: int) -> None:
        """A vehicle is put into a world: what was remembered of it is forgotten, and its chance begins anew."""

    def act(self, observations: Observations) -> NDArray[np.int64]:
        """The actions (n,) that it holds best for vehicles 0 to n - 1."""


@runtime_checkable
class Overriding(Protocol):
    """A policy that takes decisions in an agent's place, as a shield does."""

    overridden: NDArray[np.bool_]
    """Of which vehicles the last decision was not the agent's (n,)."""


def overridden(policy: Policy, size: int) -> NDArray[np.bool_]:
    """Of which of so many vehicles the last decision was not the agent's (n,): of none without a shield."""
    return policy.overridden if isinstance(policy, Overriding) else np.zeros(size, np.bool_)


@dataclass(frozen=True, slots=True)
class Reflex:
    """A policy that remembers nothing."""

    policy: Callable[[Observations], NDArray[np.int64]]
    """Actions (n,) for what n vehicles see."""

    def reset(self, vehicle: int, world_seed: int) -> None:
        """There is nothing to forget."""

    def act(self, observations: Observations) -> NDArray[np.int64]:
        """What the policy says."""
        return self.policy(observations)


@dataclass(frozen=True, slots=True)
class EpisodeSummary:
    """What an episode came to."""

    world_seed: int
    ending: str
    """One of `task.ENDINGS`."""
    steps: int
    duration: float
    """[s]"""
    path_length: float
    """[m]"""
    clearance: float
    """Smallest distance to an obstacle or wall [m]."""
    mean_clearance: float
    """Mean over control periods of the smallest in each [m]."""
    lateral_acceleration: float
    """Largest at the end of a control period [m/s2]."""
    heading_error: float
    """Root mean square of what commanded turns left over at the end of their control period [rad]."""
    non_safe_steps: int
    """Decisions taken in non-safe states."""
    episode_return: float
    """Sum of rewards, not discounted."""
    terms: dict[str, float]
    """Sum of each reward term."""
    overridden_steps: int = 0
    """Decisions that a shield took in its agent's place."""
    stop_steps: int = 0
    """Decisions to brake, to stand or to turn on the spot."""
    standing_time: float = 0.0
    """Time of control periods in which the vehicle did not get on [s]."""


STANDSTILL_DISTANCE = 0.05
"""A vehicle that gets less far than this in a control period stands [m]."""


class Tally:
    """Adds up the steps of n vehicles' present episodes."""

    def __init__(self, size: int) -> None:
        self._world_seed = np.zeros(size, np.int64)
        self._ending = np.full(size, NO_ENDING)
        self._steps, self._non_safe = np.zeros(size, np.int64), np.zeros(size, np.int64)
        self._overridden, self._stops, self._standing = (
            np.zeros(size, np.int64),
            np.zeros(size, np.int64),
            np.zeros(size),
        )
        self._duration, self._path_length, self._squared_errors = np.zeros(size), np.zeros(size), np.zeros(size)
        self._clearance, self._clearances = np.zeros(size), np.zeros(size)
        self._lateral_acceleration = np.zeros(size)
        self._terms = np.zeros((size, len(REWARD_TERMS)))

    @property
    def steps(self) -> NDArray[np.int64]:
        """Taken so far (n,)."""
        return self._steps

    @property
    def over(self) -> NDArray[np.bool_]:
        """Whose episodes have ended (n,)."""
        return np.asarray(self._ending != NO_ENDING)

    def reset(self, vehicle: int, world_seed: int) -> None:
        """A new episode of one vehicle."""
        self._world_seed[vehicle] = world_seed
        self._ending[vehicle] = NO_ENDING
        for sums in (
            *(self._steps, self._non_safe, self._duration, self._path_length, self._squared_errors),
            *(self._clearances, self._lateral_acceleration, self._terms),
            *(self._overridden, self._stops, self._standing),
        ):
            sums[vehicle] = 0
        self._clearance[vehicle] = np.inf

    def add(self, transitions: Transitions, overridden: NDArray[np.bool_] | None = None) -> None:
        """One step of those vehicles that took one.

        Args:
            transitions: Of n vehicles.
            overridden: Of which vehicles a shield took the decision (n,); of none if it is not given.
        """
        t, on = transitions, transitions.active
        if overridden is not None:
            self._overridden += on & overridden
        self._stops += on & (t.a_tm1 >= STOP)
        self._standing[on] += np.where(t.motions.path_length[on] < STANDSTILL_DISTANCE, t.motions.duration[on], 0.0)
        self._ending[on] = t.ending[on]
        self._steps += on
        self._non_safe += on & (t.s_tm1.state_property == StateProperty.NON_SAFE)
        self._duration[on] += t.motions.duration[on]
        self._path_length[on] += t.motions.path_length[on]
        self._squared_errors[on] += t.motions.heading_error[on] ** 2
        self._clearance[on] = np.minimum(self._clearance[on], t.motions.clearance[on])
        self._clearances[on] += t.motions.clearance[on]
        speed = t.motions.path_length[on] / t.motions.duration[on]
        lateral = np.abs(speed * t.motions.yaw_rate[on])
        self._lateral_acceleration[on] = np.maximum(self._lateral_acceleration[on], lateral)
        self._terms[on] += t.terms[on]

    def summary(self, vehicle: int) -> EpisodeSummary:
        """Of an episode that is over."""
        v, terms = vehicle, self._terms[vehicle].tolist()
        return EpisodeSummary(
            world_seed=int(self._world_seed[v]),
            ending=ENDINGS[self._ending[v]],
            steps=int(self._steps[v]),
            duration=float(self._duration[v]),
            path_length=float(self._path_length[v]),
            clearance=float(self._clearance[v]),
            mean_clearance=float(self._clearances[v] / self._steps[v]),
            lateral_acceleration=float(self._lateral_acceleration[v]),
            heading_error=float(np.sqrt(self._squared_errors[v] / self._steps[v])),
            non_safe_steps=int(self._non_safe[v]),
            episode_return=sum(terms),
            terms=dict(zip(REWARD_TERMS, terms, strict=True)),
            overridden_steps=int(self._overridden[v]),
            stop_steps=int(self._stops[v]),
            standing_time=float(self._standing[v]),
        )


class Watcher(Protocol):
    """Is shown everything that happens; a recording is one."""

    @property
    def trace(self) -> list[Sample] | None:
        """Where samples between decisions go, if they are wanted."""

    def on_reset(self, world: WorldSpec, observation: Observation) -> None:
        """The start of the episode."""

    def on_step(self, transition: Transition) -> None:
        """One step."""


def run_episode(
    navigation: Navigation, world: WorldSpec, policy: Policy, watcher: Watcher | None = None
) -> EpisodeSummary:
    """Drives one vehicle through one episode.

    Args:
        navigation: The environment.
        world: Where.
        policy: Chooses the actions.
        watcher: Is shown each step.
    """
    observation = navigation.reset(world)
    policy.reset(0, world.seed)
    if watcher:
        watcher.on_reset(world, observation)
    tally = Tally(1)
    tally.reset(0, world.seed)
    while not tally.over[0]:
        action = int(policy.act(stacked([observation]))[0])
        transition = navigation.step(action, watcher.trace if watcher else None)
        if watcher:
            watcher.on_step(transition)
        tally.add(_alone(transition), overridden(policy, 1))
        observation = transition.s_t
    return tally.summary(0)


def run_episodes(navigation: FleetNavigation, worlds: Sequence[WorldSpec], policy: Policy) -> list[EpisodeSummary]:
    """Drives an episode in each world, as many at a time as there are vehicles.

    Returns:
        What they came to, in the order of `worlds`.
    """
    summaries = dict(finished_episodes(navigation, worlds, policy))
    return [summaries[i] for i in range(len(worlds))]


def finished_episodes(
    navigation: FleetNavigation, worlds: Sequence[WorldSpec], policy: Policy
) -> Iterator[tuple[int, EpisodeSummary]]:
    """Drives an episode in each world, as many at a time as there are vehicles; they begin in the order of `worlds`.

    Yields:
        The place in `worlds` of each episode that finishes, and what it came to.
    """
    n = navigation.fleet.size
    tally, place = Tally(n), np.full(n, -1)
    waiting = iter(range(len(worlds)))
    while True:
        free = np.flatnonzero((place < 0) | tally.over).tolist()
        for vehicle in free:
            if place[vehicle] >= 0:
                yield int(place[vehicle]), tally.summary(vehicle)
            place[vehicle] = next(waiting, -1)
        begun = {vehicle: worlds[place[vehicle]] for vehicle in free if place[vehicle] >= 0}
        for vehicle, world in begun.items():
            tally.reset(vehicle, world.seed)
            policy.reset(vehicle, world.seed)
        navigation.reset(begun)
        active = place >= 0
        if not active.any():
            return
        actions = policy.act(navigation.observations)
        tally.add(navigation.step(actions, active), overridden(policy, n))


def _alone(t: Transition) -> Transitions:
    """A step of one vehicle as that of a fleet of one."""
    return Transitions(
        s_tm1=stacked([t.s_tm1]),
        a_tm1=np.array([t.a_tm1]),
        r_t=np.array([t.r_t]),
        discount_t=np.array([t.discount_t]),
        s_t=stacked([t.s_t]),
        terms=np.array([list(t.terms.values())]),
        ending=np.array([ENDINGS.index(t.ending) if t.ending else NO_ENDING]),
        motions=as_motions({0: t.motion}, 1),
        active=np.ones(1, np.bool_),
    )
