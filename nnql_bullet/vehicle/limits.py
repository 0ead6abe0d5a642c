"""Friction, wheel torque and wheel loads that a manoeuvre needs, and the limits that follow, by Newton and Euler.

The vehicle is a rigid body on two driven rear wheels and a free front caster. The caster trails: it carries load and
takes no side force. All results include the payload of the `VehicleSpec`. They neglect rolling resistance and the
force that swings the caster's own mass.

Sources: Gillespie, Fundamentals of Vehicle Dynamics, chapters 1 (axle loads), 3 (braking) and 9 (roll-over); Wong,
Theory of Ground Vehicles, 3.8 (braking) and 5.1 (centripetal force); Siegwart and Nourbakhsh, Introduction to
Autonomous Mobile Robots, 3.2 (differential drive).
"""

from dataclasses import dataclass, replace
from math import atan, sqrt

import numpy as np

from nnql_bullet.constants import GRAVITY
from nnql_bullet.geometry import Array
from nnql_bullet.vehicle.profiles import Turn
from nnql_bullet.vehicle.spec import Limits, VehicleSpec

INSTANTS = 60
"""Number of instants evaluated in each phase of a turn, including both ends; the peaks are at the ends."""


@dataclass(frozen=True, slots=True)
class Demand:
    """Forces, torques and loads that a manoeuvre needs at n instants."""

    lateral: Array
    """Lateral acceleration of the centre of mass, positive to the left (n,) [m/s2]."""
    side_force: Array
    """Force of the ground on both drive wheels together, positive to the left (n,) [N]."""
    drive_forces: Array
    """Forces of the ground on the left and right drive wheel, positive ahead (n, 2) [N]."""
    torques: Array
    """Torques of the left and right drive (n, 2) [N m]."""
    loads: Array
    """Loads on the left wheel, the right one and all casters together (n, 3) [N]; a wheel lifts where its load is
    negative."""

    @property
    def friction(self) -> Array:
        """Coefficient of friction that both drive wheels together need (n,).

        A rigid axle distributes its side force between the wheels. It slides when both together reach their limit:
        |sum of forces| <= mu (N_left + N_right), where the longitudinal forces count by their magnitude.
        """
        along = np.abs(self.drive_forces).sum(axis=1)
        return np.asarray(np.hypot(self.side_force, along) / (self.loads[:, 0] + self.loads[:, 1]))


@dataclass(frozen=True, slots=True)
class TurnDemand:
    """Extreme values of a turn's demand over its instants."""

    friction: float
    """Largest coefficient of friction that the drive wheels need; see `Demand.friction`."""
    torque: float
    """Largest torque of a drive [N m]."""
    least_load: float
    """Smallest load on a drive wheel over its load at rest; the wheel lifts below zero."""
    lateral: float
    """Largest lateral acceleration of the centre of mass [m/s2]."""


def quasi_steady(vehicle: VehicleSpec, speed: float, yaw_rate: Array, yaw_acceleration: Array) -> Demand:
    """Computes the demand of a turn with the rear-axle centre at constant speed.

    The centre of mass, `a` ahead of the axle, accelerates by v w + a alpha to the left and by -a w^2 ahead. The side
    force acts at the axle, so the drives turn the vehicle against it with the moment M = Izz alpha + a m (v w + a
    alpha), which is the moment of forces of +-M/T at the wheels. Moments about the roll and pitch axes give the loads:
    the spin of the wheels adds to the first, a payload's product of inertia to both, and the swivelled caster shifts
    the point of contact in front.

    Args:
        vehicle: The vehicle that turns.
        speed: Speed of the rear-axle centre, above zero [m/s].
        yaw_rate: Yaw rates, positive to the left (n,) [rad/s].
        yaw_acceleration: Yaw accelerations (n,) [rad/s2].
    """
    v, w, alpha = speed, np.asarray(yaw_rate, dtype=float), np.asarray(yaw_acceleration, dtype=float)
    m, a, h = vehicle.mass, vehicle.com_ahead, vehicle.com_height
    track, radius = vehicle.track, vehicle.wheel_radius
    lateral, ahead = v * w + a * alpha, -a * w * w
    side = m * lateral
    apart = (vehicle.yaw_inertia * alpha + a * side) / track
    drive_forces = np.stack([m * ahead / 2 - apart, m * ahead / 2 + apart], axis=1)
    spin_up = vehicle.wheel_spin_inertia * alpha * track / 2 / radius
    torques = drive_forces * radius + np.stack([-spin_up, spin_up], axis=1)

    product = _product_of_inertia(vehicle)
    caster_ahead, caster_left = _caster_contact(vehicle, v, w)
    moved = (m * GRAVITY * a - m * ahead * h + product * w * w) / caster_ahead
    front = m * GRAVITY * (1 - vehicle.stance.axle_share) + moved
    wheel_spin = 2 * vehicle.wheel_spin_inertia * v / radius
    overturning = side * h + product * alpha + wheel_spin * w + front * caster_left
    rear, transfer = (m * GRAVITY - front) / 2, overturning / track
    return Demand(lateral, side, drive_forces, torques, np.stack([rear - transfer, rear + transfer, front], axis=1))


def turn_demand(vehicle: VehicleSpec, speed: float, turn: Turn) -> TurnDemand:
    """Computes the extreme demand of a turn at constant speed.

    Args:
        vehicle: The vehicle that turns.
        speed: Speed of the rear-axle centre, above zero [m/s].
        turn: Yaw-rate profile of the turn.
    """
    rates, accelerations = [], []
    for seconds, begin, end in (
        (turn.rise, turn.start, turn.peak),
        (turn.hold, turn.peak, turn.peak),
        (turn.fall, turn.peak, 0.0),
    ):
        if seconds > 0:
            rates.append(np.linspace(begin, end, INSTANTS))
            accelerations.append(np.full(INSTANTS, (end - begin) / seconds))
    if not rates:
        return worst(vehicle, quasi_steady(vehicle, speed, np.zeros(1), np.zeros(1)))
    return worst(vehicle, quasi_steady(vehicle, speed, np.concatenate(rates), np.concatenate(accelerations)))


def worst(vehicle: VehicleSpec, demand: Demand) -> TurnDemand:
    """Computes the extreme values of a demand over its instants."""
    return TurnDemand(
        friction=float(demand.friction.max()),
        torque=float(np.abs(demand.torques).max()),
        least_load=float(demand.loads[:, :2].min()) / static_rear_load(vehicle),
        lateral=float(np.abs(demand.lateral).max()),
    )


def static_rear_load(vehicle: VehicleSpec) -> float:
    """Computes the load on each drive wheel at rest [N]."""
    return vehicle.mass * GRAVITY * vehicle.rear_share / 2


def tip_acceleration(vehicle: VehicleSpec) -> float:
    """Computes the lateral acceleration that lifts the inner drive wheel: g (T/2)(1 - a/L)/h [m/s2]."""
    return GRAVITY * vehicle.track / 2 * vehicle.rear_share / vehicle.com_height


def tip_angle(vehicle: VehicleSpec) -> float:
    """Computes the sideways slope on which a wheel lifts [rad]; it is also the roll angle at which the vehicle tips."""
    return atan(tip_acceleration(vehicle) / GRAVITY)


def grip_acceleration(vehicle: VehicleSpec) -> float:
    """Computes the lateral acceleration of a turn at the limit of grip: mu g (1 - a/L)/sqrt(1 + (2a/T)^2) [m/s2].

    The root accounts for the longitudinal forces of the wheels: they balance the moment of the side force, which acts
    behind the centre of mass.
    """
    straight = vehicle.contact.wheel_friction * GRAVITY * vehicle.rear_share
    return straight / sqrt(1 + (2 * vehicle.com_ahead / vehicle.track) ** 2)


def side_grip(vehicle: VehicleSpec, deceleration: float) -> float:
    """Computes the lateral acceleration at the limit of grip that braking leaves, by the friction ellipse [m/s2].

    Args:
        vehicle: The vehicle that turns.
        deceleration: At which it brakes [m/s2]; one that locks its wheels leaves nothing.
    """
    share = min(deceleration / braking(vehicle).by_grip, 1.0)
    return grip_acceleration(vehicle) * sqrt(1 - share * share)


@dataclass(frozen=True, slots=True)
class Braking:
    """Decelerations of a vehicle that brakes on its drive wheels, straight ahead."""

    by_grip: float
    """Deceleration with locked wheels, which braking unloads: mu g (1 - a/L)/(1 + mu h/L) [m/s2]."""
    by_torque: float
    """Deceleration with rolling wheels at the torque limit: 2 tau/(r m) [m/s2]; m includes the wheels' inertia."""

    @property
    def deceleration(self) -> float:
        """Deceleration of the vehicle: the smaller of both [m/s2]."""
        return min(self.by_grip, self.by_torque)

    def stopping_distance(self, speed: float, reaction: float = 0.0) -> float:
        """Computes the distance driven until the vehicle stands: v t + v^2/(2d) [m].

        Args:
            speed: Speed when the obstacle is seen [m/s].
            reaction: Time until the brakes act [s].
        """
        return speed * reaction + speed * speed / (2 * self.deceleration)

    def largest_speed(self, distance: float, reaction: float = 0.0) -> float:
        """Computes the largest speed from which the vehicle stops within a distance [m/s].

        Args:
            distance: Free distance ahead [m].
            reaction: Time until the brakes act [s].
        """
        lost = self.deceleration * reaction
        return sqrt(lost * lost + 2 * self.deceleration * distance) - lost


def braking(vehicle: VehicleSpec) -> Braking:
    """Computes the decelerations of a vehicle that brakes straight ahead."""
    mu = vehicle.contact.wheel_friction
    unloading = mu * vehicle.com_height / vehicle.wheelbase
    return Braking(
        by_grip=mu * GRAVITY * vehicle.rear_share / (1 + unloading),
        by_torque=2 * vehicle.wheel_torque / (vehicle.wheel_radius * vehicle.rolling_mass),
    )


MIN_TURNING_BRAKES = 0.4
"""Lower bound on the deceleration in a turn, over that straight ahead; braking also ends the turn."""
MIN_YAW_ACCELERATION = 0.1
"""Lower bound on the yaw acceleration that the vehicle can follow, over the commanded limit."""


def followed_limits(vehicle: VehicleSpec, speed: float, acceleration: float = 0.0) -> Limits:
    """Computes the limits within which the vehicle follows its commands; they do not exceed the commanded limits.

    Grip limits the yaw rate of a steady turn. The force F of a drive wheel, the smaller of tau/r and mu N less its part
    in the acceleration along the vehicle, limits the yaw acceleration: F T >= Izz alpha + a m (v w + a alpha).

    Args:
        vehicle: The vehicle that turns.
        speed: Speed of the rear-axle centre [m/s].
        acceleration: Magnitude of the acceleration along the vehicle [m/s2].
    """
    limits, a = vehicle.limits, vehicle.com_ahead
    rate = min(limits.yaw_rate, grip_acceleration(vehicle) / speed)
    push = min(vehicle.wheel_torque / vehicle.wheel_radius, vehicle.contact.wheel_friction * static_rear_load(vehicle))
    push -= vehicle.rolling_mass * acceleration / 2
    turning = (push * vehicle.track - a * vehicle.mass * speed * rate) / (vehicle.yaw_inertia + vehicle.mass * a * a)
    least = MIN_YAW_ACCELERATION * limits.yaw_acceleration
    return replace(limits, yaw_rate=rate, yaw_acceleration=min(max(turning, least), limits.yaw_acceleration))


def turning_deceleration(vehicle: VehicleSpec, speed: float) -> float:
    """Computes the deceleration that is left while the vehicle turns at the yaw rate of `followed_limits` [m/s2].

    Each drive wheel takes half the side force, within its circle of friction, and the longitudinal force that holds the
    turn. The remaining longitudinal force brakes.

    Args:
        vehicle: The vehicle that turns.
        speed: Speed of the rear-axle centre [m/s].
    """
    side = vehicle.mass * speed * followed_limits(vehicle, speed).yaw_rate
    grip = vehicle.contact.wheel_friction * static_rear_load(vehicle)
    along = sqrt(max(grip * grip - side * side / 4, 0.0))
    push = min(vehicle.wheel_torque / vehicle.wheel_radius, along) - vehicle.com_ahead * side / vehicle.track
    straight = braking(vehicle).deceleration
    return min(max(2 * push / vehicle.rolling_mass, MIN_TURNING_BRAKES * straight), straight)


def braking_rear_load(vehicle: VehicleSpec, deceleration: float) -> float:
    """Computes the load on each drive wheel while braking, over its load at rest."""
    moved = vehicle.mass * deceleration * vehicle.com_height / vehicle.wheelbase / 2
    return 1 - moved / static_rear_load(vehicle)


def _product_of_inertia(vehicle: VehicleSpec) -> float:
    """Computes the payload's product of inertia about the centre of mass, the sum of m x z [kg m2].

    The product of inertia of the empty vehicle is small and counts as zero.
    """
    load = vehicle.payload
    if load is None:
        return 0.0
    reduced = load.mass * vehicle.mass / (vehicle.mass - load.mass)
    return reduced * (load.ahead - vehicle.com_ahead) * (load.height - vehicle.com_height)


def _caster_contact(vehicle: VehicleSpec, speed: float, yaw_rate: Array) -> tuple[Array, Array]:
    """Computes the contact point of a single caster, ahead and to the left of the rear-axle centre (n,) [m].

    Of several casters, and of a ball, it is where they touch the ground straight ahead.

    The contact point moves in the wheel's plane: w L' cos(delta) - v sin(delta) = t w, with the swivel axis L' = L + t
    ahead of the axle and the trail t.
    """
    if len(vehicle.casters) != 1 or not vehicle.casters[0].swivels or vehicle.wheelbase < 0:
        return np.full_like(yaw_rate, vehicle.wheelbase), np.zeros_like(yaw_rate)
    trail = vehicle.casters[0].trail
    swivel = vehicle.wheelbase + trail
    across = yaw_rate * swivel
    delta = np.arctan2(across, speed) - np.arcsin(trail * yaw_rate / np.hypot(speed, across))
    return swivel - trail * np.cos(delta), -trail * np.sin(delta)
