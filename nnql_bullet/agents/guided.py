"""An agent that a plan leads: it decides in the open, and the plan where it is narrow or leads back.

Where the point that moves on ahead lies behind the vehicle, it brakes and turns on the spot (as the rotation shim
controller of Nav2 does). Beside obstacles it drives slowly toward that point (as regulated pure pursuit does: Macenski
et al., Autonomous Robots 47, 2023). A shield around it sees these manoeuvres as wishes of the agent.
"""

from collections.abc import Mapping

import numpy as np

from nnql_bullet.agents.base import Overridable
from nnql_bullet.env import LARGEST_TURN, SLOW, STOP, TOWARD_TARGET, Observation
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions, Policy, PolicyState
from nnql_bullet.sensing import smallest
from nnql_bullet.vehicle.scale import turning_radius
from nnql_bullet.vehicle.spec import VehicleSpec

NARROW = 1.25
"""Distance of the nearest obstacle from the sensor within which the plan leads, in turning radii."""


class Guided:
    """An agent, and the plan in its place where it is narrow or leads back."""

    def __init__(self, agent: Policy, vehicle: VehicleSpec) -> None:
        """Takes an agent.

        Args:
            agent: Decides in the open.
            vehicle: Says what is narrow.
        """
        self.agent = agent
        self._narrow = NARROW * turning_radius(vehicle.footprint)

    def initial_state(self, size: int) -> PolicyState:
        """Returns the agent's state of n vehicles that have seen nothing."""
        return self.agent.initial_state(size)

    def reset(self, state: PolicyState, world_seeds: Mapping[int, int]) -> PolicyState:
        """Forgets vehicles that are put into worlds."""
        return self.agent.reset(state, world_seeds)

    def action_values(self, observations: Observation, state: PolicyState) -> Array:
        """Returns the agent's values of the paper's five turns (n, 5)."""
        return self.agent.action_values(observations, state)

    def act(self, observations: Observation, state: PolicyState) -> tuple[Actions, PolicyState]:
        """Chooses the agent's action, or the manoeuvre that follows the plan."""
        o = observations
        actions, state = self.agent.act(o, state)
        slowly = np.where(smallest(o.readings) < self._narrow, SLOW + TOWARD_TARGET, actions)
        chosen = np.where(np.abs(o.target_bearing) > LARGEST_TURN, STOP + TOWARD_TARGET, slowly)
        return chosen, self.override(state, chosen)

    def override(self, state: PolicyState, actions: Actions) -> PolicyState:
        """Tells the agent what was done in its place, if it wants to know."""
        return self.agent.override(state, actions) if isinstance(self.agent, Overridable) else state
