"""Where a vehicle has got to that did not quite go where it was to: what its target's direction and distance tell."""

from dataclasses import dataclass

import numpy as np

from nnql_bullet.geometry import Array, wrap_angle


@dataclass(frozen=True, slots=True)
class TargetFix:
    """Of the target, from the vehicle."""

    distance: float
    """[m]"""
    bearing: float
    """[rad]"""

    @property
    def place(self) -> Array:
        """Where it is in the vehicle frame (2,) [m]."""
        return self.distance * np.array([np.cos(self.bearing), np.sin(self.bearing)])


def found_pose(reckoned: Array, before: TargetFix, now: TargetFix) -> Array:
    """The pose of now in the vehicle frame of before (3,).

    The bearing tells the heading, and the distance where on the line to the target the vehicle is. Across that line
    it is where the reckoned way led, turned by half of what the heading is off: that came about little by little.

    Args:
        reckoned: That pose as it should be (3,).
        before: Of the target.
        now: Likewise.
    """
    off = _on_the_line(reckoned, before, now)[2] - reckoned[2]
    c, s = np.cos(off / 2), np.sin(off / 2)
    x, y, yaw = reckoned
    return _on_the_line(np.array([c * x - s * y, s * x + c * y, yaw]), before, now)


def _on_the_line(pose: Array, before: TargetFix, now: TargetFix) -> Array:
    """The pose brought to where the target is at that distance and bearing, on its line to the target."""
    x, y = before.place - pose[:2]
    toward = float(np.arctan2(y, x))
    place = before.place - now.distance * np.array([np.cos(toward), np.sin(toward)])
    return np.array([*place, pose[2] + wrap_angle(toward - now.bearing - pose[2])])


def seen_from(pose: Array, points: Array) -> Array:
    """Points (n, 2) [m] as they are in the frame of a pose (3,) that is given, as they are, in another."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray((points - pose[:2]) @ np.array([[c, -s], [s, c]]))
