"""The vehicle as its URDF and TOML describe it; nothing about it is typed anywhere else."""

import logging
from dataclasses import dataclass, replace
from math import hypot, inf
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from nnql_bullet import assets
from nnql_bullet.config import options, parse, read_toml
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.types import NonNegative, Positive


@options
class JointNames:
    """Which joints of the URDF do what."""

    left_drive: str
    right_drive: str
    swivel: str
    """The caster's free vertical axis."""
    caster_roll: str


@options
class Limits:
    """What the drive may ask of the vehicle."""

    yaw_rate: Positive
    """[rad/s]"""
    yaw_acceleration: Positive
    """[rad/s2]"""
    acceleration: Positive
    """Along the vehicle, speeding up and slowing down [m/s2]."""


@options
class ContactCoefficients:
    """Friction against ground of coefficient 1."""

    wheel_friction: NonNegative
    rolling_friction: NonNegative
    """Drive wheels [m]."""
    spinning_friction: NonNegative
    """Drive wheels [m]."""


@options
class SensorMount:
    """Where the rays start."""

    position: tuple[float, float, float]
    """In the chassis frame [m]."""


@dataclass(frozen=True, slots=True)
class Payload:
    """A load fixed to the vehicle: a solid cube."""

    mass: float
    """[kg]"""
    ahead: float
    """Of its centre, from the rear axle [m]."""
    height: float
    """Of its centre, above the ground [m]."""
    side: float = 0.4
    """[m]"""

    @property
    def inertia(self) -> float:
        """About any axis through its centre [kg m2]."""
        return self.mass * self.side**2 / 6


@options
class RobotFile:
    """A robot's TOML."""

    urdf: str
    """Path, relative to the TOML."""
    joints: JointNames
    limits: Limits
    contact: ContactCoefficients
    sensor: SensorMount


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """A vehicle: SI units, in the frame of the chassis (rear-axle centre at wheel height, x ahead, y left, z up)."""

    name: str
    urdf: Path
    joints: JointNames
    links: dict[str, str]
    """The link that each field of `joints` moves."""
    limits: Limits
    contact: ContactCoefficients
    sensor: tuple[float, float, float]
    footprint: OrientedBox
    """The chassis collision box seen from above."""
    mass: float
    com_ahead: float
    """Composite centre of mass ahead of the rear axle [m]."""
    com_height: float
    """Composite centre of mass above the ground [m]."""
    yaw_inertia: float
    """About the composite centre of mass [kg m2]."""
    track: float
    wheelbase: float
    """From the rear axle to the caster's contact point when it trails [m]."""
    wheel_radius: float
    caster_radius: float
    caster_trail: float
    wheel_spin_inertia: float
    """One drive wheel about its axle [kg m2]."""
    caster_spin_inertia: float
    """The caster wheel about its axle [kg m2]."""
    wheel_torque: float
    """Limit of each drive [N m]."""
    payload: Payload | None = None
    """What it carries; counted in `mass`, the centre of mass and `yaw_inertia`."""

    @property
    def sensor_height(self) -> float:
        """Of the rays above the ground [m]."""
        return self.sensor[2] + self.wheel_radius

    @property
    def rolling_mass(self) -> float:
        """What resists acceleration straight ahead: the mass, and the wheels that spin up with it [kg]."""
        drive, caster = self.wheel_spin_inertia / self.wheel_radius**2, self.caster_spin_inertia / self.caster_radius**2
        return self.mass + 2 * drive + caster

    @property
    def rear_share(self) -> float:
        """Of the weight, on both drive wheels together at rest."""
        return 1 - self.com_ahead / self.wheelbase

    def gripping(self, friction: float) -> "VehicleSpec":
        """The same vehicle on wheels of another friction."""
        return replace(self, contact=replace(self.contact, wheel_friction=friction))

    @property
    def clear_radius(self) -> float:
        """Radius of the smallest circle, about the footprint's centre, that holds the footprint [m]."""
        return hypot(self.footprint.half_length, self.footprint.half_width)


def load_vehicle(name: str) -> VehicleSpec:
    """Reads a robot's TOML and its URDF.

    Args:
        name: A shipped robot's name or a path to a TOML file.

    Raises:
        UserError: If either file is missing, malformed, or describes no such vehicle.
    """
    path = assets.find("robots", name)
    robot = parse(RobotFile, read_toml(path), str(path))
    urdf_path = path.parent / robot.urdf
    urdf = _load_urdf(urdf_path)
    try:
        return _spec(path.stem, urdf_path, robot, urdf)
    except _Unfit as error:
        raise UserError(f"{urdf_path}: {error}") from None


class _Unfit(Exception):
    """The URDF does not describe a vehicle that this package can drive."""


def _load_urdf(path: Path) -> Any:
    if not path.is_file():
        raise UserError(f"{path}: there is no such URDF; put it beside its TOML, or correct 'urdf' there")
    import yourdfpy  # 70 MB, which a worker that is sent a VehicleSpec can do without

    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)
    try:
        ElementTree.parse(path)  # yourdfpy mends broken XML without a word
        return yourdfpy.URDF.load(str(path), load_meshes=False, load_collision_meshes=False)
    except Exception as error:  # yourdfpy raises whatever its parsers raise
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
    """Mass, centre of mass and inertia about it of all links together (parallel-axis theorem)."""
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
