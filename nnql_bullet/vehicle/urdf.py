"""Reads a vehicle from its TOML and URDF, and refuses what this package would drive wrongly."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from nnql_bullet import assets
from nnql_bullet.config import options, parse, read_toml
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.sensing import Sensor
from nnql_bullet.vehicle.canonical import canonical, composite, placed_inertia
from nnql_bullet.vehicle.description import LARGEST, Description, Link, Unfit, describe, read, refuse, text_of
from nnql_bullet.vehicle.mechanism import Mechanism, find_mechanism, rounded
from nnql_bullet.vehicle.shapes import Meshes
from nnql_bullet.vehicle.spec import Caster, ContactCoefficients, JointNames, Limits, VehicleSpec
from nnql_bullet.vehicle.stances import margin

FALSE_INERTIA = 0.01
"""Share of the mass of all links up to which the inertia of a link may be one that no body has; it then counts as 0."""


@options
class RobotFile:
    """The keys of a robot's TOML."""

    urdf: str
    """Path of the URDF, in the folder of the TOML or below it."""
    limits: Limits
    contact: ContactCoefficients
    sensor: Sensor
    joints: JointNames | None = None
    """By default the drive wheels are found by their joints and shapes."""


def load_vehicle(vehicle: str | Path | VehicleSpec) -> VehicleSpec:
    """Reads a vehicle from its TOML and URDF.

    Args:
        vehicle: The name of a shipped robot or a path to a TOML file; a vehicle is returned as it is.

    Raises:
        UserError: If either file is missing or malformed, or the URDF describes no vehicle that is driven rightly.
    """
    if isinstance(vehicle, VehicleSpec):
        return vehicle
    name = str(vehicle)
    if Path(name).suffix.lower() in (".urdf", ".xacro"):
        raise UserError(f"{name}: write a TOML for this robot first: nnql-bullet robot {name} --write robot.toml")
    path = assets.find("robots", name)
    robot = parse(RobotFile, read_toml(path), str(path))
    if Path(robot.urdf).is_absolute() or ".." in Path(robot.urdf).parts:
        raise UserError(f"{path}: 'urdf': '{robot.urdf}' leads out of the folder of this file; put the URDF beside it")
    urdf_path = path.parent / robot.urdf
    if not is_file(urdf_path):
        raise UserError(f"{urdf_path}: there is no such URDF; put it beside its TOML, or correct 'urdf' there")
    meshes, source = Meshes(urdf_path), read(urdf_path)
    try:
        mechanism = mechanism_of(source, meshes, robot.joints, needs_effort=robot.limits.wheel_torque is None)
        made = vehicle_of(path.stem, urdf_path, canonical(source, mechanism, meshes), mechanism, robot)
    except Unfit as error:
        raise UserError(f"{urdf_path}: {error}") from None
    return replace(made, source=name)


def collision_meshes(urdf: Path) -> dict[str, Path]:
    """Finds the files of the meshes that a vehicle is as large as, by their names in its URDF."""
    meshes = Meshes(urdf)
    named = [mesh.get("filename", "") for mesh in read(urdf).iterfind("link/collision/geometry/mesh")]
    return {name: file for name in named if (file := meshes.find(name))}


def robot_name(vehicle: str | Path | VehicleSpec) -> str:
    """Returns the name or TOML file of a vehicle, for a configuration.

    Raises:
        UserError: If the vehicle differs from its file or has none.
    """
    if not isinstance(vehicle, VehicleSpec):
        return str(vehicle)
    if not vehicle.source or load_vehicle(vehicle.source) != vehicle:
        raise UserError(f"vehicle '{vehicle.name}' differs from its file; write a TOML file for it")
    return vehicle.source


def mechanism_of(source: Element, meshes: Meshes, joints: JointNames | None, needs_effort: bool = False) -> Mechanism:
    """Finds what drives a vehicle, and checks that it is what its TOML says.

    Raises:
        Unfit: If it cannot be driven.
    """
    urdf = describe(source)
    drives = (joints.left_drive, joints.right_drive) if joints else None
    problems = list(_check_masses(urdf))
    try:
        found = find_mechanism(urdf, meshes, drives)
    except Unfit as error:
        raise Unfit(*problems, *error.problems) from None
    if needs_effort:
        problems += _check_efforts(found)
    if joints:
        if found.left.joint != joints.left_drive:
            problems.append("the left drive wheel is not to the left of the right one; swap the joints in the TOML")
        casters = {(caster.swivel, caster.wheel.joint) for caster in found.casters if caster.fork}
        told = (joints.swivel, joints.caster_roll)
        if told != ("", "") and told not in casters:
            there = ", ".join(f"'{swivel}' with '{roll}'" for swivel, roll in sorted(casters)) or "none"
            problems.append(
                f"'{told[1]}' (joints.caster_roll) is no wheel that trails the swivel '{told[0]}' (joints.swivel); "
                f"such casters are: {there}"
            )
    refuse(problems)
    return found


def vehicle_of(name: str, path: Path, written: Element, mechanism: Mechanism, robot: RobotFile) -> VehicleSpec:
    """Makes the record of a vehicle.

    Args:
        name: Its name.
        path: Its URDF.
        written: The URDF in the form that is loaded.
        mechanism: What drives it.
        robot: What its TOML says.

    Raises:
        Unfit: If it would not stand.
    """
    urdf = describe(written)
    bodies = [placed_inertia(link, urdf.frames[link.name]) for link in urdf.links.values()]
    mass, com, inertia = composite(bodies)
    left, right = mechanism.left, mechanism.right
    wheel = left.radius
    middle, half = mechanism.box
    at = np.asarray(robot.sensor.position)
    sensor = mechanism.frame[:3, :3] @ at + mechanism.frame[:3, 3]
    efforts = [mechanism.urdf.joints[its.joint].effort for its in (left, right)]
    torque = robot.limits.wheel_torque or min(effort or 0.0 for effort in efforts)
    casters = tuple(_caster(urdf, mechanism, number) for number in range(len(mechanism.casters)))
    swivelling = [its for its in mechanism.casters if its.fork]
    joints, links = {"left_drive": left.joint, "right_drive": right.joint}, {}
    for number, caster in enumerate(swivelling, 1):
        end = f"_{number}" if number > 1 else ""
        joints |= {f"swivel{end}": caster.swivel, f"caster_roll{end}": caster.wheel.joint}
    links = {key: urdf.joints[joint].child for key, joint in joints.items()}
    vehicle = VehicleSpec(
        name=name,
        urdf=path,
        description=text_of(written),
        joints=joints,
        links=links,
        limits=robot.limits,
        contact=robot.contact,
        sensor=replace(robot.sensor, position=(float(sensor[0]), float(sensor[1]), float(sensor[2]))),
        footprint=OrientedBox(float(middle[0]), float(middle[1]), float(half[0]), float(half[1])),
        mass=mass,
        com_ahead=float(com[0]),
        com_left=float(com[1]),
        com_height=float(com[2]) + wheel,
        yaw_inertia=float(inertia[2, 2]),
        track=float(left.part.origin[1] - right.part.origin[1]),
        wheel_radius=wheel,
        casters=casters,
        wheel_spin_inertia=_spin_inertia(urdf, left.part.name),
        wheel_torque=torque,
    )
    refuse([*_check_balance(vehicle), *_check_heights(vehicle, mechanism)])
    return vehicle


def _caster(urdf: Description, mechanism: Mechanism, number: int) -> Caster:
    caster = mechanism.casters[number]
    wheel = caster.wheel
    x, y, _ = wheel.part.origin.tolist()
    if not caster.fork:
        return Caster(wheel.part.name, x, y, wheel.radius)
    spin = _spin_inertia(urdf, wheel.part.name)
    return Caster(wheel.part.name, x, y, wheel.radius, caster.trail, spin, caster.swivel, wheel.joint)


def _spin_inertia(urdf: Description, link: str) -> float:
    """Computes the moment of inertia of a wheel about the axis y of its frame [kg m2]."""
    wheel = urdf.links[link]
    axis = wheel.centre[:3, :3].T @ np.array([0.0, 1.0, 0.0])
    return float(axis @ np.asarray(wheel.inertia) @ axis)


def _check_efforts(mechanism: Mechanism) -> Iterator[str]:
    """Checks that the drives have a torque limit."""
    efforts = [mechanism.urdf.joints[its.joint].effort or 0.0 for its in (mechanism.left, mechanism.right)]
    if not all(0 < effort < inf for effort in efforts):
        names = f"'{mechanism.left.joint}' and '{mechanism.right.joint}'"
        yield f"the drive joints {names} have no <limit effort>; give it in N m, or limits.wheel_torque in the TOML"


def _check_balance(vehicle: VehicleSpec) -> Iterator[str]:
    """Checks that the vehicle stands on its wheels."""
    inside = margin(np.array(vehicle.contacts), vehicle.com_ahead, vehicle.com_left)
    if inside <= 0:
        ends = vehicle.stance
        yield (
            f"the vehicle would tip over: its centre of mass is at x = {vehicle.com_ahead:.4g}, y = "
            f"{vehicle.com_left:.4g} m of the drive axle, and it stands on x = {-ends.behind:.4g} to "
            f"{ends.ahead:.4g} m: {', '.join(str(rounded(np.array(at))) for at in vehicle.contacts)}"
        )
    elif not 0 < (share := vehicle.rear_share) <= 1 + 1e-9:
        yield f"its drive wheels would carry {100 * share:.0f} % of the weight, which is not between 0 and 100 %"


def _check_heights(vehicle: VehicleSpec, mechanism: Mechanism) -> Iterator[str]:
    """Checks that nothing is under the ground, and that an obstacle which reaches up to the sensor meets the box."""
    middle, half = mechanism.box
    low, high = (float(middle[2] + side * half[2]) + vehicle.wheel_radius for side in (-1, 1))
    if vehicle.com_height <= 0:
        yield f"the centre of mass is under the ground, at a height of {vehicle.com_height:.4g} m"
    if vehicle.sensor_height <= 0:
        yield f"sensor.position in the TOML is under the ground, at a height of {vehicle.sensor_height:.4g} m"
    if high <= 0 or low >= vehicle.sensor_height:
        yield (
            f"the body is between the heights {low:.4g} and {high:.4g} m, so that obstacles that the sensor sees at "
            f"{vehicle.sensor_height:.4g} m may not touch it"
        )


def _check_masses(urdf: Description) -> Iterator[str]:
    """Checks that links have masses and inertias that bodies can have."""
    total = sum(link.mass or 0.0 for link in urdf.links.values())
    if total <= 0:
        yield "no link has a mass; give each an <inertial>"
        return
    for link in urdf.links.values():
        if link.mass is not None and not 0 <= link.mass <= LARGEST:
            yield f"link '{link.name}' has a mass of {link.mass:g} kg; give it one above 0"
        elif link.mass and link.mass > FALSE_INERTIA * total:
            yield from _check_inertia(link)


def _check_inertia(link: Link) -> Iterator[str]:
    if link.inertia is None:
        yield f"link '{link.name}' has a mass of {link.mass:g} kg and no inertia; give it one"
        return
    least, middle, largest = np.linalg.eigvalsh(link.inertia)
    if least <= 0:
        yield f"link '{link.name}' has an inertia that is not positive: its least moment is {least:.4g} kg m2"
    elif largest > (least + middle) * (1 + 1e-12):  # PyBullet sets such an inertia to zero
        yield (
            f"link '{link.name}' has an inertia that no body has: its largest moment, {largest:.4g} kg m2, is more "
            f"than both others together, {least:.4g} and {middle:.4g}"
        )
