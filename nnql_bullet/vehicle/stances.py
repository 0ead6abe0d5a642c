"""How the ground carries a vehicle that stands on its drive wheels and its casters.

With one caster, or all casters in one line across, the loads follow from the centre of mass. With casters ahead and
behind they do not: then all supports count as equally stiff springs, and those that would pull carry nothing.
"""

from dataclasses import dataclass
from math import inf

import numpy as np

from nnql_bullet.geometry import Array
from nnql_bullet.vehicle.spec import VehicleSpec


@dataclass(frozen=True, slots=True)
class Stance:
    """The load on the drive wheels as a function of the centre of mass: weight (axle_share - com_ahead / wheelbase)."""

    axle_share: float
    """Share of the weight on both drive wheels if the centre of mass is above their axle; 1 without casters on two
    sides."""
    wheelbase: float
    """Distance from the drive axle to the casters, negative behind it [m]; infinite if they share a shift of the centre
    of mass equally."""
    behind: float
    """How far the contact points reach behind the drive axle [m]."""
    ahead: float
    """How far they reach ahead of it [m]."""


def stance(vehicle: VehicleSpec) -> Stance:
    """Computes how the ground carries a vehicle."""
    points = np.array(vehicle.contacts)
    ends = -float(points[:, 0].min()), float(points[:, 0].max())
    casters = vehicle.casters
    if len({its.x for its in casters}) == 1:
        return Stance(1.0, casters[0].x, *ends)
    xs = points[loads_at_rest(vehicle) > 0, 0]
    if len(set(xs.tolist())) == 2:
        return Stance(1.0, float(max(xs, key=abs)), *ends)
    n, sum_1, sum_2 = len(xs), float(xs.sum()), float((xs * xs).sum())
    spread = n * sum_2 - sum_1 * sum_1
    return Stance(2 * sum_2 / spread, spread / (2 * sum_1) if abs(sum_1) > 1e-9 else inf, *ends)


def loads_at_rest(vehicle: VehicleSpec) -> Array:
    """Computes the loads on left and right drive wheel and the casters over the weight (n,), of equal springs."""
    points = np.array(vehicle.contacts)
    carrying = np.ones(len(points), np.bool_)
    centre = np.array([1.0, vehicle.com_ahead, vehicle.com_left])
    for _ in range(len(points)):
        rows = np.column_stack([np.ones(carrying.sum()), points[carrying]]).T
        loads = np.zeros(len(points))
        loads[carrying] = np.linalg.lstsq(rows, centre, rcond=None)[0]
        if loads.min() >= -1e-9 or carrying.sum() <= 3:
            break
        carrying &= loads > 0
    return loads


def margin(contacts: Array, x: float, y: float) -> float:
    """Computes how far a point is inside the convex hull of contact points (n, 2), negative outside [m]."""
    best = np.inf
    for i, a in enumerate(contacts):
        for b in contacts[i + 1 :]:
            along = b - a
            length = float(np.hypot(*along))
            if length < 1e-9:
                continue
            normal = np.array([-along[1], along[0]]) / length
            sides = (contacts - a) @ normal
            if sides.max() <= 1e-9:
                best = min(best, float((a - (x, y)) @ normal))
            if sides.min() >= -1e-9:
                best = min(best, float(((x, y) - a) @ normal))
    return best if np.isfinite(best) else -np.inf
