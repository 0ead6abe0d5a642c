"""Localizes a vehicle by its target: bearing and distance of the target correct the predicted pose."""

from dataclasses import dataclass

import numpy as np

from nnql_bullet.geometry import Array, wrap_angle


@dataclass(frozen=True, slots=True)
class TargetFix:
    """Distance and bearing of the target from the vehicle."""

    distance: float
    """[m]"""
    bearing: float
    """[rad]"""

    @property
    def place(self) -> Array:
        """Position of the target in the vehicle frame (2,) [m]."""
        return self.distance * np.array([np.cos(self.bearing), np.sin(self.bearing)])


def found_pose(predicted: Array, before: TargetFix, now: TargetFix) -> Array:
    """Corrects a predicted pose in the vehicle's earlier frame (3,).

    The bearing gives the heading, and the distance gives the position along the line to the target. The position across
    that line is the predicted one, turned by half of the heading error, because the error grew along the path.

    Args:
        predicted: The predicted pose (3,).
        before: The target seen from the earlier pose.
        now: The target seen from the present pose.
    """
    off = _on_the_line(predicted, before, now)[2] - predicted[2]
    c, s = np.cos(off / 2), np.sin(off / 2)
    x, y, yaw = predicted
    return _on_the_line(np.array([c * x - s * y, s * x + c * y, yaw]), before, now)


def _on_the_line(pose: Array, before: TargetFix, now: TargetFix) -> Array:
    """Moves a pose along its line to the target, and turns it, to the present distance and bearing of the target."""
    x, y = before.place - pose[:2]
    toward = float(np.arctan2(y, x))
    place = before.place - now.distance * np.array([np.cos(toward), np.sin(toward)])
    return np.array([*place, pose[2] + wrap_angle(toward - now.bearing - pose[2])])


def seen_from(pose: Array, points: Array) -> Array:
    """Transforms points (n, 2) [m] into the frame of a pose (3,); both are given in one frame."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray((points - pose[:2]) @ np.array([[c, -s], [s, c]]))
