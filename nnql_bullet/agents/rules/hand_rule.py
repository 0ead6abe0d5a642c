"""The one rule that somebody would write down after watching a few drives."""

from math import radians
from typing import Literal

import numpy as np

from nnql_bullet.agents.base import Rule
from nnql_bullet.agents.turns import nearest_turns
from nnql_bullet.config import options
from nnql_bullet.env import TOWARD_TARGET, Observation
from nnql_bullet.rollout import Actions
from nnql_bullet.sensing import FRONT_LEFT, FRONT_RIGHT
from nnql_bullet.task import StateProperty
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec


@options
class HandRuleOptions:
    """Options of the turn."""

    kind: Literal["hand_rule"] = "hand_rule"
    turn_degrees: Literal[30, 60] = 30
    """Turn away from the front side with the nearer obstacle [degrees]."""

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "HandRule":
        """Builds the agent."""
        return HandRule(self)


class HandRule(Rule):
    """In a non-safe state away from the fuller front side, else toward the target.

    It sees the two front sides of the eight readings and the state property, and remembers nothing.
    """

    def __init__(self, options: HandRuleOptions) -> None:
        angle = radians(options.turn_degrees)
        self._left, self._right = nearest_turns(np.array([angle, -angle])).tolist()

    def decide(self, observations: Observation) -> Actions:
        """Toward the target, or away; where both sides are as full, to the target's side."""
        o = observations
        left, right = o.readings[:, FRONT_LEFT], o.readings[:, FRONT_RIGHT]
        to_left = (left > right) | ((left == right) & (o.target_bearing >= 0))
        away = np.where(to_left, self._left, self._right)
        return np.where(o.state_property == StateProperty.SAFE, TOWARD_TARGET, away)
