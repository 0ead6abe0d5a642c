"""A search over several manoeuvres in a row, led by a map of what was seen: planning with the vehicle's own model.

Without learning, and the teacher of `distilled`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from nnql_bullet.agents.base import NoValues
from nnql_bullet.agents.foresight import Foresight, Look, Memory, SearchOptions
from nnql_bullet.config import options
from nnql_bullet.env import Observation
from nnql_bullet.rollout import Actions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec


@options
class GuidedSearchOptions(SearchOptions):
    """Options of the search."""

    kind: Literal["guided_search"] = "guided_search"

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "GuidedSearch":
        """Builds the agent."""
        return GuidedSearch(self, vehicle, drive)


@dataclass(frozen=True, slots=True)
class GuidedState:
    """Memory of n vehicles, and what the last actions were chosen by."""

    memory: Memory
    last: tuple[Look, Observation] | None = None
    actions: Actions | None = None
    """Those last chosen (n,)."""
    then: Actions | None = None
    """What was planned to follow them (n,)."""


class GuidedSearch(NoValues):
    """Keeps a map, drives several manoeuvres in a row in thought, and takes the first of the best."""

    def __init__(self, options: SearchOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._foresight = Foresight(vehicle, drive)

    def initial_state(self, size: int) -> GuidedState:
        """Returns an empty memory of n vehicles."""
        return GuidedState(self._foresight.nothing(size))

    def reset(self, state: GuidedState, world_seeds: Mapping[int, int]) -> GuidedState:
        """Forgets these vehicles."""
        age = state.memory.age.copy()
        age[list(world_seeds)] = 0
        return replace(state, memory=replace(state.memory, age=age))

    def act(self, observations: Observation, state: GuidedState) -> tuple[Actions, GuidedState]:
        """Chooses the manoeuvre with the best score."""
        look = self._foresight.look(state.memory, observations, self.options.paced)
        scores, then = self._foresight.searched(look, observations, self.options)
        actions = np.asarray(scores.argmax(axis=-1))
        memory = self._foresight.after(look, observations, actions, then)
        return actions, GuidedState(memory, (look, observations), actions, then)

    def override(self, state: GuidedState, actions: Actions) -> GuidedState:
        """Returns the state after these actions in place of those last chosen; plans for others are dropped."""
        if state.last is None or state.then is None:
            return state
        then = np.where(actions == state.actions, state.then, -1)
        return replace(state, memory=self._foresight.after(*state.last, actions, then))
