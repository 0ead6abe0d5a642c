"""The artificial potential field: the target attracts, obstacles repel, and the vehicle goes where the force points.

Khatib, "Real-time obstacle avoidance for manipulators and mobile robots" (Int. J. Robotics Research 5(1), 1986).
"""

from math import radians
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import Rule
from nnql_bullet.agents.turns import nearest_actions
from nnql_bullet.config import options
from nnql_bullet.env import Observation
from nnql_bullet.geometry import Array, OrientedBox, wrap_angles
from nnql_bullet.mapping.point_cloud import point_cloud
from nnql_bullet.rollout import Actions
from nnql_bullet.sensing import RAYS
from nnql_bullet.types import Positive
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale, scaled
from nnql_bullet.vehicle.spec import VehicleSpec

CLOSEST = 0.01
"""Lower bound on distances [m]; it keeps the force finite."""


@options
class PotentialFieldOptions:
    """Options of the repulsion; the attraction is 1."""

    kind: Literal["potential_field"] = "potential_field"
    gain: Positive = 100.0
    """eta, the strength of the repulsion by each of 72 rays [m3]; of more rays each repels less."""
    influence: Annotated[float, Field(gt=0, le=paper.SENSOR_RANGE)] = paper.SENSOR_RANGE
    """rho_0, the distance from which on an obstacle has no effect [m]."""
    view_degrees: Annotated[float, Field(gt=0, le=180)] = 60.0
    """Angle from straight ahead within which obstacles repel [degrees]."""

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "PotentialField":
        """Builds the agent."""
        return PotentialField(self, vehicle, length_scale(vehicle.footprint))


class PotentialField(Rule):
    """The direction of the force is the wanted direction; the action nearest to it is taken.

    It sees the rays and the target's bearing, and remembers nothing. Every point where a ray
    ends repels.
    """

    def __init__(self, options: PotentialFieldOptions, vehicle: VehicleSpec, scale: float) -> None:
        self.options = options
        self._sensor, self._scale = vehicle.sensor, scale
        self._footprint = scaled(vehicle.footprint, 1 / scale)
        self._gain = options.gain * (RAYS / vehicle.sensor.rays)
        self._in_view = np.abs(wrap_angles(vehicle.sensor.angles)) < radians(options.view_degrees) + 1e-9

    def decide(self, observations: Observation) -> Actions:
        """Where the force points."""
        bearing = observations.target_bearing
        points = point_cloud(observations.ray_distances, self._sensor)[:, self._in_view] / self._scale
        # The attraction is as strong everywhere, as Khatib's is wherever the speed is limited.
        force = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        force += repulsion(points, self._footprint, self._gain, self.options.influence)
        return nearest_actions(np.arctan2(force[:, 1], force[:, 0]), bearing)


def repulsion(points: Array, footprint: OrientedBox, gain: float, influence: float) -> Array:
    """The force of obstacle points on the vehicle (n, 2), in the vehicle frame.

    It is minus the gradient of Khatib's potential, gain / 2 (1 / rho - 1 / influence)^2 of each point nearer than
    `influence`, where rho is the point's distance from the footprint.

    Args:
        points: In the vehicle frame (n, m, 2) [m]; NaN for none.
        footprint: In the vehicle frame, along its axes.
        gain: [m3], for a force without unit.
        influence: [m]
    """
    centre, half = np.array([footprint.x, footprint.y]), np.array([footprint.half_length, footprint.half_width])
    away = np.clip(points, centre - half, centre + half) - points
    distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), CLOSEST)
    strength = gain * (1 / distance - 1 / influence) / distance**2
    force = np.where(distance < influence, strength / distance, 0.0)[..., None] * away
    return np.asarray(np.nansum(force, axis=1))
