"""The parts that agents share."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import TOWARD_TARGET, Observation, as_actions
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions, Policy, PolicyState
from nnql_bullet.task import StateProperty


@runtime_checkable
class Overridable(Policy, Protocol):
    """A policy that remembers its actions, and can remember others in their place."""

    def override(self, state: PolicyState, actions: Actions) -> PolicyState:
        """Returns the state after `actions` (n,), manoeuvres of `env`, in place of the actions last chosen."""


@runtime_checkable
class Knowing(Policy, Protocol):
    """A policy that can tell what it last decided by, at less cost than to find it again."""

    def values_of(self, state: PolicyState) -> Array:
        """Returns the values by which the last actions were chosen, those of the five turns first (n, 5 or more)."""


class NoMemory:
    """The part of an agent without memory of vehicles: its state is None."""

    def initial_state(self, size: int) -> None:
        """Returns None."""

    def reset(self, state: None, world_seeds: Mapping[int, int]) -> None:
        """Returns None."""


class NoTrainingState(NoMemory):
    """The part of a learning agent without memory whose training resumes from its `state_dict` alone."""

    def training_state(self, state: None) -> dict[str, NDArray[Any]]:
        """Returns no arrays."""
        return {}

    def load_training_state(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Does nothing."""


class NoValues:
    """The part of an agent that computes no action values."""

    def action_values(self, observations: Observation, state: PolicyState) -> Array:
        """Returns NaN (n, 5)."""
        return np.full((len(observations.state_property), len(paper.TURNS)), np.nan)


class Rule(NoMemory, NoValues, ABC):
    """An agent without memory and without action values."""

    @abstractmethod
    def decide(self, observations: Observation) -> Actions:
        """Returns the actions (n,)."""

    def act(self, observations: Observation, state: None) -> tuple[Actions, None]:
        """Returns the actions (n,) and no state."""
        return self.decide(observations), None


class Reflex(Rule):
    """A function of the observation as an agent."""

    def __init__(self, function: Callable[[Observation], Actions]) -> None:
        """Takes a function that gives actions (n,) for an observation of n vehicles."""
        self._function = function

    def decide(self, observations: Observation) -> Actions:
        """Returns the actions that the function gives."""
        return self._function(observations)


@runtime_checkable
class Decider(Protocol):
    """The least that an object without memory needs to drive."""

    def act(self, observations: Observation) -> Actions:
        """Returns an action (n,) for each of n vehicles: one of `paper.TURNS`, or `env.TOWARD_TARGET`."""


class Custom:
    """An object of the caller as an agent: a `Policy`, or a `Decider`, which has no memory."""

    def __init__(self, given: Policy | Decider) -> None:
        self.given = given
        self._policy: Policy = given if isinstance(given, Policy) else Reflex(given.act)

    @property
    def name(self) -> str:
        """Name of the object's class."""
        return type(self.given).__name__

    def initial_state(self, size: int) -> PolicyState:
        """Returns the object's state of n vehicles that have seen nothing."""
        return self._policy.initial_state(size)

    def reset(self, state: PolicyState, world_seeds: Mapping[int, int]) -> PolicyState:
        """Lets the object forget vehicles that are put into worlds."""
        return self._policy.reset(state, world_seeds)

    def act(self, observations: Observation, state: PolicyState) -> tuple[Actions, PolicyState]:
        """Returns the object's actions (n,) and its next state."""
        actions, state = self._policy.act(observations, state)
        return as_actions(actions, len(observations.readings)), state

    def action_values(self, observations: Observation, state: PolicyState) -> Array:
        """Returns the object's values of the five turns (n, 5); NaN if it has none."""
        return np.asarray(self._policy.action_values(observations, state))


class TurnChooser(NoMemory, ABC):
    """The parts of an agent that values the paper's five turns, and is asked in non-safe states only (III.C)."""

    @abstractmethod
    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """Q(s, a) of the five turns (k, 5) for those k of n vehicles that are asked (n,)."""

    @staticmethod
    def asks(observations: Observation) -> NDArray[np.bool_]:
        """Which vehicles ask (n,)."""
        return np.asarray(observations.state_property != StateProperty.SAFE)

    def act(self, observations: Observation, state: None) -> tuple[Actions, None]:
        """Chooses the turn toward the target in a safe state, else the turn with the largest Q-value: eq. (4)."""
        actions = np.full(len(observations.state_property), TOWARD_TARGET)
        asked = self.asks(observations)
        if asked.any():
            actions[asked] = self.values(observations, asked).argmax(axis=-1)
        return actions, None

    def action_values(self, observations: Observation, state: PolicyState) -> Array:
        """Q(s, a) of the five turns (n, 5); NaN in safe states, where it is not asked."""
        values = np.full((len(observations.state_property), len(paper.TURNS)), np.nan)
        asked = self.asks(observations)
        values[asked] = self.values(observations, asked)
        return values
