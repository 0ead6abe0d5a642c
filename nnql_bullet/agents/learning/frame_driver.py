"""Drives by frames: the action of the largest Q-value, whatever network finds the values."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nnql_bullet import paper
from nnql_bullet.agents.learning.frames import FrameMaker, Look, Memory
from nnql_bullet.agents.learning.options import DoubleDqnOptions
from nnql_bullet.env import Observation
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec


@dataclass(frozen=True, slots=True)
class Choice:
    """A decision for n vehicles."""

    look: Look
    observations: Observation
    actions: Actions
    """(n,)"""
    values: Array | None = None
    """Q-values that they were chosen by (n, 6); None if by others."""


@dataclass(frozen=True, slots=True)
class FrameState:
    """Memory of n vehicles."""

    memory: Memory
    """Memory at the next decision."""
    last: Choice | None = None
    """The last decision; None before the first."""


class FrameDriver(ABC):
    """The part of a `double_dqn` that drives: a policy with a memory, which can be told of other actions."""

    def __init__(self, options: DoubleDqnOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._frames = FrameMaker(options.rays, options.frames, options.grid_map, vehicle, drive)

    @abstractmethod
    def values(self, look: Look) -> Array:
        """Q(s, a) of the six actions (n, 6)."""

    def initial_state(self, size: int) -> FrameState:
        """Returns an empty memory of n vehicles."""
        return FrameState(self._frames.nothing(size))

    def reset(self, state: FrameState, world_seeds: Mapping[int, int]) -> FrameState:
        """Forgets these vehicles."""
        age = state.memory.age.copy()
        age[list(world_seeds)] = 0
        return replace(state, memory=replace(state.memory, age=age))

    def act(self, observations: Observation, state: FrameState) -> tuple[Actions, FrameState]:
        """Chooses the action with the largest Q-value."""
        look = self._frames.look(state.memory, observations)
        values = self.values(look)
        actions = np.asarray(values.argmax(axis=-1))
        return actions, self._after(Choice(look, observations, actions, values))

    def override(self, state: FrameState, actions: Actions) -> FrameState:
        """Returns the state after these actions in place of those last chosen."""
        if state.last is None or np.array_equal(actions, state.last.actions):
            return state
        return self._after(replace(state.last, actions=np.array(actions)))

    def action_values(self, observations: Observation, state: FrameState) -> Array:
        """Q(s, a) of the five turns (n, 5), the turn toward the target left out."""
        return self.values(self._frames.look(state.memory, observations))[:, : len(paper.TURNS)]

    def values_of(self, state: FrameState) -> Array:
        """Q(s, a) of the six actions (n, 6), by which the last actions were chosen.

        Raises:
            ValueError: If there were none.
        """
        if state.last is None:
            raise ValueError("values_of needs the state that act returned")
        return self.values(state.last.look) if state.last.values is None else state.last.values

    def _after(self, choice: Choice) -> FrameState:
        """Returns the state after a decision."""
        return FrameState(self._frames.after(choice.look, choice.observations, choice.actions), choice)
