"""Measures a turn in contact physics at every physics step: pose, roll, wheel forces and wheel slip."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import asin, cos, hypot, sin

import numpy as np

from nnql_bullet.geometry import Array, Pose, wrap_angle
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.sim.physics import ContactForce
from nnql_bullet.vehicle.controller import COMMAND_RATE, whole_steps
from nnql_bullet.vehicle.limits import static_rear_load
from nnql_bullet.vehicle.spec import VehicleSpec

Forces = tuple[ContactForce, ...]

LOADED = 0.05
"""Load of a drive wheel, over its load at rest, below which its used friction counts as zero."""


@dataclass(frozen=True, slots=True)
class Instant:
    """The vehicle after one physics step."""

    time: float
    """Time since the turn began [s]."""
    pose: Pose
    roll: float
    """Roll angle of the drive axle, positive with the left wheel up [rad]."""
    forces: Forces
    """Forces of the ground on the left and right wheel and on each caster during the step."""
    slips: tuple[float, float]
    """Speeds of the left and right drive wheel's contact points over the ground during the step [m/s]."""


def follow_turn(engine: ContactEngine, heading_change: float) -> list[Instant]:
    """Advances by one control period and records the vehicle after each physics step.

    Args:
        engine: The engine, with the vehicle in its world.
        heading_change: Commanded change of the present yaw, positive to the left [rad].
    """
    begin, began = engine.pose(), engine.time()
    instants: list[Instant] = []

    def look() -> None:
        instants.append(_observed(engine, instants[-1].pose if instants else begin, began))

    engine.advance(heading_change, look=look)
    return instants


@dataclass(frozen=True, slots=True)
class WheelForces:
    """Mean forces of the ground on left and right wheel and n - 2 casters over k intervals of wheel commands.

    An engine may apply the force of a whole wheel command in a single physics step, so means over commands count.
    """

    times: Array
    """Ends of the intervals (k,) [s]."""
    normal: Array
    """Forces normal to the contact plane (k, n) [N]."""
    friction: Array
    """Forces in the contact plane (k, n) [N]."""

    def used(self, vehicle: VehicleSpec) -> Array:
        """Computes used over available friction of each drive wheel (k, 2); 0 where it carries almost no load."""
        normal, friction = self.normal[:, :2], self.friction[:, :2]
        carries = normal > LOADED * static_rear_load(vehicle)
        available = vehicle.contact.wheel_friction * np.where(carries, normal, np.inf)
        return np.asarray(friction / available)

    def used_by_axle(self, vehicle: VehicleSpec) -> Array:
        """Computes used over available friction of both drive wheels together (k,)."""
        normal, friction = self.normal[:, :2].sum(axis=1), self.friction[:, :2].sum(axis=1)
        least = LOADED * static_rear_load(vehicle)
        return np.asarray(friction / (vehicle.contact.wheel_friction * np.maximum(normal, least)))


def mean_forces(times: Sequence[float], forces: Sequence[Forces], commands: int) -> WheelForces:
    """Averages forces over intervals of `commands` wheel commands; the last interval may be shorter.

    Args:
        times: Ends of the physics steps [s].
        forces: Forces during the physics steps.
        commands: Wheel commands in each interval; the controller's period has `SAMPLE_EVERY`.
    """
    steps = whole_steps(commands / COMMAND_RATE, times[0])
    begins = np.arange(0, len(times), steps)
    ends = np.append(begins[1:], len(times))
    values = np.array([[(force.normal, force.friction) for force in step] for step in forces])
    means = np.add.reduceat(values, begins) / (ends - begins)[:, None, None]
    return WheelForces(np.asarray(times)[ends - 1], means[..., 0], means[..., 1])


def forces_by_command(instants: Sequence[Instant], commands: int = 1) -> WheelForces:
    """Computes the `mean_forces` of a turn."""
    return mean_forces([instant.time for instant in instants], [instant.forces for instant in instants], commands)


def largest_slip(instants: Sequence[Instant], speed: float) -> float:
    """Finds the largest speed of a drive wheel's contact point over the ground, over the vehicle's speed."""
    return max(max(instant.slips) for instant in instants) / speed


def _observed(engine: ContactEngine, before: Pose, began: float) -> Instant:
    """Measures the physics step that began at the pose `before`.

    The displacement in the step, along its chord, gives the velocity of the rear-axle centre.
    """
    vehicle, dt, pose = engine.vehicle, engine.time_step, engine.pose()
    turned = wrap_angle(pose.yaw - before.yaw)
    heading, dx, dy = before.yaw + turned / 2, pose.x - before.x, pose.y - before.y
    ahead, aside = (dx * cos(heading) + dy * sin(heading)) / dt, (dy * cos(heading) - dx * sin(heading)) / dt
    from_turning = turned / dt * vehicle.track / 2
    left, right = (vehicle.wheel_radius * speed for speed in engine.wheel_speeds())
    left_height, right_height, *_ = engine.wheel_heights()
    return Instant(
        time=engine.time() - began,
        pose=pose,
        roll=asin(min(max((left_height - right_height) / vehicle.track, -1.0), 1.0)),
        forces=engine.wheel_forces(),
        slips=(hypot(ahead - from_turning - left, aside), hypot(ahead + from_turning - right, aside)),
    )
