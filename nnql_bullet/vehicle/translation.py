"""Translates the URDF or xacro of any robot that drives by two wheels into files that this package reads.

What a URDF does not say follows from the shipped vehicle by scale: a robot of half its size drives at half its speed,
so that it turns and stops in the same times. Grip, tipping and the drives' torque bound that, each by half.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from nnql_bullet import paper
from nnql_bullet.constants import GRAVITY
from nnql_bullet.errors import UserError
from nnql_bullet.files import real, write_text
from nnql_bullet.sensing import Sensor
from nnql_bullet.vehicle.canonical import canonical
from nnql_bullet.vehicle.controller import own_speed
from nnql_bullet.vehicle.description import Unfit, parse, read, text_of
from nnql_bullet.vehicle.limits import grip_acceleration, static_rear_load, tip_acceleration
from nnql_bullet.vehicle.mechanism import Mechanism
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.shapes import Meshes
from nnql_bullet.vehicle.spec import ContactCoefficients, JointNames, Limits, VehicleSpec
from nnql_bullet.vehicle.stances import loads_at_rest
from nnql_bullet.vehicle.urdf import RobotFile, mechanism_of, vehicle_of
from nnql_bullet.vehicle.xacros import expand

YAW_RATE, YAW_ACCELERATION, ACCELERATION = 1.5708, 7.4, 2.5
"""Limits of the shipped vehicle [rad/s, rad/s2, m/s2]."""
WHEEL_FRICTION, ROLLING, SPINNING = 0.8, 0.016, 0.04
"""Its friction, and the lever arms of resistance over the wheel radius."""
RESERVE = 0.5
"""Share of what grip, balance and torque allow."""
LEAST_EFFORT = 1e-3
"""Torque limits below this mean that the URDF states none [N m]."""

PLACEHOLDER, WITH_MOTOR = 0.002, 0.015
"""Inertia of a drive wheel over the vehicle's mass at the wheel's radius: that below which no driven wheel is, and what
is taken in its place. The shipped vehicle's is a fortieth. A rotor counts by the square of its gear."""


@dataclass(frozen=True, slots=True)
class Translation:
    """A robot in the form that this package reads."""

    vehicle: VehicleSpec
    mechanism: Mechanism
    urdf: str
    """Text of its URDF in that form."""
    notes: tuple[str, ...]
    """What was assumed, in sentences."""

    def record(self) -> dict[str, Any]:
        """Returns what is known of the robot, for JSON [m, kg, s, rad]."""
        vehicle = self.vehicle
        box = vehicle.footprint
        return {
            "name": vehicle.name,
            "track": vehicle.track,
            "wheel_radius": vehicle.wheel_radius,
            "mass": vehicle.mass,
            "centre_of_mass": [vehicle.com_ahead, vehicle.com_left, vehicle.com_height],
            "footprint": {"x": box.x, "y": box.y, "length": 2 * box.half_length, "width": 2 * box.half_width},
            "drive_wheels_share": vehicle.rear_share,
            "joints": vehicle.joints,
            "casters": [asdict(caster) for caster in vehicle.casters],
            "limits": asdict(vehicle.limits),
            "wheel_torque": vehicle.wheel_torque,
            "sensor": list(vehicle.sensor.position),
            "notes": list(self.notes),
        }

    def table(self) -> str:
        """Says what was read, for reading."""
        vehicle, box = self.vehicle, self.vehicle.footprint
        kinds = ["swivels" if its.swivels else "slides" for its in vehicle.casters]
        places = "; ".join(
            f"{kind} at {its.x:.3f}, {its.y:.3f}" for kind, its in zip(kinds, vehicle.casters, strict=True)
        )
        rows = (
            ("drive wheels", f"{vehicle.joints['left_drive']}, {vehicle.joints['right_drive']}"),
            ("track, wheel radius", f"{vehicle.track:.4g}, {vehicle.wheel_radius:.4g} m"),
            ("casters", f"{len(kinds)}: {places} m of the middle of the drive axle"),
            (
                "footprint",
                f"{2 * box.half_length:.3f} x {2 * box.half_width:.3f} m around ({box.x:.3f}, {box.y:.3f}), the "
                "rectangle around all that sticks out",
            ),
            ("mass", f"{vehicle.mass:.4g} kg, {100 * vehicle.rear_share:.0f} % on the drive wheels"),
            (
                "centre of mass",
                f"{vehicle.com_ahead:.4f} m ahead, {vehicle.com_left:.4f} m left, {vehicle.com_height:.4f} m high",
            ),
            ("speed", f"{own_speed(vehicle):.3g} m/s, {vehicle.limits.acceleration:.3g} m/s2"),
            ("turning", f"{vehicle.limits.yaw_rate:.3g} rad/s, {vehicle.limits.yaw_acceleration:.3g} rad/s2"),
            ("wheel torque", f"{vehicle.wheel_torque:.3g} N m"),
        )
        return "\n".join([*(f"{name:<20} {value}" for name, value in rows), *(f"- {note}" for note in self.notes)])

    def toml(self, urdf: str) -> str:
        """Writes the text of its TOML.

        Args:
            urdf: Name of its URDF.
        """
        vehicle, joints = self.vehicle, self.vehicle.joints
        limits, contact = vehicle.limits, vehicle.contact
        torque = f"wheel_torque = {limits.wheel_torque:.4g}  # [N m]\n" if limits.wheel_torque else ""
        x, y, z = (round(value, 4) + 0.0 for value in vehicle.sensor.position)
        return (
            f"# {vehicle.name}, translated; the limits are those of the shipped vehicle, scaled by its size.\n"
            f"urdf = {_quoted(urdf)}\n\n"
            f"[joints]\nleft_drive = {_quoted(joints['left_drive'])}\n"
            f"right_drive = {_quoted(joints['right_drive'])}\n\n"
            f"[limits]\nspeed = {limits.speed:.4g}  # [m/s]\nyaw_rate = {limits.yaw_rate:.4g}  # [rad/s]\n"
            f"yaw_acceleration = {limits.yaw_acceleration:.4g}  # [rad/s2]\n"
            f"acceleration = {limits.acceleration:.4g}  # [m/s2]\n{torque}\n"
            f"[contact]\nwheel_friction = {contact.wheel_friction:.4g}\n"
            f"rolling_friction = {contact.rolling_friction:.4g}  # [m]\n"
            f"spinning_friction = {contact.spinning_friction:.4g}  # [m]\n"
            f"ball_friction = {contact.ball_friction:.4g}  # of casters that do not swivel\n\n"
            f"[sensor]\nposition = [{x}, {y}, {z}]  # [m] in the middle of the drive axle\n"
        )

    def save(self, path: Path | str) -> tuple[Path, Path]:
        """Writes a TOML and, beside it, the URDF that it names.

        Raises:
            UserError: If the file does not end in .toml, or the URDF would take the place of the one that was read.
            OSError: If they cannot be written.
        """
        toml = Path(path)
        if toml.suffix != ".toml":
            raise UserError(f"{toml}: a robot's file ends in .toml")
        urdf = toml.with_suffix(".vehicle.urdf")
        if real(urdf) == real(self.vehicle.urdf):
            raise UserError(f"{urdf}: would be written over the robot that is read; give another name with --write")
        toml.parent.mkdir(parents=True, exist_ok=True)
        write_text(urdf, self.urdf + "\n")
        write_text(toml, self.toml(urdf.name))
        return toml, urdf


def read_robot(path: Path | str, arguments: Mapping[str, str] = MappingProxyType({})) -> Translation:
    """Reads the URDF or xacro of a robot.

    Args:
        path: The file.
        arguments: Values of the arguments of a xacro by name, in place of its own.

    Raises:
        UserError: If it cannot be read, or cannot be driven; the message names all problems.

    Example:
        >>> import nnql_bullet as nb
        >>> found = nb.read_robot(nb.Vehicle.load("tricycle").urdf)  # or the path of your own
        >>> found.vehicle.track
        0.6
        >>> toml, urdf = found.save("mine.toml")
        >>> nb.drive("straight", world="empty", simulator="kinematic", changes={"robot": str(toml)}).summary.ending
        'goal'
    """
    path = Path(path)
    meshes, (source, warned) = Meshes(path), _source(path, arguments)
    try:
        mechanism = mechanism_of(source, meshes, None)
        written = canonical(source, mechanism, meshes)
        frictions = [its.friction for its in mechanism.casters if its.fork is None and its.friction is not None]
        radius = mechanism.left.radius
        ball = max(frictions) if frictions else ContactCoefficients.__dataclass_fields__["ball_friction"].default
        contact = ContactCoefficients(
            wheel_friction=WHEEL_FRICTION,
            rolling_friction=ROLLING * radius,
            spinning_friction=SPINNING * radius,
            ball_friction=min(ball, WHEEL_FRICTION),
        )
        joints = JointNames(left_drive=mechanism.left.joint, right_drive=mechanism.right.joint)
        at = mechanism.frame[:3, :3].T @ (mechanism.sensor - mechanism.frame[:3, 3])
        sensor = Sensor(position=(float(at[0]), float(at[1]), float(at[2])))
        told = [mechanism.urdf.joints[its.joint].effort or 0.0 for its in (mechanism.left, mechanism.right)]
        torque = None if min(told) > LEAST_EFFORT else 1.0  # until it is known what is needed
        unbound = Limits(
            yaw_rate=YAW_RATE, yaw_acceleration=YAW_ACCELERATION, acceleration=ACCELERATION, wheel_torque=torque
        )
        robot = RobotFile(urdf=path.name, limits=unbound, contact=contact, sensor=sensor, joints=joints)
        vehicle = vehicle_of(_name(path), path, written, mechanism, robot)
        rotors = _add_rotors(written, vehicle)
        if rotors:
            vehicle = vehicle_of(_name(path), path, written, mechanism, robot)
    except Unfit as error:
        raise UserError(f"{path}: {error}") from None
    limits, notes = suitable_limits(vehicle, mechanism, unbound.wheel_torque is None)
    vehicle = replace(vehicle, limits=limits, wheel_torque=limits.wheel_torque or vehicle.wheel_torque)
    return Translation(vehicle, mechanism, text_of(written), (*warned, *mechanism.notes, *rotors, *notes))


def _add_rotors(written: Element, vehicle: VehicleSpec) -> list[str]:
    """Gives drive wheels that spin too easily the inertia of a motor behind its gear, as a vehicle has it.

    Many files have placeholders. A motor would change the speed of such a wheel more than a thousand times as fast as
    the vehicle's, which PyBullet's solver does not settle.

    Returns:
        What was changed, in words.
    """
    spin, carried = vehicle.wheel_spin_inertia, vehicle.mass * vehicle.wheel_radius**2
    if spin >= PLACEHOLDER * carried:
        return []
    taken = WITH_MOTOR * carried
    driven = (vehicle.joints["left_drive"], vehicle.joints["right_drive"])
    children = {joint.get("name"): joint.find("child") for joint in written.findall("joint")}
    names = {child.get("link") for name in driven if (child := children[name]) is not None}
    for link in written.findall("link"):
        moments = link.find("inertial/inertia")
        if link.get("name") in names and moments is not None:
            for key in ("ixx", "iyy", "izz"):
                moments.set(key, repr(float(moments.attrib[key]) + taken - spin))
    return [
        f"the drive wheels' inertia, {spin:.3g} kg m2, is that of no wheel with a motor; {taken:.3g} is taken, "
        f"{100 * WITH_MOTOR:g} % of the vehicle's mass at their radius"
    ]


def _source(path: Path, arguments: Mapping[str, str]) -> tuple[Element, list[str]]:
    """Reads a URDF, or a xacro after expanding it; returns what xacro warned of too.

    Raises:
        UserError: If it cannot be read or expanded.
    """
    if path.suffix.lower() != ".xacro":
        if arguments:
            raise UserError(f"{path}: arguments are for xacros; this file ends in {path.suffix or 'nothing'}")
        return read(path), []
    text, warned = expand(path, arguments)
    try:
        return parse(text), [f"xacro: {line}" for line in warned]
    except Unfit as error:
        raise UserError(f"{path}: {error}") from None


def suitable_limits(vehicle: VehicleSpec, mechanism: Mechanism, torque_told: bool) -> tuple[Limits, list[str]]:
    """Computes limits within which a vehicle follows its commands, and says where they come from."""
    scale = min(length_scale(vehicle.footprint), 1.0)
    told = [mechanism.urdf.joints[its.joint].velocity or inf for its in (mechanism.left, mechanism.right)]
    own = min(rate * vehicle.wheel_radius for rate in told) if min(told) > LEAST_EFFORT else inf
    speed = min(paper.SPEED * scale, max(own - YAW_RATE * vehicle.track / 2, RESERVE * own) if own < inf else inf)
    notes = [f"limits are those of the shipped vehicle, scaled by its size, {scale:.3g}"]
    stance, height, a = vehicle.stance, vehicle.com_height, vehicle.com_ahead
    friction, share = vehicle.contact.wheel_friction, vehicle.rear_share
    backwards, forwards = (a + stance.behind) / height, (stance.ahead - a) / height
    grip = friction * share / (1 + friction * height / abs(stance.wheelbase))
    acceleration = min(ACCELERATION * scale, RESERVE * GRAVITY * min(backwards, forwards, grip))
    sideways = RESERVE * min(tip_acceleration(vehicle), grip_acceleration(vehicle))
    rate = min(YAW_RATE, sideways / speed)
    spare = RESERVE * friction * static_rear_load(vehicle)
    drag = (
        vehicle.contact.ball_friction
        * vehicle.mass
        * GRAVITY
        * sum(
            share * np.hypot(its.x, its.y)
            for its, share in zip(vehicle.casters, loads_at_rest(vehicle)[2:].tolist(), strict=True)
            if not its.swivels
        )
    )
    inertia = vehicle.yaw_inertia + vehicle.mass * a * a
    turning = abs(a) * vehicle.mass * speed * rate
    by_grip = (spare * vehicle.track - turning - drag) / inertia
    least = 0.1 * YAW_ACCELERATION
    held, needed = spare * vehicle.track / RESERVE, turning + drag + inertia * least
    if held < needed:
        notes.append(
            f"its wheels slip in turns: its drive wheels carry {100 * share:.0f} % of the weight and hold "
            f"{held:.3g} N m about the vertical, and a gentle turn needs {needed:.3g} N m, of which casters that slide "
            f"take {drag:.3g}; put more weight on the drive wheels, or lower contact.ball_friction if it is less"
        )
    yaw_acceleration = max(min(YAW_ACCELERATION, by_grip), least)
    if torque_told:
        push = RESERVE * vehicle.wheel_torque / vehicle.wheel_radius
        acceleration = min(acceleration, 2 * push / vehicle.rolling_mass)
        by_torque = (push * vehicle.track - turning - drag) / inertia
        yaw_acceleration = max(min(yaw_acceleration, by_torque), least)
        return _limits(rate, yaw_acceleration, acceleration, speed), notes
    force = max(vehicle.rolling_mass * acceleration / 2, (inertia * yaw_acceleration + turning + drag) / vehicle.track)
    torque = force * vehicle.wheel_radius / RESERVE
    notes.append(f"the drive joints state no effort; {torque:.3g} N m are twice what its limits need")
    return _limits(rate, yaw_acceleration, acceleration, speed, torque), notes


def _limits(
    yaw_rate: float, yaw_acceleration: float, acceleration: float, speed: float, torque: float | None = None
) -> Limits:
    return Limits(
        yaw_rate=float(yaw_rate),
        yaw_acceleration=float(yaw_acceleration),
        acceleration=float(acceleration),
        speed=float(speed),
        wheel_torque=None if torque is None else float(torque),
    )


def _name(path: Path) -> str:
    return path.name.split(".")[0]


def _quoted(text: str) -> str:
    """Writes a name as TOML has it."""
    return json.dumps(text, ensure_ascii=False)
