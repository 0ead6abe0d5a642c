"""Drives episodes with a policy, sums them up, and shows them to watchers."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import REVERSE, SLOW, STOP, Navigation, Observation, Transition
from nnql_bullet.geometry import Array
from nnql_bullet.sim.base import Sample
from nnql_bullet.task import ENDINGS, NO_ENDING, StateProperty
from nnql_bullet.worlds.spec import WorldSpec

PolicyState: TypeAlias = Any
"""What a policy remembers of n vehicles; None if it has no memory. Only the policy itself looks inside."""
Actions: TypeAlias = NDArray[np.int64]
"""A manoeuvre of each vehicle (n,): a number below `env.MANOEUVRES`."""


@runtime_checkable
class Policy(Protocol):
    """Decides for n vehicles. Every agent is a policy, and so is an agent in a shield.

    A policy changes nothing of itself when it drives: its memory of the vehicles is the state, which the caller keeps.
    A state is used once; the caller goes on with the state that it got back.
    """

    def initial_state(self, size: int) -> PolicyState:
        """Returns the state of n vehicles that have seen nothing."""

    def reset(self, state: PolicyState, world_seeds: Mapping[int, int]) -> PolicyState:
        """Forgets vehicles that are put into worlds, and restarts their random numbers.

        Args:
            state: The state so far.
            world_seeds: Seed of the world of each of these vehicles.
        """

    def act(self, observations: Observation, state: PolicyState) -> tuple[Actions, PolicyState]:
        """Returns the best actions (n,), as the policy judges them, and the next state."""

    def action_values(self, observations: Observation, state: PolicyState) -> Array:
        """Returns values of the five turns (n, 5); NaN where they are not computed, for example by a rule."""


@runtime_checkable
class Overriding(Protocol):
    """A policy that may replace the decisions of its agent, as a shield does."""

    def overridden(self, state: PolicyState) -> NDArray[np.bool_]:
        """Returns whether it replaced the last decision for each vehicle (n,)."""


@dataclass(frozen=True, slots=True)
class Decision:
    """One decision of a policy for n vehicles."""

    actions: Actions
    """(n,)"""
    overridden: NDArray[np.bool_]
    """Whether a shield replaced the agent's decision (n,)."""
    action_values: Array | None
    """Values of the five turns before the decision (n, 5), or None if no watcher sees them."""


def decide(
    policy: Policy, observations: Observation, state: PolicyState, with_values: bool = False
) -> tuple[Decision, PolicyState]:
    """Lets a policy decide.

    Args:
        policy: The policy.
        observations: What n vehicles see.
        state: The policy's state.
        with_values: Whether to compute the action values too.

    Returns:
        The decision and the policy's next state.
    """
    values = policy.action_values(observations, state) if with_values else None
    actions, state = policy.act(observations, state)
    overridden = policy.overridden(state) if isinstance(policy, Overriding) else np.zeros(len(actions), np.bool_)
    return Decision(actions, overridden, values), state


@dataclass(frozen=True, slots=True)
class EpisodeSummary:
    """The result of an episode."""

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
    """Largest lateral acceleration at the end of a control period [m/s2]."""
    heading_error: float
    """Root mean square of the heading errors at the end of each control period [rad]."""
    non_safe_steps: int
    """Number of decisions in non-safe states."""
    episode_return: float
    """Undiscounted sum of rewards."""
    terms: dict[str, float]
    """Sum of each reward term."""
    overridden_steps: int = 0
    """Number of decisions that a shield replaced."""
    stop_steps: int = 0
    """Number of decisions to brake, to stand or to turn on the spot."""
    standing_time: float = 0.0
    """Time of the control periods in which the vehicle stood [s]."""
    reverse_steps: int = 0
    """Number of decisions to drive backwards."""
    waypoint_times: tuple[float, ...] = ()
    """Times at which way points were reached, in turn; the last target is none of them [s]."""


STANDSTILL_DISTANCE = 0.05
"""A vehicle whose path in a control period is shorter than this stands [m]."""


class Tally:
    """Adds up the steps of the present episodes of the vehicles of an environment."""

    def __init__(self, navigation: Navigation) -> None:
        size = navigation.simulator.size
        self._world_seed = np.zeros(size, np.int64)
        self._ending = np.full(size, NO_ENDING)
        self._steps, self._non_safe = np.zeros(size, np.int64), np.zeros(size, np.int64)
        self._overridden, self._stops, self._reverses = np.zeros((3, size), np.int64)
        self._standing = np.zeros(size)
        self._duration, self._path_length, self._squared_errors = np.zeros(size), np.zeros(size), np.zeros(size)
        self._clearance, self._clearances = np.zeros(size), np.zeros(size)
        self._lateral_acceleration = np.zeros(size)
        self._waypoint_times: list[tuple[float, ...]] = [()] * size
        self._term_names = navigation.term_names
        self._terms = np.zeros((size, len(self._term_names)))

    @property
    def steps(self) -> NDArray[np.int64]:
        """Number of steps so far (n,)."""
        return self._steps

    @property
    def over(self) -> NDArray[np.bool_]:
        """Whether the episode has ended (n,)."""
        return np.asarray(self._ending != NO_ENDING)

    def reset(self, vehicle: int, world_seed: int) -> None:
        """Starts a new episode of one vehicle."""
        self._world_seed[vehicle] = world_seed
        self._ending[vehicle] = NO_ENDING
        for sums in (
            *(self._steps, self._non_safe, self._duration, self._path_length, self._squared_errors),
            *(self._clearances, self._lateral_acceleration, self._terms),
            *(self._overridden, self._stops, self._reverses, self._standing),
        ):
            sums[vehicle] = 0
        self._clearance[vehicle] = np.inf
        self._waypoint_times[vehicle] = ()

    def add(self, transition: Transition, overridden: NDArray[np.bool_] | None = None) -> None:
        """Adds a step of the vehicles that took one.

        Args:
            transition: The step.
            overridden: Whether a shield replaced the decision (n,), never by default.
        """
        t, m, on = transition, transition.motion, transition.active
        if overridden is not None:
            self._overridden += on & overridden
        self._stops += on & (t.a_tm1 >= STOP) & (t.a_tm1 < REVERSE)
        self._reverses += on & (t.a_tm1 >= REVERSE) & (t.a_tm1 < SLOW)
        self._standing[on] += np.where(m.path_length[on] < STANDSTILL_DISTANCE, m.duration[on], 0.0)
        self._ending[on] = t.ending[on]
        self._steps += on
        self._non_safe += on & (t.s_tm1.state_property == StateProperty.NON_SAFE)
        self._duration[on] += m.duration[on]
        self._path_length[on] += m.path_length[on]
        self._squared_errors[on] += m.heading_error[on] ** 2
        self._clearance[on] = np.minimum(self._clearance[on], m.clearance[on])
        self._clearances[on] += m.clearance[on]
        lateral = np.abs(m.path_length[on] / m.duration[on] * m.yaw_rate[on])
        self._lateral_acceleration[on] = np.maximum(self._lateral_acceleration[on], lateral)
        self._terms[on] += t.terms[on]
        for vehicle in t.at_waypoint:
            self._waypoint_times[vehicle] += (float(self._duration[vehicle]),)

    def summary(self, vehicle: int) -> EpisodeSummary:
        """The result of a vehicle's episode, which is over."""
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
            terms=dict(zip(self._term_names, terms, strict=True)),
            overridden_steps=int(self._overridden[v]),
            stop_steps=int(self._stops[v]),
            standing_time=float(self._standing[v]),
            reverse_steps=int(self._reverses[v]),
            waypoint_times=self._waypoint_times[v],
        )


class Watcher(Protocol):
    """Is shown an episode step by step; a recorder is one."""

    @property
    def trace(self) -> list[Sample] | None:
        """The list that receives samples between decisions, if they are wanted."""

    def on_reset(self, world: WorldSpec, observation: Observation, vehicle: int) -> None:
        """Is shown the start of the episode: the observation of n vehicles, and which of them it is about."""

    def on_step(self, transition: Transition, decision: Decision, vehicle: int) -> None:
        """Is shown a step of n vehicles, the decision that led to it, and which vehicle it is about."""


def run_episode(
    navigation: Navigation, world: WorldSpec, policy: Policy, watcher: Watcher | None = None
) -> EpisodeSummary:
    """Drives one episode.

    Args:
        navigation: The environment.
        world: The world of the episode.
        policy: Chooses the actions.
        watcher: Is shown the episode.
    """
    ((_, summary),) = finished_episodes(navigation, [world], policy, {0: watcher} if watcher else {})
    return summary


def run_episodes(navigation: Navigation, worlds: Sequence[WorldSpec], policy: Policy) -> list[EpisodeSummary]:
    """Drives an episode in each world, as many at a time as there are vehicles.

    Returns:
        The results, in the order of `worlds`.
    """
    summaries = dict(finished_episodes(navigation, worlds, policy))
    return [summaries[i] for i in range(len(worlds))]


def finished_episodes(
    navigation: Navigation,
    worlds: Sequence[WorldSpec],
    policy: Policy,
    watchers: Mapping[int, Watcher] | None = None,
) -> Iterator[tuple[int, EpisodeSummary]]:
    """Drives an episode in each world, as many at a time as there are vehicles; they start in the order of `worlds`.

    Args:
        navigation: The environment.
        worlds: The worlds of the episodes.
        policy: Chooses the actions.
        watchers: Are shown episodes, by their place in `worlds`.

    Yields:
        The place in `worlds` of each episode that finishes, and its result.
    """
    n, watchers = navigation.simulator.size, watchers or {}
    tally, place, state = Tally(navigation), np.full(n, -1), policy.initial_state(n)
    watched: dict[int, Watcher] = {}
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
        state = policy.reset(state, {vehicle: world.seed for vehicle, world in begun.items()})
        navigation.reset(begun)
        active = place >= 0
        if not active.any():
            return
        if watchers:
            watched = {vehicle: watchers[p] for vehicle, p in enumerate(place.tolist()) if p in watchers}
            for vehicle, world in begun.items():
                if vehicle in watched:
                    watched[vehicle].on_reset(world, navigation.observation, vehicle)
        traces = {vehicle: watcher.trace for vehicle, watcher in watched.items() if watcher.trace is not None}
        decision, state = decide(policy, navigation.observation, state, with_values=bool(watched))
        transition = navigation.step(decision.actions, None if active.all() else active, traces)
        for vehicle, watcher in watched.items():
            watcher.on_step(transition, decision, vehicle)
        tally.add(transition, decision.overridden)
