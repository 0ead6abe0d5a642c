"""Interfaces of training: agents that can be trained, and what trains them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import Navigation, Observation, Transition
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions, EpisodeSummary, Policy, PolicyState
from nnql_bullet.worlds.spec import WorldSpec

RECENT = 100
"""Episodes at the end of a training over which its success is shown."""


@dataclass(frozen=True, slots=True)
class TrainingEpisode:
    """One finished training episode."""

    episode: int
    """Counted from 0, in the order in which they began."""
    summary: EpisodeSummary
    diagnostics: dict[str, float]
    """Named numbers for the log."""


class Trainer(Protocol):
    """A training in progress. Its result depends on the configuration and the seed alone."""

    def episodes(self) -> Iterator[TrainingEpisode]:
        """Trains without end, and yields each episode as it finishes; `state_dict` may be asked for in between.

        Raises:
            WorkerDied: If a process that simulates vehicles is gone; `state_dict` then gives a state to resume from.
        """

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies the state of the training, without that of the agent, by name."""

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Resumes from what `state_dict` gave, with the same results as a training that never stopped.

        Raises:
            UserError: If these are not the arrays of such a training.
        """


@runtime_checkable
class Trainable(Policy, Protocol):
    """An agent with weights, however they are found."""

    def state_dict(self) -> dict[str, Array]:
        """Copies everything that learning changes, by name: what a checkpoint keeps."""

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Replaces all that by what `state_dict` gave.

        Raises:
            UserError: If these are not arrays of such an agent.
        """


@runtime_checkable
class TrainsItself(Trainable, Protocol):
    """An agent with a training of its own, in place of `training.loop`."""

    def make_trainer(self, navigation: Navigation, world_of: Callable[[int], WorldSpec], seed: int) -> Trainer:
        """Builds what trains the agent.

        Args:
            navigation: The vehicles to train with.
            world_of: Gives the world of a training episode, counted from 0.
            seed: Seed of all random numbers.

        Raises:
            UserError: If the training needs a library that is not installed.
        """


@runtime_checkable
class LearningAgent(Trainable, Protocol):
    """An agent that learns from every step, as Q-learning does; `training.loop` trains it."""

    def act_exploring(
        self, observations: Observation, state: PolicyState, episodes: NDArray[np.int64], uniforms: Array
    ) -> tuple[Actions, PolicyState]:
        """Chooses actions for learning.

        Args:
            observations: What n vehicles see.
            state: The agent's memory of the vehicles.
            episodes: Training episode of each vehicle (n,), counted from 0.
            uniforms: A random number in [0, 1) for each vehicle (n,), the only randomness.

        Returns:
            The actions (n,) and the next state.
        """

    def learn(self, transitions: Transition, state: PolicyState, episodes: NDArray[np.int64]) -> Array:
        """Learns from one step of all n vehicles at once.

        Args:
            transitions: The step.
            state: The state that `act_exploring` returned with the actions of the step.
            episodes: Training episode of each vehicle (n,), counted from 0.

        Returns:
            Temporal-difference errors (n,); NaN where nothing was learned.
        """

    def diagnostics(self, episode: int) -> dict[str, float]:
        """Named numbers of a training episode for the log."""

    def training_state(self, state: PolicyState) -> dict[str, NDArray[Any]]:
        """Copies what resumed learning needs beside `state_dict`, the memory of vehicles too, by name."""

    def load_training_state(self, arrays: dict[str, NDArray[Any]]) -> PolicyState:
        """Replaces all that by what `training_state` gave, and returns the memory of vehicles.

        Raises:
            UserError: If it is not the state of such an agent.
        """
