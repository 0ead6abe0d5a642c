"""Reads a vehicle from its TOML and URDF."""

import logging
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from nnql_bullet import assets
from nnql_bullet.config import options, parse, read_toml
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.vehicle.spec import ContactCoefficients, JointNames, Limits, SensorMount, VehicleSpec


@options
class RobotFile:
    """The keys of a robot's TOML."""

    urdf: str
    """Path of the URDF, relative to the TOML."""
    joints: JointNames
    limits: Limits
    contact: ContactCoefficients
    sensor: SensorMount


def load_vehicle(vehicle: str | Path | VehicleSpec) -> VehicleSpec:
    """Reads a vehicle from its TOML and URDF.

    Args:
        vehicle: The name of a shipped robot or a path to a TOML file; a vehicle is returned as it is.

    Raises:
        UserError: If either file is missing or malformed, or the URDF has not two driven wheels and a caster.
    """
    if isinstance(vehicle, VehicleSpec):
        return vehicle
    name = str(vehicle)
    path = assets.find("robots", name)
    robot = parse(RobotFile, read_toml(path), str(path))
    urdf_path = path.parent / robot.urdf
    urdf = _load_urdf(urdf_path)
    try:
        return replace(_spec(path.stem, urdf_path, robot, urdf), source=name)
    except _Unfit as error:
        raise UserError(f"{urdf_path}: {error}") from None


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


class _Unfit(Exception):
    """The URDF does not describe a vehicle that this package can drive; the text names the change needed."""


def _load_urdf(path: Path) -> Any:
    if not path.is_file():
        raise UserError(f"{path}: there is no such URDF; put it beside its TOML, or correct 'urdf' there")
    import yourdfpy  # here because worker processes, which receive a VehicleSpec, do not need its memory

    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)
    try:
        ElementTree.parse(path)  # yourdfpy silently repairs broken XML
        return yourdfpy.URDF.load(str(path), load_meshes=False, load_collision_meshes=False)
    except Exception as error:  # yourdfpy passes on all errors of its parsers
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(f"{path}: cannot be read as a URDF: {reason}") from None


def _spec(name: str, path: Path, robot: RobotFile, urdf: Any) -> VehicleSpec:
    names = {field: getattr(robot.joints, field) for field in JointNames.__annotations__}
    for field, joint in names.items():
        if joint not in urdf.joint_map:
            there = ", ".join(urdf.joint_map)
            raise _Unfit(f"has no joint '{joint}' (joints.{field}); its joints are: {there}")
        if urdf.joint_map[joint].type != "continuous":
            raise _Unfit(f"joint '{joint}' is {urdf.joint_map[joint].type}; make it continuous")
        axis = (0.0, 0.0, 1.0) if field == "swivel" else (0.0, 1.0, 0.0)
        if not np.allclose(urdf.joint_map[joint].axis, axis):
            raise _Unfit(f"joint '{joint}' must have the axis {axis}, so that a positive speed rolls ahead")
    links = {field: urdf.joint_map[joint].child for field, joint in names.items()}
    at = {field: urdf.get_transform(link)[:3, 3] for field, link in links.items()}
    radius = {field: _sphere_radius(urdf, link) for field, link in links.items() if field != "swivel"}
    if abs(radius["left_drive"] - radius["right_drive"]) > 1e-9:
        raise _Unfit("the drive wheels differ in radius")
    if at["left_drive"][1] <= at["right_drive"][1]:
        raise _Unfit("the left drive wheel is not to the left of the right one; swap the joints in the TOML")
    if at["caster_roll"][0] >= at["swivel"][0]:
        raise _Unfit("the caster wheel does not trail its swivel; put its centre behind the swivel axis")
    efforts = [_effort(urdf, names[field]) for field in ("left_drive", "right_drive")]
    mass, com, inertia = _composite(urdf)
    wheel = radius["left_drive"]
    return VehicleSpec(
        name=name,
        urdf=path,
        joints=robot.joints,
        links=links,
        limits=robot.limits,
        contact=robot.contact,
        sensor=robot.sensor.position,
        footprint=_footprint(urdf),
        mass=mass,
        com_ahead=float(com[0]),
        com_height=float(com[2]) + wheel,
        yaw_inertia=float(inertia[2, 2]),
        track=float(at["left_drive"][1] - at["right_drive"][1]),
        wheelbase=float(at["caster_roll"][0]),
        wheel_radius=wheel,
        caster_radius=radius["caster_roll"],
        caster_trail=float(at["swivel"][0] - at["caster_roll"][0]),
        wheel_spin_inertia=float(urdf.link_map[links["left_drive"]].inertial.inertia[1, 1]),
        caster_spin_inertia=float(urdf.link_map[links["caster_roll"]].inertial.inertia[1, 1]),
        wheel_torque=min(efforts),
    )


def _composite(urdf: Any) -> tuple[float, Any, Any]:
    """Computes mass, centre of mass and inertia about it of all links together (parallel-axis theorem)."""
    parts = []
    for link in urdf.link_map.values():
        inertial = link.inertial
        if inertial is None or inertial.mass is None or inertial.inertia is None:
            raise _Unfit(f"link '{link.name}' has no mass and inertia; give it an <inertial>")
        if not inertial.mass > 0 or np.any(np.linalg.eigvalsh(inertial.inertia) <= 0):
            raise _Unfit(f"link '{link.name}' has a mass or inertia that is not positive (mass {inertial.mass:g} kg)")
        origin = np.eye(4) if inertial.origin is None else inertial.origin
        frame = urdf.get_transform(link.name) @ origin
        rotation = frame[:3, :3]
        parts.append((inertial.mass, frame[:3, 3], rotation @ inertial.inertia @ rotation.T))
    mass = sum(m for m, _, _ in parts)
    com = sum(m * c for m, c, _ in parts) / mass
    offsets = [(m, c - com, i) for m, c, i in parts]
    inertia = sum(i + m * (d @ d * np.eye(3) - np.outer(d, d)) for m, d, i in offsets)
    return float(mass), com, inertia


def _sphere_radius(urdf: Any, link: str) -> float:
    for collision in urdf.link_map[link].collisions:
        if collision.geometry.sphere is not None and collision.geometry.sphere.radius > 0:
            return float(collision.geometry.sphere.radius)
    raise _Unfit(f"wheel '{link}' has no <sphere> collision shape; contact with the ground is true only for spheres")


def _effort(urdf: Any, joint: str) -> float:
    limit = urdf.joint_map[joint].limit
    if limit is None or not limit.effort or not 0 < limit.effort < inf:
        raise _Unfit(f"joint '{joint}' has no <limit effort>; give its torque limit in N m")
    return float(limit.effort)


def _footprint(urdf: Any) -> OrientedBox:
    collisions = urdf.link_map[urdf.base_link].collisions
    boxes = [collision for collision in collisions if collision.geometry.box is not None]
    if len(boxes) != 1 or len(collisions) != 1:
        raise _Unfit(f"base link '{urdf.base_link}' must have exactly one collision shape, a <box> over the footprint")
    length, width, _ = boxes[0].geometry.box.size
    origin = np.eye(4) if boxes[0].origin is None else boxes[0].origin
    return OrientedBox(float(origin[0, 3]), float(origin[1, 3]), float(length) / 2, float(width) / 2)
