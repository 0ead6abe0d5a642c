"""What an agent is to those that run it: one that drives, one that was taught, one that learns step by step."""

from abc import ABC, abstractmethod
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import TOWARD_TARGET, Observation, Transition
from nnql_bullet.geometry import Array
from nnql_bullet.task import StateProperty


class Agent(Protocol):
    """Chooses among the environment's six actions for each of n vehicles. It is a `rollout.Policy`."""

    def reset(self, vehicle: int, world_seed: int) -> None:
        """A vehicle is put into a world: what was remembered of it is forgotten, and its chance begins anew."""

    def act(self, observations: Observation) -> NDArray[np.int64]:
        """The actions (n,) that the agent holds best for vehicles 0 to n - 1."""

    def action_values(self, observations: Observation) -> Array:
        """What it expects of the paper's five turns (n, 5); NaN where it did not ask itself."""


@runtime_checkable
class Overridable(Protocol):
    """An agent that remembers what it did, and can be told what was done in its place."""

    def override(self, actions: NDArray[np.int64]) -> None:
        """Vehicles 0 to n - 1 do this instead of what was last chosen for them: manoeuvres of `env` (n,)."""


@runtime_checkable
class Trainable(Agent, Protocol):
    """An agent that drives by what it was taught, however that came about."""

    def state_dict(self) -> dict[str, Array]:
        """Everything that learning changes, by name: what a checkpoint keeps."""

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Takes back what `state_dict` gave.

        Raises:
            UserError: If these are not arrays of such an agent.
        """


@runtime_checkable
class LearningAgent(Trainable, Protocol):
    """An agent that learns from every step, as Q-learning does."""

    def act_exploring(
        self, observations: Observation, episodes: NDArray[np.int64], uniforms: Array
    ) -> NDArray[np.int64]:
        """Actions (n,) for learning.

        Args:
            observations: Of n vehicles.
            episodes: Which training episode each is in (n,), counted from 0.
            uniforms: All the chance there is: a number in [0, 1) for each (n,).
        """

    def learn(self, transitions: Transition) -> Array:
        """Learns from one step of n vehicles, at once.

        Returns:
            Temporal-difference errors (n,); NaN where there was nothing to learn.
        """

    def diagnostics(self, episode: int) -> dict[str, float]:
        """Named numbers of a training episode for the log."""

    def training_state(self) -> dict[str, NDArray[Any]]:
        """What it needs beside `state_dict` to go on learning as if it had never stopped, by name."""

    def load_training_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Takes back what `under_way` gave.

        Raises:
            UserError: If it is not of such an agent.
        """


class NoTrainingState:
    """The part of a learner that needs nothing but what it has learned to go on."""

    def training_state(self) -> dict[str, NDArray[Any]]:
        """Nothing."""
        return {}

    def load_training_state(self, state: dict[str, NDArray[Any]]) -> None:
        """There is nothing to take back."""


class NoMemory:
    """The part of an agent that remembers nothing of a vehicle."""

    def reset(self, vehicle: int, world_seed: int) -> None:
        """There is nothing to forget."""


class Rule(NoMemory):
    """The parts that agents share which compare no values of turns, and by default remember nothing."""

    def action_values(self, observations: Observation) -> Array:
        """It has none: NaN (n, 5)."""
        return np.full((len(observations.state_property), len(paper.TURNS)), np.nan)


@runtime_checkable
class Decider(Protocol):
    """The least that an object needs to drive. It may have `reset` and `action_values` of `Agent` too."""

    def act(self, observations: Observation) -> NDArray[np.int64]:
        """Actions (n,) for vehicles 0 to n - 1, one of `paper.TURNS` or of the manoeuvres of `env` each."""


class Custom(Rule):
    """An object of somebody else as an agent."""

    def __init__(self, decider: Decider) -> None:
        self.decider = decider

    @property
    def name(self) -> str:
        """Name of the object's class."""
        return type(self.decider).__name__

    def reset(self, vehicle: int, world_seed: int) -> None:
        """Tells the object that a vehicle is put into a world, if it listens to that."""
        if hasattr(self.decider, "reset"):
            self.decider.reset(vehicle, world_seed)

    def act(self, observations: Observation) -> NDArray[np.int64]:
        """The object's actions (n,)."""
        return np.asarray(self.decider.act(observations), np.int64)

    def action_values(self, observations: Observation) -> Array:
        """The object's values of the five turns (n, 5); NaN if it has none."""
        if hasattr(self.decider, "action_values"):
            return np.asarray(self.decider.action_values(observations))
        return super().action_values(observations)


class TurnChooser(NoMemory, ABC):
    """The parts of an agent that values the paper's five turns, and is asked in non-safe states only (III.C)."""

    @abstractmethod
    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """Q(s, a) of the five turns (k, 5) for those k of n vehicles that are asked (n,)."""

    @staticmethod
    def asks(observations: Observation) -> NDArray[np.bool_]:
        """Which vehicles ask (n,)."""
        return np.asarray(observations.state_property != StateProperty.SAFE)

    def act(self, observations: Observation) -> NDArray[np.int64]:
        """Toward the target in a safe state, else the turn with the largest Q-value: eq. (4)."""
        actions = np.full(len(observations.state_property), TOWARD_TARGET)
        asked = self.asks(observations)
        if asked.any():
            actions[asked] = self.values(observations, asked).argmax(axis=-1)
        return actions

    def action_values(self, observations: Observation) -> Array:
        """Q(s, a) of the five turns (n, 5); NaN in safe states, where it is not asked."""
        values = np.full((len(observations.state_property), len(paper.TURNS)), np.nan)
        asked = self.asks(observations)
        values[asked] = self.values(observations, asked)
        return values
