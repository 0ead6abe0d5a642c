"""Localizes a vehicle by its target: bearing and distance of the target correct the predicted pose."""

import numpy as np

from nnql_bullet.geometry import Array, wrap_angle
from nnql_bullet.jit import njit


@njit()
def found_pose(found: Array, predicted: Array, place: Array, distance: float, bearing: float) -> None:
    """Corrects a predicted pose in the vehicle's earlier frame (3,).

    The bearing gives the heading, and the distance gives the position along the line to the target. The position across
    that line is the predicted one, turned by half of the heading error, because the error grew along the path.

    Args:
        found: Room for the corrected pose (3,).
        predicted: The predicted pose (3,).
        place: Of the target in the earlier frame (2,) [m].
        distance: Of the target from the present pose [m].
        bearing: Of the target from the present pose [rad].
    """
    x, y, yaw = predicted[0], predicted[1], predicted[2]
    off = _heading(x, y, yaw, place, bearing) - yaw
    c, s = np.cos(off / 2), np.sin(off / 2)
    x, y = c * x - s * y, s * x + c * y
    toward = np.arctan2(place[1] - y, place[0] - x)
    found[0] = place[0] - distance * np.cos(toward)
    found[1] = place[1] - distance * np.sin(toward)
    found[2] = _heading(x, y, yaw, place, bearing)


@njit()
def _heading(x: float, y: float, yaw: float, place: Array, bearing: float) -> float:
    """The heading of a vehicle at (x, y) that sees a place at a bearing, near to a heading [rad]."""
    return yaw + wrap_angle(np.arctan2(place[1] - y, place[0] - x) - bearing - yaw)
