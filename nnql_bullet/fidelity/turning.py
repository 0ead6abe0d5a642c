"""One turn in contact physics, watched at every physics step: where the wheels slip, and with how much force."""

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

Forces = tuple[ContactForce, ContactForce, ContactForce]

LOADED = 0.05
"""Share of its load at rest below which a drive wheel's use of friction means nothing."""


@dataclass(frozen=True, slots=True)
class Instant:
    """The vehicle after one physics step."""

    time: float
    """Since the turn began [s]."""
    pose: Pose
    roll: float
    """Of the drive axle out of the level, positive with the left wheel up [rad]."""
    forces: Forces
    """Of the ground on the left, right and caster wheel, during the step."""
    slips: tuple[float, float]
    """Speed of the left and right drive wheel's contact point over the ground, during the step [m/s]."""


def follow_turn(engine: ContactEngine, heading_change: float) -> list[Instant]:
    """Advances by one control period, and takes down the vehicle after each physics step.

    Args:
        engine: With the vehicle placed in its world.
        heading_change: Wanted change from the present yaw [rad], positive to the left.
    """
    begin, began = engine.pose(), engine.time()
    instants: list[Instant] = []

    def look() -> None:
        instants.append(_observed(engine, instants[-1].pose if instants else begin, began))

    engine.advance(heading_change, look=look)
    return instants


@dataclass(frozen=True, slots=True)
class WheelForces:
    """Of the ground on the left, right and caster wheel: k means over one or more wheel commands each.

    Commands come at a stroke, 120 a second, and an engine gives the force of a whole command in one physics step, or
    lets a wheel drop out for one. A turn needs what lasts; single steps are that staircase.
    """

    times: Array
    """At the end of each (k,) [s]."""
    normal: Array
    """(k, 3) [N]"""
    friction: Array
    """In the plane of contact (k, 3) [N]."""

    def used(self, vehicle: VehicleSpec) -> Array:
        """Friction over what there is, of each drive wheel (k, 2); 0 where it carries next to nothing."""
        normal, friction = self.normal[:, :2], self.friction[:, :2]
        carries = normal > LOADED * static_rear_load(vehicle)
        available = vehicle.contact.wheel_friction * np.where(carries, normal, np.inf)
        return np.asarray(friction / available)

    def used_by_axle(self, vehicle: VehicleSpec) -> Array:
        """Friction over what there is, of both drive wheels together (k,)."""
        normal, friction = self.normal[:, :2].sum(axis=1), self.friction[:, :2].sum(axis=1)
        least = LOADED * static_rear_load(vehicle)
        return np.asarray(friction / (vehicle.contact.wheel_friction * np.maximum(normal, least)))


def mean_forces(times: Sequence[float], forces: Sequence[Forces], commands: int) -> WheelForces:
    """Means over so many wheel commands each; the last one may be cut short.

    Args:
        times: At the end of each physics step, from the first one on [s].
        forces: During each physics step.
        commands: In each mean; `SAMPLE_EVERY` of them lie between two looks of the controller.
    """
    steps = whole_steps(commands / COMMAND_RATE, times[0])
    begins = np.arange(0, len(times), steps)
    ends = np.append(begins[1:], len(times))
    values = np.array([[(force.normal, force.friction) for force in step] for step in forces])
    means = np.add.reduceat(values, begins) / (ends - begins)[:, None, None]
    return WheelForces(np.asarray(times)[ends - 1], means[..., 0], means[..., 1])


def forces_by_command(instants: Sequence[Instant], commands: int = 1) -> WheelForces:
    """The `mean_forces` of a turn that was followed, from its first instant on."""
    return mean_forces([instant.time for instant in instants], [instant.forces for instant in instants], commands)


def largest_slip(instants: Sequence[Instant], speed: float) -> float:
    """The largest speed of a drive wheel's contact point over the ground, over the vehicle's speed [m/s]."""
    return max(max(instant.slips) for instant in instants) / speed


def _observed(engine: ContactEngine, before: Pose, began: float) -> Instant:
    """What a physics step did, given where it began.

    The velocity of the rear-axle centre is the way from there to here; it points along the chord.
    """
    vehicle, dt, pose = engine.vehicle, engine.time_step, engine.pose()
    turned = wrap_angle(pose.yaw - before.yaw)
    heading, dx, dy = before.yaw + turned / 2, pose.x - before.x, pose.y - before.y
    ahead, aside = (dx * cos(heading) + dy * sin(heading)) / dt, (dy * cos(heading) - dx * sin(heading)) / dt
    from_turning = turned / dt * vehicle.track / 2
    left, right = (vehicle.wheel_radius * speed for speed in engine.wheel_speeds())
    left_height, right_height, _ = engine.wheel_heights()
    return Instant(
        time=engine.time() - began,
        pose=pose,
        roll=asin(min(max((left_height - right_height) / vehicle.track, -1.0), 1.0)),
        forces=engine.wheel_forces(),
        slips=(hypot(ahead - from_turning - left, aside), hypot(ahead + from_turning - right, aside)),
    )
