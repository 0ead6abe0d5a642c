"""Lengths follow the vehicle: those of agents and of the task are stated for the shipped vehicle.

Another vehicle has them multiplied by its scale. A vehicle with every length and speed k times as large, in a world k
times as large, so drives the same way k times as large (geometric similarity; times and angles are the same).
"""

import numpy as np

from nnql_bullet.geometry import OrientedBox

USUAL = OrientedBox(0.35, 0.0, 0.55, 0.325)
"""Footprint of the shipped vehicle."""


def turning_radius(footprint: OrientedBox) -> float:
    """Computes the largest distance of a footprint from the rear-axle centre [m]: it turns on the spot within it."""
    return float(np.hypot(*footprint.corners().T).max())


def length_scale(footprint: OrientedBox) -> float:
    """Computes the scale of a vehicle with this footprint: its turning radius over the shipped vehicle's."""
    return turning_radius(footprint) / turning_radius(USUAL)


def scaled(box: OrientedBox, factor: float) -> OrientedBox:
    """Returns a box that is so many times as large, about the origin of its frame."""
    return OrientedBox(factor * box.x, factor * box.y, factor * box.half_length, factor * box.half_width, box.yaw)
