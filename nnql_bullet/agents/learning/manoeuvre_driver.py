"""Drives by the values of manoeuvres that a network foresees, whatever finds the values."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nnql_bullet import paper
from nnql_bullet.agents.foresight import Foresight, Look, Memory
from nnql_bullet.agents.learning.options import DistilledOptions
from nnql_bullet.env import ACTIONS, MANOEUVRES, Observation
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

MANNERS = MANOEUVRES // ACTIONS
"""Ways to carry out an action, of which the network is told one."""


@dataclass(frozen=True, slots=True)
class DistilledState:
    """Memory of n vehicles, and what the last manoeuvres were chosen by."""

    memory: Memory
    last: tuple[Look, Observation] | None = None
    values: Array | None = None
    """What the network said of the manoeuvres (n, 24) [m]; None where it was not asked."""
    scores: Array | None = None
    """What the search said of the manoeuvres (n, 24) [m]; None where it was not asked."""


class ManoeuvreDriver(ABC):
    """The part of a `distilled` that drives: a policy with a memory, which can be told of other manoeuvres."""

    def __init__(self, options: DistilledOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._foresight = Foresight(vehicle, drive)

    @abstractmethod
    def values(self, look: Look) -> Array:
        """What the network says of the manoeuvres (n, 24) [m]."""

    def initial_state(self, size: int) -> DistilledState:
        """Returns an empty memory of n vehicles."""
        return DistilledState(self._foresight.nothing(size))

    def reset(self, state: DistilledState, world_seeds: Mapping[int, int]) -> DistilledState:
        """Forgets these vehicles."""
        age = state.memory.age.copy()
        age[list(world_seeds)] = 0
        return replace(state, memory=replace(state.memory, age=age))

    def act(self, observations: Observation, state: DistilledState) -> tuple[Actions, DistilledState]:
        """Chooses the manoeuvre with the largest value of those that are foreseen to meet nothing."""
        look = self._look(observations, state)
        values = self.values(look)
        actions = self._chosen(look, values)
        return actions, replace(self._after(look, observations, actions), values=values)

    def override(self, state: DistilledState, actions: Actions) -> DistilledState:
        """Returns the state after these manoeuvres in place of those last chosen."""
        return replace(self._after(*state.last, actions), values=state.values) if state.last else state

    def action_values(self, observations: Observation, state: DistilledState) -> Array:
        """Values of the five turns at full speed less that of the best manoeuvre (n, 5) [m].

        The network knows values but for a constant: it learns from differences.
        """
        return _of_turns(self.values(self._look(observations, state)))

    def values_of(self, state: DistilledState) -> Array:
        """Returns `action_values` of the last decision, which `act` has made (n, 5) [m].

        Raises:
            ValueError: If there was none.
        """
        if state.values is None:
            raise ValueError("values_of needs the state that act returned")
        return _of_turns(state.values)

    def _look(self, observations: Observation, state: DistilledState) -> Look:
        look = self._foresight.look(state.memory, observations, self.options.search.paced)
        return self._foresight.ahead(look, observations)

    def _chosen(self, look: Look, values: Array) -> Actions:
        return self._foresight.chosen(look, values, self.options.search.margin)

    def _after(self, look: Look, observations: Observation, actions: Actions) -> DistilledState:
        return DistilledState(self._foresight.after(look, observations, actions), (look, observations))


def _of_turns(values: Array) -> Array:
    """The values (n, 24) of the five turns, less the largest (n, 5)."""
    return np.asarray(values[:, : len(paper.TURNS)] - values.max(axis=-1, keepdims=True))
