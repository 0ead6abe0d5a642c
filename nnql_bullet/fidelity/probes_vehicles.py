"""Changes a vehicle's properties for probes that isolate one effect."""

from dataclasses import replace

from nnql_bullet import paper
from nnql_bullet.constants import GRAVITY
from nnql_bullet.vehicle.limits import tip_acceleration, turn_demand
from nnql_bullet.vehicle.payload import loaded
from nnql_bullet.vehicle.profiles import plan_turn
from nnql_bullet.vehicle.spec import Payload, VehicleSpec

OWN_SHARE, EASY_SHARE = 0.95, 0.6
"""Largest share of grip for a turn at the vehicle's own limits, and for a slower turn that replaces it.

Near the limit of grip, one wheel slips before the other.
"""
TORQUE_SHARE = 0.95
"""Largest share of the torque limit for either turn."""
SLOWER = tuple(1 - 0.05 * n for n in range(1, 19))
"""Candidate shares of the vehicle's yaw rate for the slower turn."""


def has_swivel_in_front(vehicle: VehicleSpec) -> bool:
    """Whether the vehicle's only caster is one that swivels, in front, for which the closed forms hold."""
    casters = vehicle.casters
    return len(casters) == 1 and casters[0].swivels and casters[0].x > 0


def swivels_all(vehicle: VehicleSpec) -> bool:
    """Whether no caster of the vehicle slides."""
    return all(its.swivels for its in vehicle.casters)


def rolling_freely(vehicle: VehicleSpec) -> VehicleSpec:
    """Returns the vehicle without rolling and spinning resistance."""
    return replace(vehicle, contact=replace(vehicle.contact, rolling_friction=0.0, spinning_friction=0.0))


def on_ice(vehicle: VehicleSpec) -> VehicleSpec:
    """Returns the vehicle without friction."""
    slippery = rolling_freely(vehicle).gripping(0.0)
    return replace(slippery, contact=replace(slippery.contact, ball_friction=0.0))


def driven_by(vehicle: VehicleSpec, torque: float) -> VehicleSpec:
    """Returns the vehicle with another torque limit of the drives [N m]."""
    return replace(vehicle, wheel_torque=torque)


def top_heavy(vehicle: VehicleSpec) -> VehicleSpec:
    """Returns the vehicle with a payload of its own mass, which raises the centre of mass by 0.6 of the track."""
    if vehicle.payload:
        return vehicle
    return loaded(vehicle, Payload(vehicle.mass, vehicle.com_ahead, vehicle.com_height + 1.2 * vehicle.track))


def skidding_friction(vehicle: VehicleSpec) -> float:
    """Returns the vehicle's friction, or less if it would tip over before it slides."""
    sideways = tip_acceleration(vehicle) / GRAVITY
    forwards = (vehicle.wheelbase - vehicle.com_ahead) / vehicle.com_height
    return min(vehicle.contact.wheel_friction, 0.7 * sideways, 0.7 * forwards)


def gentlest_torque(vehicle: VehicleSpec) -> float:
    """Returns half the torque limit, or half the torque at which wheels spin or the caster lifts if less [N m]."""
    weight = vehicle.mass * GRAVITY
    spinning, rearing = vehicle.contact.wheel_friction * vehicle.rear_share, vehicle.com_ahead / vehicle.com_height
    return min(vehicle.wheel_torque, min(spinning, rearing) * weight * vehicle.wheel_radius / 2) / 2


def turning_within_its_means(vehicle: VehicleSpec, speed: float) -> tuple[VehicleSpec, float]:
    """Limits the vehicle so that the paper's turns do not exceed grip and torque.

    Returns:
        The vehicle, and its yaw-rate limit over the original one; 1 if the original limits suffice.
    """
    if _suffices(vehicle, speed, OWN_SHARE):
        return vehicle, 1.0
    for share in SLOWER:
        limits = vehicle.limits
        slower = replace(limits, yaw_rate=share * limits.yaw_rate, yaw_acceleration=share**2 * limits.yaw_acceleration)
        turning = replace(vehicle, limits=slower)
        if _suffices(turning, speed, EASY_SHARE):
            break
    return turning, share


def _suffices(vehicle: VehicleSpec, speed: float, grip_share: float) -> bool:
    demands = [turn_demand(vehicle, speed, plan_turn(0.0, turn, vehicle.limits)) for turn in paper.TURNS]
    grip, torque = grip_share * vehicle.contact.wheel_friction, TORQUE_SHARE * vehicle.wheel_torque
    return all(demand.friction <= grip and demand.torque <= torque for demand in demands)
