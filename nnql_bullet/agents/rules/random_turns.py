"""Turns by chance where something is near: what a rule has to be better than to have understood anything."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import Rule
from nnql_bullet.config import options
from nnql_bullet.env import TOWARD_TARGET, Observation
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.task import StateProperty
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec


@options
class RandomTurnsOptions:
    """It has no options."""

    kind: Literal["random"] = "random"

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "RandomTurns":
        """Builds the agent."""
        return RandomTurns()


class RandomTurns(Rule):
    """Toward the target in a safe state, else one of the paper's five turns, each as likely.

    It sees the state property, that is the eight readings against the task's thresholds. It remembers where the chance
    of each drive has come to, which is a function of the world's seed.
    """

    def __init__(self) -> None:
        self._chance: dict[int, np.random.Generator] = {}

    def reset(self, vehicle: int, world_seed: int) -> None:
        """The chance of this drive."""
        self._chance[vehicle] = rng(world_seed, Stream.CHANCE)

    def act(self, observations: Observation) -> NDArray[np.int64]:
        """Toward the target, or any turn."""
        actions = np.full(len(observations.state_property), TOWARD_TARGET)
        for vehicle in np.flatnonzero(observations.state_property != StateProperty.SAFE).tolist():
            actions[vehicle] = self._chance[vehicle].integers(len(paper.TURNS))
        return actions
