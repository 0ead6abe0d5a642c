"""What a manoeuvre asks of a vehicle, on paper: friction, wheel torque and wheel loads from Newton and Euler.

The vehicle is a rigid body on two driven rear wheels and a free front caster. The caster rolls where it is pulled, so
it carries load and takes no side force. Everything follows from a `VehicleSpec`, and so from its payload.

Left out, for what they are worth: rolling resistance (1 N m a wheel), and the force that swings the caster's own mass.

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
"""Looked at in each phase of a turn; both ends are among them, and with them the peaks."""


@dataclass(frozen=True, slots=True)
class Demand:
    """What the ground and the drives have to give at n instants."""

    lateral: Array
    """Acceleration of the centre of mass, to the left (n,) [m/s2]."""
    side_force: Array
    """On both drive wheels together, to the left (n,) [N]."""
    drive_forces: Array
    """On the left and right drive wheel, ahead (n, 2) [N]."""
    torques: Array
    """Of the left and right drive (n, 2) [N m]."""
    loads: Array
    """On the left, right and caster wheel (n, 3) [N]; one below zero says that the wheel lifts."""

    @property
    def friction(self) -> Array:
        """Coefficient of friction that the drive wheels need, taken together (n,).

        A rigid axle shares its side force as grip allows, so it slides once the sum of what both wheels can hold is
        used up: |sum of forces| <= mu (N_left + N_right), with the longitudinal forces counted by their size.
        """
        along = np.abs(self.drive_forces).sum(axis=1)
        return np.asarray(np.hypot(self.side_force, along) / (self.loads[:, 0] + self.loads[:, 1]))


@dataclass(frozen=True, slots=True)
class TurnDemand:
    """The most that a turn asks for, each at its own instant."""

    friction: float
    """Coefficient that the drive wheels need, see `Demand.friction`."""
    torque: float
    """Of either drive [N m]."""
    least_load: float
    """On either drive wheel, over its load at rest; below zero it lifts."""
    lateral: float
    """Acceleration of the centre of mass [m/s2]."""


def quasi_steady(vehicle: VehicleSpec, speed: float, yaw_rate: Array, yaw_acceleration: Array) -> Demand:
    """The demand of turning with the rear-axle centre at constant speed.

    The centre of mass, `a` ahead of the axle, accelerates by v w + a alpha to the left and by -a w^2 ahead. The side
    force acts at the axle, so the drives turn the vehicle against it: M = Izz alpha + a m (v w + a alpha), which forces
    of +-M/T at the wheels give. Moments about the roll and pitch axes give the loads: the spin of the wheels adds to
    the first, a payload's product of inertia to both, and the swivelled caster shifts the point that holds the front.

    Args:
        vehicle: What turns.
        speed: Of the rear-axle centre, above zero [m/s].
        yaw_rate: At each instant, positive to the left (n,) [rad/s].
        yaw_acceleration: At each instant (n,) [rad/s2].
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
    front = (m * GRAVITY * a - m * ahead * h + product * w * w) / caster_ahead
    wheel_spin = 2 * vehicle.wheel_spin_inertia * v / radius
    overturning = side * h + product * alpha + wheel_spin * w + front * caster_left
    rear, transfer = (m * GRAVITY - front) / 2, overturning / track
    return Demand(lateral, side, drive_forces, torques, np.stack([rear - transfer, rear + transfer, front], axis=1))


def turn_demand(vehicle: VehicleSpec, speed: float, turn: Turn) -> TurnDemand:
    """The most that a turn asks for at constant speed.

    Args:
        vehicle: What turns.
        speed: Of the rear-axle centre, above zero [m/s].
        turn: Its yaw-rate profile.
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
    """The most that is asked for at any of the instants."""
    return TurnDemand(
        friction=float(demand.friction.max()),
        torque=float(np.abs(demand.torques).max()),
        least_load=float(demand.loads[:, :2].min()) / static_rear_load(vehicle),
        lateral=float(np.abs(demand.lateral).max()),
    )


def static_rear_load(vehicle: VehicleSpec) -> float:
    """On each drive wheel at rest [N]."""
    return vehicle.mass * GRAVITY * vehicle.rear_share / 2


def tip_acceleration(vehicle: VehicleSpec) -> float:
    """Lateral acceleration that lifts the inner drive wheel: g (T/2)(1 - a/L)/h [m/s2]."""
    return GRAVITY * vehicle.track / 2 * vehicle.rear_share / vehicle.com_height


def tip_angle(vehicle: VehicleSpec) -> float:
    """Sideways slope on which a wheel lifts, and roll from which the vehicle does not come back [rad]."""
    return atan(tip_acceleration(vehicle) / GRAVITY)


def grip_acceleration(vehicle: VehicleSpec) -> float:
    """Lateral acceleration of a steady turn that uses all grip: mu g (1 - a/L)/sqrt(1 + (2a/T)^2) [m/s2].

    The root is the longitudinal force with which the drives hold the turn, since the side force acts behind the centre
    of mass.
    """
    straight = vehicle.contact.wheel_friction * GRAVITY * vehicle.rear_share
    return straight / sqrt(1 + (2 * vehicle.com_ahead / vehicle.track) ** 2)


@dataclass(frozen=True, slots=True)
class Braking:
    """How hard a vehicle can brake on its drive wheels, straight ahead."""

    by_grip: float
    """Deceleration on locked wheels: mu g (1 - a/L)/(1 + mu h/L), since braking unloads them [m/s2]."""
    by_torque: float
    """Deceleration at the drives' torque limit, wheels rolling: 2 tau/(r m), m with the wheels' inertia [m/s2]."""

    @property
    def deceleration(self) -> float:
        """What is reached: the smaller [m/s2]."""
        return min(self.by_grip, self.by_torque)

    def stopping_distance(self, speed: float, reaction: float = 0.0) -> float:
        """What is driven until the vehicle stands: v t + v^2/(2d) [m].

        Args:
            speed: When the reason to stop appears [m/s].
            reaction: Until the brakes act [s].
        """
        return speed * reaction + speed * speed / (2 * self.deceleration)

    def largest_speed(self, distance: float, reaction: float = 0.0) -> float:
        """The speed from which the vehicle stops within a distance: the positive root of its stopping distance [m/s].

        Args:
            distance: Free way ahead [m].
            reaction: Until the brakes act [s].
        """
        lost = self.deceleration * reaction
        return sqrt(lost * lost + 2 * self.deceleration * distance) - lost


def braking(vehicle: VehicleSpec) -> Braking:
    """How hard a vehicle can brake."""
    mu = vehicle.contact.wheel_friction
    unloading = mu * vehicle.com_height / vehicle.wheelbase
    return Braking(
        by_grip=mu * GRAVITY * vehicle.rear_share / (1 + unloading),
        by_torque=2 * vehicle.wheel_torque / (vehicle.wheel_radius * vehicle.rolling_mass),
    )


LEAST_BRAKING = 0.4
"""Of what it brakes straight ahead, what a vehicle is taken to brake in any turn: it ends the turn, too."""
LEAST_SHARE = 0.1
"""Of its limit on yaw acceleration, what a vehicle is taken to follow whatever it carries."""


def followed_limits(vehicle: VehicleSpec, speed: float, acceleration: float = 0.0) -> Limits:
    """What the vehicle follows at the least of the limits that its drive goes by.

    Its yaw rate is what grip holds in a steady turn. A drive wheel pushes with F, the smaller of tau/r and mu N, less
    what speeds the vehicle up or slows it down; that turns it by F T >= Izz alpha + a m (v w + a alpha).

    Args:
        vehicle: What turns.
        speed: Of the rear-axle centre [m/s].
        acceleration: Along the vehicle, by its size [m/s2].
    """
    limits, a = vehicle.limits, vehicle.com_ahead
    rate = min(limits.yaw_rate, grip_acceleration(vehicle) / speed)
    push = min(vehicle.wheel_torque / vehicle.wheel_radius, vehicle.contact.wheel_friction * static_rear_load(vehicle))
    push -= vehicle.rolling_mass * acceleration / 2
    turning = (push * vehicle.track - a * vehicle.mass * speed * rate) / (vehicle.yaw_inertia + vehicle.mass * a * a)
    least = LEAST_SHARE * limits.yaw_acceleration
    return replace(limits, yaw_rate=rate, yaw_acceleration=min(max(turning, least), limits.yaw_acceleration))


def turning_deceleration(vehicle: VehicleSpec, speed: float) -> float:
    """How hard a vehicle still brakes while it turns as `followed_limits` says [m/s2].

    Each drive wheel holds half the side force, within its circle of friction, and one of them its part of what holds
    the turn: what is left brakes.

    Args:
        vehicle: What turns.
        speed: Of the rear-axle centre [m/s].
    """
    side = vehicle.mass * speed * followed_limits(vehicle, speed).yaw_rate
    grip = vehicle.contact.wheel_friction * static_rear_load(vehicle)
    along = sqrt(max(grip * grip - side * side / 4, 0.0))
    push = min(vehicle.wheel_torque / vehicle.wheel_radius, along) - vehicle.com_ahead * side / vehicle.track
    straight = braking(vehicle).deceleration
    return min(max(2 * push / vehicle.rolling_mass, LEAST_BRAKING * straight), straight)


def braking_rear_load(vehicle: VehicleSpec, deceleration: float) -> float:
    """On each drive wheel while braking, over its load at rest."""
    moved = vehicle.mass * deceleration * vehicle.com_height / vehicle.wheelbase / 2
    return 1 - moved / static_rear_load(vehicle)


def _product_of_inertia(vehicle: VehicleSpec) -> float:
    """Sum of m x z about the centre of mass [kg m2]: of the payload, which sits high and ahead.

    The vehicle's own is taken for nothing; the shipped one's is -0.2 kg m2.
    """
    load = vehicle.payload
    if load is None:
        return 0.0
    reduced = load.mass * vehicle.mass / (vehicle.mass - load.mass)
    return reduced * (load.ahead - vehicle.com_ahead) * (load.height - vehicle.com_height)


def _caster_contact(vehicle: VehicleSpec, speed: float, yaw_rate: Array) -> tuple[Array, Array]:
    """Where the caster touches the ground, ahead and to the left of the rear-axle centre (n,) [m].

    Its contact point moves in the wheel's plane: w L' cos(delta) - v sin(delta) = t w, for the swivel axis L' = L + t
    ahead of the axle and the trail t.
    """
    trail, swivel = vehicle.caster_trail, vehicle.wheelbase + vehicle.caster_trail
    across = yaw_rate * swivel
    delta = np.arctan2(across, speed) - np.arcsin(trail * yaw_rate / np.hypot(speed, across))
    return swivel - trail * np.cos(delta), -trail * np.sin(delta)
