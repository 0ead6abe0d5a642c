"""The parts that agents share."""

from abc import ABC, abstractmethod
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import TOWARD_TARGET, Observation
from nnql_bullet.geometry import Array
from nnql_bullet.task import StateProperty


@runtime_checkable
class Overridable(Protocol):
    """An agent that remembers what it did, and can be told what was done in its place."""

    def override(self, actions: NDArray[np.int64]) -> None:
        """Vehicles 0 to n - 1 do this instead of what was last chosen for them: manoeuvres of `env` (n,)."""


class NoTrainingState:
    """The part of a learning agent whose training resumes from its `state_dict` alone."""

    def training_state(self) -> dict[str, NDArray[Any]]:
        """Nothing."""
        return {}

    def load_training_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Does nothing."""


class NoMemory:
    """The part of an agent without memory of vehicles."""

    def reset(self, vehicle: int, world_seed: int) -> None:
        """Does nothing."""


class Rule(NoMemory):
    """The parts of an agent that computes no action values; without memory unless it defines `reset`."""

    def action_values(self, observations: Observation) -> Array:
        """NaN (n, 5): it computes none."""
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
