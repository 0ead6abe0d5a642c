"""One-step look-ahead led by a map: of the manoeuvres after which the vehicle can stop, the one that shortens its way.

It is what `guided_dqn` sees, without learning: a global dynamic window (Brock and Khatib, ICRA 1999).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from nnql_bullet.agents.base import NoValues
from nnql_bullet.agents.foresight import Foresight, Look, Memory
from nnql_bullet.config import options
from nnql_bullet.env import Observation
from nnql_bullet.geometry import Array
from nnql_bullet.mapping.foresight import LASTS, ROOM, STOP_ROOM, UNKNOWN, WAY_AHEAD
from nnql_bullet.rollout import Actions
from nnql_bullet.types import NonNegative, Reach
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec


@options
class GuidedLookAheadOptions:
    """Options of the look-ahead."""

    kind: Literal["guided_look_ahead"] = "guided_look_ahead"
    margin: Reach = 0.1
    """Clearance from all that was seen below which a manoeuvre is a last resort [m]."""
    room: Reach = 0.4
    """Clearance that it keeps where that costs little [m]."""
    room_weight: NonNegative = 1.0
    """Length of way that it is worth, for each metre of clearance that lacks."""

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "GuidedLookAhead":
        """Builds the agent."""
        return GuidedLookAhead(self, vehicle, drive)


@dataclass(frozen=True, slots=True)
class GuidedState:
    """Memory of n vehicles, and what the last actions were chosen by."""

    memory: Memory
    last: tuple[Look, Observation] | None = None


class GuidedLookAhead(NoValues):
    """Keeps a map, drives every manoeuvre in thought and then to a stand, and takes the one with the best score."""

    def __init__(self, options: GuidedLookAheadOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._scale = length_scale(vehicle.footprint)
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
        look = self._foresight.look(state.memory, observations)
        actions = np.asarray(scores(look.foreseen, self.options, self._scale).argmax(axis=-1))
        return actions, self._after(look, observations, actions)

    def override(self, state: GuidedState, actions: Actions) -> GuidedState:
        """Returns the state after these actions in place of those last chosen."""
        return self._after(*state.last, actions) if state.last else state

    def _after(self, look: Look, observations: Observation, actions: Actions) -> GuidedState:
        return GuidedState(self._foresight.after(look, observations, actions), (look, observations))


def scores(foreseen: Array, o: GuidedLookAheadOptions, scale: float) -> Array:
    """How good each manoeuvre is as foreseen (n, m): its way, and the room it leaves; least where it meets something."""
    room = np.minimum(foreseen[..., ROOM], foreseen[..., STOP_ROOM]) / scale
    way = foreseen[..., WAY_AHEAD] / scale + o.room_weight * np.maximum(o.room - room, 0.0)
    safe = room > o.margin
    resort = -100.0 + 50.0 * foreseen[..., LASTS] + 10.0 * room - 0.01 * way
    return np.where(safe, -way - 0.1 * foreseen[..., UNKNOWN], resort)
