"""From a heading change and a speed that are wanted to those on offer that come nearest, and where these lead."""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import ACTIONS, MANOEUVRES, Observation, heading_change, speed_scale
from nnql_bullet.geometry import Array
from nnql_bullet.mapping.prediction import predicted_poses
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.profiles import ramp_distances
from nnql_bullet.vehicle.spec import Limits


def nearest_turns(heading_changes: Array) -> NDArray[np.int64]:
    """The paper's turns closest to heading changes (n,) [rad], by number (n,)."""
    return np.asarray(np.abs(np.array(paper.TURNS) - heading_changes[:, None]).argmin(axis=-1))


def offered_turns(target_bearing: Array) -> Array:
    """What each of the six actions turns by (n, 6) [rad], for targets at these bearings (n,) [rad]."""
    return heading_change(np.arange(ACTIONS), target_bearing[:, None])


def nearest_actions(heading_changes: Array, target_bearing: Array) -> NDArray[np.int64]:
    """The actions closest to heading changes (n,) [rad], for targets at these bearings (n,) [rad]."""
    return np.asarray(np.abs(offered_turns(target_bearing) - heading_changes[:, None]).argmin(axis=-1))


def paces(drive: DriveOptions) -> Array:
    """Speeds that the manoeuvres ask for (4,) [m/s]: ahead, with `STOP`, with `REVERSE` and with `SLOW`."""
    return drive.speed * speed_scale(np.arange(0, MANOEUVRES, ACTIONS), drive)


def nearest_paces(speeds: Array, drive: DriveOptions) -> NDArray[np.int64]:
    """What to add to actions (n,) for the pace closest to speeds (n,) [m/s]."""
    return ACTIONS * np.asarray(np.abs(paces(drive) - speeds[:, None]).argmin(axis=-1))


def manoeuvre_poses(observations: Observation, limits: Limits, drive: DriveOptions, times: Array) -> Array:
    """Predicts where the 24 manoeuvres lead, in the present frame of each vehicle (n, 24, k, 3).

    Args:
        observations: Of n vehicles.
        limits: The vehicle's limits.
        drive: Its drive.
        times: Times of the poses (k,) [s].
    """
    o, poses = observations, []
    turns = offered_turns(o.target_bearing)
    for pace in paces(drive).tolist():
        lengths = ramp_distances(o.speed, np.full(len(o.speed), pace), limits.acceleration, times)
        poses.append(predicted_poses(o.yaw_rate, turns, lengths, limits, times))
    return np.concatenate(poses, axis=1)
