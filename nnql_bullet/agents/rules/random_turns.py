"""Turns by chance where something is near: what a rule has to be better than to have understood anything."""

from collections.abc import Mapping
from typing import Literal, TypeAlias

import numpy as np

from nnql_bullet import paper
from nnql_bullet.agents.base import NoValues
from nnql_bullet.config import options
from nnql_bullet.env import TOWARD_TARGET, Observation
from nnql_bullet.rollout import Actions
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.task import StateProperty
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

Generators: TypeAlias = dict[int, np.random.Generator]
"""Random generator of each vehicle's drive."""


@options
class RandomTurnsOptions:
    """It has no options."""

    kind: Literal["random"] = "random"

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "RandomTurns":
        """Builds the agent."""
        return RandomTurns()


class RandomTurns(NoValues):
    """Toward the target in a safe state, else one of the paper's five turns, each as likely.

    It sees the state property, that is the eight readings against the task's thresholds. It remembers where the chance
    of each drive has come to, which is a function of the world's seed.
    """

    def initial_state(self, size: int) -> Generators:
        """Returns no generators yet."""
        return {}

    def reset(self, state: Generators, world_seeds: Mapping[int, int]) -> Generators:
        """Seeds the generators of these vehicles by their worlds."""
        return state | {vehicle: rng(seed, Stream.CHANCE) for vehicle, seed in world_seeds.items()}

    def act(self, observations: Observation, state: Generators) -> tuple[Actions, Generators]:
        """Chooses the turn toward the target in a safe state, else any of the five; the generators advance."""
        actions = np.full(len(observations.state_property), TOWARD_TARGET)
        for vehicle in np.flatnonzero(observations.state_property != StateProperty.SAFE).tolist():
            actions[vehicle] = state[vehicle].integers(len(paper.TURNS))
        return actions, state
