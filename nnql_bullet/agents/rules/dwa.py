"""The dynamic window approach, over the manoeuvres on offer in place of a grid of velocities.

Fox, Burgard and Thrun, "The dynamic window approach to collision avoidance" (IEEE Robotics & Automation Magazine 4(1),
1997). The manoeuvres are driven in thought by the drive's own profiles, so all of them lie in the dynamic window.
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet.agents.base import Rule
from nnql_bullet.agents.turns import manoeuvre_poses, offered_turns, paces
from nnql_bullet.config import options
from nnql_bullet.env import ACTIONS, MANOEUVRES, Observation
from nnql_bullet.geometry import Array, as_rows, wrap_angles
from nnql_bullet.mapping.point_cloud import point_cloud
from nnql_bullet.mapping.prediction import PREDICTION_STEP, scan_clearances
from nnql_bullet.rollout import Actions
from nnql_bullet.types import NonNegative, Reach
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec


@options
class DwaOptions:
    """The article's weights, and how far it looks."""

    kind: Literal["dwa"] = "dwa"
    horizon: Annotated[float, Field(ge=PREDICTION_STEP, le=60)] = 3.8
    """Time that is predicted: the turn, and straight on after it [s]."""
    margin: Reach = 0.14
    """Clearance from the last scan below which the footprint counts as in contact [m]."""
    heading_weight: NonNegative = 1.0
    """alpha, weight of the direction of the target after the turn."""
    distance_weight: NonNegative = 3.3
    """beta, weight of the way until contact."""
    velocity_weight: NonNegative = 3.1
    """gamma, weight of the speed."""

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Dwa":
        """Builds the agent."""
        return Dwa(self, vehicle, drive)


class Dwa(Rule):
    """Of the manoeuvres after which the vehicle can still stop before contact, the one with the best weighted sum.

    It sees the rays, the speed, the yaw rate and the target's bearing and distance, knows the drive's own profiles and
    the footprint, and remembers nothing. If no manoeuvre is admissible, it takes the one that stays free of contact
    longest; of several that do, the one with the most room on the way. The article's sum is smoothed over a grid of
    velocities; there are too few manoeuvres for that.
    """

    def __init__(self, options: DwaOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._vehicle, self._drive = vehicle, drive
        self._footprint = as_rows((vehicle.footprint,))[0]
        self._margin = options.margin * length_scale(vehicle.footprint)
        horizon = max(options.horizon, drive.decision_period)
        self._times = PREDICTION_STEP * np.arange(1.0, np.ceil(horizon / PREDICTION_STEP - 1e-9) + 1)
        self._decided = int(np.searchsorted(self._times, drive.decision_period - 1e-9))
        self._goals = np.repeat(paces(drive), ACTIONS)

    def decide(self, observations: Observation) -> Actions:
        """The best of the 24 as foreseen."""
        o = observations
        poses = manoeuvre_poses(o, self._vehicle.limits, self._drive, self._times)
        points = point_cloud(o.ray_distances, self._vehicle.sensor)
        clearances: Array = scan_clearances(poses, points, self._footprint)
        free = _free_times(clearances > self._margin, self._times)
        admissible = free > self._decisive(o, poses)
        values = np.where(admissible, self.objective(o, poses, free), -np.inf)
        lasts = _free_times(clearances > 0, self._times)
        room = np.minimum(clearances, self._drive.speed * self._times[-1]).mean(axis=-1)
        longest = lasts == lasts.max(axis=-1, keepdims=True)
        last_resort = np.where(longest, room, -1.0).argmax(axis=-1)
        return np.asarray(np.where(admissible.any(axis=-1), values.argmax(axis=-1), last_resort))

    def objective(self, observations: Observation, poses: Array, free: Array) -> Array:
        """The article's objective of manoeuvres (n, 24), each of its three terms from 0 to 1, or less in reverse.

        Args:
            observations: Of n vehicles.
            poses: Of their manoeuvres, see `turns.manoeuvre_poses` (n, 24, k, 3).
            free: Times until contact (n, 24) [s]; infinite for none.
        """
        o, w = observations, self.options
        x, y = (o.target_distance * np.stack([np.cos(o.target_bearing), np.sin(o.target_bearing)]))[..., None]
        after = poses[:, :, self._decided]
        turns = np.tile(offered_turns(o.target_bearing), MANOEUVRES // ACTIONS)
        off = np.abs(wrap_angles(np.arctan2(y - after[..., 1], x - after[..., 0]) - turns))
        heading = 1 - off / np.pi
        share = np.minimum(free, self._times[-1]) / self._times[-1]
        distance = np.where(np.isinf(free), 1.0, share * np.abs(self._goals) / self._drive.speed)
        velocity = self._goals / self._drive.speed
        return w.heading_weight * heading + w.distance_weight * distance + w.velocity_weight * velocity

    def _decisive(self, observations: Observation, poses: Array) -> Array:
        """Times for which a manoeuvre has to be free (n, 24) [s]: then the vehicle can stop after the decision.

        At a steady speed v, the article's condition v <= sqrt(2 dist a) says that contact is v / 2a away in time; so it
        does for the yaw rate.
        """
        limits, period = self._vehicle.limits, self._drive.decision_period
        change = limits.acceleration * period
        before = observations.speed[:, None]
        speeds = np.clip(self._goals, before - change, before + change)
        headings = np.diff(poses[..., : self._decided + 1, 2], prepend=0.0, axis=-1)
        rates = headings[..., -1] / PREDICTION_STEP
        return period + np.maximum(
            np.abs(speeds) / (2 * limits.acceleration), np.abs(rates) / (2 * limits.yaw_acceleration)
        )


def _free_times(free: NDArray[np.bool_], times: Array) -> Array:
    """The first times (...) [s] at which poses (..., k) are not free; infinite if all are."""
    return np.where(free.all(axis=-1), np.inf, times[free.argmin(axis=-1)])
