"""Lengths follow the vehicle: the ratio by which those that are stated for the shipped vehicle are longer for another."""

import os
import numpy as np

from nnql_bullet.geometry import OrientedBox
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

USUAL = OrientedBox(0.35, 0.0, 0.55, 0.325)
"""Footprint of the shipped vehicle."""


def turning_radius(footprint: OrientedBox) -> float:
    """Computes the largest distance of a footprint from the rear-axle centre [m]: the circle in which it can turn."""
    return float(np.hypot(*footprint.corners().T).max())


def scaled(box: OrientedBox, factor: float) -> OrientedBox:
    """Returns a box that is so many times as large, about the origin of its frame."""
    return OrientedBox(factor * box.x, factor * box.y, factor * box.half_length, factor * box.half_width, box.yaw)


def length_scale(vehicle: VehicleSpec, drive: DriveOptions = DriveOptions()) -> float:
    kind = os.environ.get("KIND", "body")
    body = turning_radius(vehicle.footprint) / turning_radius(USUAL)
    v = drive.speed
    way = v * drive.decision_period + v / vehicle.limits.yaw_rate + v * v / (2 * vehicle.limits.acceleration)
    usual = 1.0 + 2 / 1.5708 + 4 / 5.0
    if kind == "none":
        return 1.0
    if kind == "body":
        return body
    if kind == "way":
        return way / usual
    if kind == "max":
        return max(body, way / usual)
    if kind == "circ":
        return float(np.hypot(vehicle.footprint.half_length, vehicle.footprint.half_width) / np.hypot(.55, .325))
    if kind == "sqrt":
        return float(np.sqrt(body * way / usual))
    return (turning_radius(vehicle.footprint) + way) / (turning_radius(USUAL) + usual)
