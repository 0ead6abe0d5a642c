"""Regulated pure pursuit: an arc to a point ahead, slowly where the arc is tight or something is near.

Macenski, Singh, Martin and Gines, "Regulated pure pursuit for robot path tracking" (Autonomous Robots 47, 2023). The
path is the straight way to what the vehicle is told to drive at: the target or, on a plan, the point that moves on
ahead.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nnql_bullet.agents.base import Rule
from nnql_bullet.agents.turns import nearest_actions, nearest_paces, offered_turns
from nnql_bullet.config import options
from nnql_bullet.env import SLOW, STOP, Observation
from nnql_bullet.geometry import Array, as_rows
from nnql_bullet.mapping.point_cloud import point_cloud
from nnql_bullet.mapping.prediction import PREDICTION_STEP, predicted_poses, scan_clearances
from nnql_bullet.rollout import Actions
from nnql_bullet.types import Period, Positive, Reach, UnitInterval
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.profiles import ramp_distances
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec


@options
class PurePursuitOptions:
    """The article's parameters."""

    kind: Literal["pure_pursuit"] = "pure_pursuit"
    look_ahead_time: Period = 1.5
    """Distance of the point ahead, as the time to drive there at the present speed [s]."""
    least_look_ahead: Positive = 1.5
    """Smallest distance of the point ahead [m]."""
    most_look_ahead: Positive = 4.0
    """Largest distance of the point ahead [m]."""
    least_radius: Reach = 1.8
    """Radius of the arc below which it drives the slower the tighter the arc is [m]."""
    proximity: Reach = 0.6
    """Clearance below which it drives the slower the nearer something is [m]."""
    gain: UnitInterval = 1.0
    """Share of the speed that it keeps where the clearance is just below that."""
    rotate_degrees: Annotated[float, Field(gt=0, le=180)] = 90.0
    """Bearing of the point ahead from which it turns on the spot [degrees]."""
    collision_time: Period = 1.0
    """Time for which its way has to be free of contact; otherwise it stops [s]."""

    def __post_init__(self) -> None:
        """Refuses distances in the wrong order."""
        if self.least_look_ahead > self.most_look_ahead:
            raise ValueError(
                f"least_look_ahead {self.least_look_ahead:g} is above most_look_ahead {self.most_look_ahead:g}; "
                "swap them"
            )

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "PurePursuit":
        """Builds the agent."""
        return PurePursuit(self, vehicle, drive)


class PurePursuit(Rule):
    """Drives an arc to the point ahead, and stops where that would meet something.

    It sees the rays, the speed, the yaw rate and the target's bearing and distance, knows the drive's own profile and
    the footprint, and remembers nothing. It never drives around anything: that is what a plan is for.
    """

    def __init__(self, options: PurePursuitOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._vehicle, self._drive = vehicle, drive
        self._scale = length_scale(vehicle.footprint)
        self._footprint = as_rows((vehicle.footprint,))[0]
        count = np.ceil(options.collision_time / PREDICTION_STEP - 1e-9)
        self._times = PREDICTION_STEP * np.arange(1.0, max(count, 1.0) + 1)
        self._rotates_from = np.radians(options.rotate_degrees)

    def decide(self, observations: Observation) -> Actions:
        """The manoeuvre nearest to the arc and its speed, or a stop."""
        o, drive = observations, self._drive
        points = point_cloud(o.ray_distances, self._vehicle.sensor)
        here: Array = scan_clearances(np.zeros((len(o.speed), 1, 1, 3)), points, self._footprint)
        curvature = self.curvatures(o)
        paces = nearest_paces(
            np.maximum(self.speeds(curvature, here[:, 0, 0]), drive.reverse_share * drive.speed), drive
        )
        speeds = np.where(paces == SLOW, drive.reverse_share * drive.speed, drive.speed)
        turns = speeds * curvature * drive.decision_period
        rotates = np.abs(o.target_bearing) > self._rotates_from
        turns, paces = np.where(rotates, o.target_bearing, turns), np.where(rotates, STOP, paces)
        actions = nearest_actions(turns, o.target_bearing)
        return np.where(self._meets(o, points, actions, paces), STOP, actions + paces)

    def curvatures(self, observations: Observation) -> Array:
        """Curvatures of the arcs to the points ahead (n,) [1/m]: 2 y / L^2 for one at a distance L, y to the left."""
        o, p, scale = observations, self.options, self._scale
        ahead = np.clip(np.abs(o.speed) * p.look_ahead_time, p.least_look_ahead * scale, p.most_look_ahead * scale)
        away = np.maximum(np.minimum(ahead, o.target_distance), PREDICTION_STEP * scale)
        return np.asarray(2 * np.sin(o.target_bearing) / away)

    def speeds(self, curvatures: Array, clearances: Array) -> Array:
        """Regulated speeds (n,) [m/s], for arcs of curvatures (n,) [1/m] beside what is at clearances (n,) [m]."""
        p, scale = self.options, self._scale
        tight = np.minimum(1.0, 1.0 / np.maximum(np.abs(curvatures) * p.least_radius * scale, 1e-9))
        near = clearances < p.proximity * scale
        share = np.where(near, p.gain * np.minimum(clearances, p.proximity * scale) / max(p.proximity * scale, 1e-9), 1)
        return self._drive.speed * np.minimum(tight, share)

    def _meets(self, o: Observation, points: Array, actions: Actions, paces: Actions) -> Array:
        """Whether manoeuvres (n,) meet a point of the scan within the time that has to be free (n,)."""
        goals = self._drive.speed * np.where(paces == STOP, 0.0, np.where(paces == SLOW, self._drive.reverse_share, 1))
        turns = np.take_along_axis(offered_turns(o.target_bearing), actions[:, None], axis=-1)
        lengths = ramp_distances(o.speed, goals, self._vehicle.limits.acceleration, self._times)
        poses = predicted_poses(o.yaw_rate, turns, lengths, self._vehicle.limits, self._times)
        clearances: Array = scan_clearances(poses, points, self._footprint)
        return np.asarray((clearances <= 0).any(axis=(1, 2)))
