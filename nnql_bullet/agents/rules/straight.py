"""Straight at the target, whatever stands there: what every other agent has to be better than."""

from typing import Literal

import numpy as np

from nnql_bullet.agents.base import Rule
from nnql_bullet.config import options
from nnql_bullet.env import TOWARD_TARGET, Observation
from nnql_bullet.rollout import Actions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec


@options
class StraightOptions:
    """It has no options."""

    kind: Literal["straight"] = "straight"

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Straight":
        """Builds the agent."""
        return Straight()


class Straight(Rule):
    """Turns toward the target at every step (the paper's III.C, in safe and non-safe states alike).

    It sees the target's bearing alone, and remembers nothing.
    """

    def decide(self, observations: Observation) -> Actions:
        """Toward the target."""
        return np.full(len(observations.state_property), TOWARD_TARGET)
