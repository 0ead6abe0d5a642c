"""One-step prediction: each action is driven in thought, and the best of those that stay clear is taken."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.agents.base import Rule
from nnql_bullet.agents.turns import offered_turns
from nnql_bullet.config import options
from nnql_bullet.env import Observation
from nnql_bullet.geometry import Array, as_rows, wrap_angles
from nnql_bullet.mapping.point_cloud import point_cloud
from nnql_bullet.mapping.prediction import PREDICTION_STEP, predicted_poses, scan_clearances
from nnql_bullet.rollout import Actions
from nnql_bullet.types import Reach
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec


@options
class LookAheadOptions:
    """Options of the prediction."""

    kind: Literal["look_ahead"] = "look_ahead"
    horizon: Annotated[float, Field(ge=PREDICTION_STEP, le=60)] = 4.0
    """Time that is predicted: the turn, and straight on after it [s]."""
    margin: Reach = 0.5
    """Smallest clearance between the footprint and the last scan [m]. An obstacle may reach out between two rays."""

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "LookAhead":
        """Builds the agent."""
        return LookAhead(self, vehicle, drive)


class LookAhead(Rule):
    """Among the actions that stay clear of the last scan the one nearest to the target's direction.

    It sees the rays, the yaw rate and the target's bearing, knows the drive's own profile and the footprint, and
    remembers nothing. If no action keeps the margin, it takes the one that stays free of contact longest; of several
    that do, the one with the most room.
    """

    def __init__(self, options: LookAheadOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._vehicle = vehicle
        self._footprint = as_rows((vehicle.footprint,))[0]
        self._margin = options.margin * length_scale(vehicle.footprint)
        self._speed = drive.speed
        self._times = PREDICTION_STEP * np.arange(1.0, options.horizon / PREDICTION_STEP + 1e-9)

    def decide(self, observations: Observation) -> Actions:
        """The best of the six as foreseen."""
        o = observations
        turns = offered_turns(o.target_bearing)
        poses = self.predicted_poses(o.yaw_rate, turns)
        points = point_cloud(o.ray_distances, self._vehicle.sensor)
        clearances: Array = scan_clearances(poses, points, self._footprint)
        smallest = clearances.min(axis=-1)
        clear = smallest > self._margin
        off_target = np.abs(wrap_angles(o.target_bearing[:, None] - turns))
        free_until = np.where(smallest > 0, len(self._times), (clearances <= 0).argmax(axis=-1))
        lasts_longest = free_until == free_until.max(axis=-1, keepdims=True)
        best = np.where(clear, off_target, np.inf).argmin(axis=-1)
        last_resort = np.where(lasts_longest, smallest, -1.0).argmax(axis=-1)
        return np.asarray(np.where(clear.any(axis=-1), best, last_resort))

    def predicted_poses(self, yaw_rates: Array, turns: Array) -> Array:
        """Poses in the present vehicle frame (n, 6, k, 3) along turns (n, 6) [rad] that begin at yaw rates (n,)."""
        lengths = np.full((len(turns), len(self._times)), self._speed * PREDICTION_STEP)
        return predicted_poses(yaw_rates, turns, lengths, self._vehicle.limits, self._times)
