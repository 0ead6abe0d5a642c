"""One episode, whoever drives and whoever watches: training and navigation both run through here."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, sqrt
from typing import Protocol

from nnql_bullet.env import Navigation, Observation, Transition
from nnql_bullet.sensing import Scan
from nnql_bullet.sim.base import Sample
from nnql_bullet.task import REWARD_TERMS, Ending, Property
from nnql_bullet.worlds.spec import WorldSpec

Policy = Callable[[Observation], int]


@dataclass(frozen=True, slots=True)
class EpisodeSummary:
    """What an episode came to."""

    world_seed: int
    ending: Ending
    steps: int
    duration: float
    """[s]"""
    path_length: float
    """[m]"""
    clearance: float
    """Smallest distance to an obstacle or wall [m]."""
    heading_error: float
    """Root mean square of what commanded turns left over at the end of their control period [rad]."""
    non_safe_steps: int
    """Decisions taken in non-safe states."""
    episode_return: float
    """Sum of rewards, not discounted."""
    terms: dict[str, float]
    """Sum of each reward term."""


class Watcher(Protocol):
    """Is shown everything that happens; a recording is one."""

    @property
    def trace(self) -> list[Sample] | None:
        """Where samples between decisions go, if they are wanted."""

    def begin(self, world: WorldSpec, observation: Observation, scan: Scan) -> None:
        """The start of the episode."""

    def see(self, transition: Transition) -> None:
        """One step."""


def run_episode(
    navigation: Navigation,
    world: WorldSpec,
    policy: Policy,
    learn: Callable[[Transition], object] | None = None,
    watcher: Watcher | None = None,
) -> EpisodeSummary:
    """Drives one episode to its end.

    Args:
        navigation: The environment.
        world: Where.
        policy: Chooses the action.
        learn: Is given each transition before the next action is chosen.
        watcher: Is shown each transition too.
    """
    observation, scan = navigation.reset(world)
    if watcher:
        watcher.begin(world, observation, scan)
    steps = non_safe_steps = 0
    duration = path_length = squared_errors = 0.0
    clearance = inf
    terms = dict.fromkeys(REWARD_TERMS, 0.0)
    while True:
        transition = navigation.step(policy(observation), watcher.trace if watcher else None)
        if learn:
            learn(transition)
        if watcher:
            watcher.see(transition)
        motion, observation = transition.motion, transition.s_t
        steps += 1
        non_safe_steps += transition.s_tm1.property is Property.NON_SAFE
        duration += motion.duration
        path_length += motion.path_length
        squared_errors += motion.heading_error**2
        clearance = min(clearance, motion.clearance)
        for name, value in transition.terms.items():
            terms[name] += value
        if transition.ending:
            return EpisodeSummary(
                world_seed=world.seed,
                ending=transition.ending,
                steps=steps,
                duration=duration,
                path_length=path_length,
                clearance=clearance,
                heading_error=sqrt(squared_errors / steps),
                non_safe_steps=non_safe_steps,
                episode_return=sum(terms.values()),
                terms=terms,
            )
