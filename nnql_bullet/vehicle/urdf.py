"""Reads a vehicle from its TOML and URDF, and refuses what this package would drive wrongly."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np

from nnql_bullet import assets
from nnql_bullet.config import options, parse, read_toml
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file
from nnql_bullet.geometry import Array, OrientedBox
from nnql_bullet.sensing import Sensor
from nnql_bullet.vehicle.description import LARGEST, Description, Joint, Link, Solid, Unfit, describe, read, refuse
from nnql_bullet.vehicle.spec import ContactCoefficients, JointNames, Limits, VehicleSpec

NEAR = 1e-3
"""Tolerance of positions [m] and directions [rad]: URDFs round them, for example a quarter turn to 1.57."""
CENTRED = 0.02
"""Share of the track by which the centre of mass may be off the centre line, where `limits` takes it to be."""
WHEELS = ("left_drive", "right_drive", "caster_roll")
"""Fields of `JointNames` whose joints carry a wheel."""
KIND = "a vehicle has two driven wheels and one caster in front that swivels"


@options
class RobotFile:
    """The keys of a robot's TOML."""

    urdf: str
    """Path of the URDF, in the folder of the TOML or below it."""
    joints: JointNames
    limits: Limits
    contact: ContactCoefficients
    sensor: Sensor


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
    path = assets.find("robots", name)
    robot = parse(RobotFile, read_toml(path), str(path))
    if Path(robot.urdf).is_absolute() or ".." in Path(robot.urdf).parts:
        raise UserError(f"{path}: 'urdf': '{robot.urdf}' leads out of the folder of this file; put the URDF beside it")
    urdf_path = path.parent / robot.urdf
    if not is_file(urdf_path):
        raise UserError(f"{urdf_path}: there is no such URDF; put it beside its TOML, or correct 'urdf' there")
    urdf = describe(read(urdf_path))
    try:
        return replace(_spec(path.stem, urdf_path, robot, urdf), source=name)
    except Unfit as error:
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


def _spec(name: str, path: Path, robot: RobotFile, urdf: Description) -> VehicleSpec:
    names = {field: getattr(robot.joints, field) for field in JointNames.__annotations__}
    links = {field: urdf.joints[joint].child for field, joint in names.items() if joint in urdf.joints}
    wheels = {field: urdf.links[links[field]] for field in WHEELS if field in links}
    driven = [urdf.joints[names[field]] for field in WHEELS[:2] if field in links]
    problems = [
        *_check_joints(urdf, names),
        *(problem for wheel in wheels.values() for problem in _check_wheel(wheel)),
        *(problem for joint in driven for problem in _check_effort(joint)),
        *_check_box(urdf.links[urdf.base]),
        *_check_other_links(urdf, {urdf.base, *(wheel.name for wheel in wheels.values())}),
        *_check_masses(urdf),
    ]
    at = {field: urdf.frames[link][:3, 3] for field, link in links.items()}
    radius = {field: spheres[0].sizes[0] for field, wheel in wheels.items() if (spheres := _spheres(wheel))}
    if len(links) == len(names) and len(radius) == len(WHEELS):
        problems += [*_check_axle(urdf.base, at, radius), *_check_caster(at, radius)]
    refuse(problems)
    mass, com, inertia = _composite(urdf)
    wheel, box = radius["left_drive"], urdf.links[urdf.base].solids[0]
    vehicle = VehicleSpec(
        name=name,
        urdf=path,
        joints=robot.joints,
        links=links,
        limits=robot.limits,
        contact=robot.contact,
        sensor=robot.sensor,
        footprint=_footprint(box),
        mass=mass,
        com_ahead=float(com[0]),
        com_height=float(com[2]) + wheel,
        yaw_inertia=float(inertia[2, 2]),
        track=float(at["left_drive"][1] - at["right_drive"][1]),
        wheelbase=float(at["caster_roll"][0]),
        wheel_radius=wheel,
        caster_radius=radius["caster_roll"],
        caster_trail=float(at["swivel"][0] - at["caster_roll"][0]),
        wheel_spin_inertia=_spin_inertia(urdf, names["left_drive"]),
        caster_spin_inertia=_spin_inertia(urdf, names["caster_roll"]),
        wheel_torque=min(joint.effort or inf for joint in driven),
    )
    coverage = _check_coverage(vehicle, at["swivel"][0])
    refuse([*_check_balance(vehicle, float(com[1])), *coverage, *_check_heights(vehicle, box)])
    return vehicle


def _check_joints(urdf: Description, names: dict[str, str]) -> Iterator[str]:
    """Checks that the joints with a role, and no others, move, and move as their role needs it."""
    if missing := {field: joint for field, joint in names.items() if joint not in urdf.joints}:
        there = ", ".join(urdf.joints)
        for field, joint in missing.items():
            yield f"has no joint '{joint}' (joints.{field}); its joints are: {there}"
        return
    for field, joint in names.items():
        if (kind := urdf.joints[joint].kind) != "continuous":
            yield f"joint '{joint}' is {kind}; make it continuous (joints.{field}: {KIND})"
    if len(set(names.values())) < len(names):
        yield f"[joints] in the TOML names one joint twice: {', '.join(names.values())}"
    for each in urdf.joints.values():
        if each.kind != "fixed" and each.name not in names.values():
            yield (f"joint '{each.name}' is {each.kind}, and [joints] names no role for it; make it fixed ({KIND})")
    for field, joint in names.items():
        if urdf.joints[joint].kind != "continuous":
            continue
        child = urdf.joints[joint].child
        expected = [joint, names["swivel"]] if field == "caster_roll" else [joint]
        if urdf.moving_joints_above(child) != expected:
            carrier = f"its swivel '{names['swivel']}'" if field == "caster_roll" else f"the base link '{urdf.base}'"
            yield (f"joint '{joint}' (joints.{field}) must hang on {carrier}, with nothing that moves between them")
        axis = (0.0, 0.0, 1.0) if field == "swivel" else (0.0, 1.0, 0.0)
        turned = urdf.frames[child][:3, :3] @ urdf.joints[joint].axis
        if not np.allclose(turned, axis, rtol=0, atol=NEAR):
            yield (
                f"joint '{joint}' must have the axis {axis}, so that a positive speed rolls ahead; "
                f"its origin's rpy included, it has {_rounded(turned)}"
            )


def _check_axle(base: str, at: dict[str, Array], radius: dict[str, float]) -> Iterator[str]:
    """Checks that the frame of the base link lies in the middle of the drive axle."""
    left, right = at["left_drive"], at["right_drive"]
    if abs(radius["left_drive"] - radius["right_drive"]) > 1e-9:
        yield "the drive wheels differ in radius"
    if left[1] <= right[1]:
        yield "the left drive wheel is not to the left of the right one; swap the joints in the TOML"
    if np.any(np.abs(left - right)[[0, 2]] > NEAR):
        yield f"the drive wheels are not on one axle, but at {_rounded(left)} and {_rounded(right)}"
    middle = (left + right) / 2
    if np.any(np.abs(middle) > NEAR):
        yield (
            f"the frame of the base link '{base}' must lie in the middle of the drive axle, which is at "
            f"{_rounded(middle)} in it; move all origins in the base link by {_rounded(-middle)}, and the sensor too"
        )


def _check_caster(at: dict[str, Array], radius: dict[str, float]) -> Iterator[str]:
    """Checks that the caster is in front, on the centre line, trails its swivel, and stands on the ground."""
    swivel, wheel = at["swivel"], at["caster_roll"]
    if wheel[0] <= NEAR:
        yield f"the caster wheel is not ahead of the drive axle, but at x = {wheel[0]:.4g} m; {KIND}"
    if wheel[0] >= swivel[0] - NEAR:
        yield "the caster wheel does not trail its swivel; put its centre behind the swivel axis"
    if max(abs(swivel[1]), abs(wheel[1])) > NEAR:
        yield (
            f"the caster is off the centre line: its swivel is at y = {swivel[1]:.4g} m, its wheel at {wheel[1]:.4g} m"
        )
    above = wheel[2] - radius["caster_roll"] + radius["left_drive"]
    if abs(above) > NEAR:
        way = "above" if above > 0 else "below"
        yield f"the caster wheel ends {abs(above):.4g} m {way} the ground that the drive wheels stand on"


def _check_other_links(urdf: Description, known: set[str]) -> Iterator[str]:
    """Checks that links without a role have no collision shapes."""
    for link in urdf.links.values():
        if link.solids and link.name not in known:
            yield (
                f"link '{link.name}' has a collision shape that would touch nothing: only wheels and the base link "
                f"'{urdf.base}' do; remove it, and let the box of the base link cover it"
            )


def _check_balance(vehicle: VehicleSpec, com_left: float) -> Iterator[str]:
    """Checks that the vehicle stands on its three wheels."""
    if abs(com_left) > CENTRED * vehicle.track:
        yield (f"the centre of mass is off the centre line, at y = {com_left:.4g} m; balance the masses about y = 0")
    if not 0 < vehicle.com_ahead < vehicle.wheelbase:
        yield (
            f"the vehicle would tip over: its centre of mass is at x = {vehicle.com_ahead:.4g} m, and its wheels stand "
            f"at 0 and {vehicle.wheelbase:.4g} m"
        )


def _check_coverage(vehicle: VehicleSpec, swivel_ahead: float) -> Iterator[str]:
    """Checks that the footprint covers the wheels, the caster at each angle: only the footprint meets obstacles."""
    box, sweep = vehicle.footprint, vehicle.caster_trail + vehicle.caster_radius
    rear, front = min(-vehicle.wheel_radius, swivel_ahead - sweep), max(vehicle.wheel_radius, swivel_ahead + sweep)
    side = max(vehicle.track / 2, sweep)
    low_x, high_x = box.x - box.half_length, box.x + box.half_length
    low_y, high_y = box.y - box.half_width, box.y + box.half_width
    if low_x > rear + NEAR or high_x < front - NEAR or low_y > NEAR - side or high_y < side - NEAR:
        yield (
            f"the box of the base link must cover the wheels, the caster at each angle: from x = {rear:.4g} to "
            f"{front:.4g} m and y = {-side:.4g} to {side:.4g} m; "
            f"it is from x = {low_x:.4g} to {high_x:.4g} m and y = {low_y:.4g} to {high_y:.4g} m"
        )


def _check_heights(vehicle: VehicleSpec, box: Solid) -> Iterator[str]:
    """Checks that nothing is under the ground, and that an obstacle which reaches up to the sensor meets the box."""
    middle, half = box.origin[2, 3] + vehicle.wheel_radius, float(_reach(box)[2])
    if vehicle.com_height <= 0:
        yield f"the centre of mass is under the ground, at a height of {vehicle.com_height:.4g} m"
    if vehicle.sensor_height <= 0:
        yield f"sensor.position in the TOML is under the ground, at a height of {vehicle.sensor_height:.4g} m"
    if middle + half <= 0 or middle - half >= vehicle.sensor_height:
        yield (
            f"the box of the base link is between the heights {middle - half:.4g} and {middle + half:.4g} m, so that "
            f"obstacles that the sensor sees at {vehicle.sensor_height:.4g} m may not touch it"
        )


def _check_masses(urdf: Description) -> Iterator[str]:
    """Checks that links have masses and inertias that bodies can have."""
    for link in urdf.links.values():
        if link.mass is None or link.inertia is None:
            yield f"link '{link.name}' has no mass and inertia; give it an <inertial>"
            continue
        least, middle, largest = np.linalg.eigvalsh(link.inertia)
        if not 0 < link.mass <= LARGEST or least <= 0:
            yield f"link '{link.name}' has a mass or inertia that is not positive (mass {link.mass:g} kg)"
        elif largest > (least + middle) * (1 + 1e-12):  # PyBullet sets such an inertia to zero
            yield (
                f"link '{link.name}' has an inertia that no body has: its largest moment, {largest:.4g} kg m2, is more "
                f"than both others together, {least:.4g} and {middle:.4g}"
            )


def _composite(urdf: Description) -> tuple[float, Array, Array]:
    """Computes mass, centre of mass and inertia about it of all links together (parallel-axis theorem)."""
    parts = []
    for link in urdf.links.values():
        frame = urdf.frames[link.name] @ link.centre
        rotation = frame[:3, :3]
        parts.append((link.mass or 0.0, frame[:3, 3], rotation @ np.asarray(link.inertia) @ rotation.T))
    mass = sum(m for m, _, _ in parts)
    com = sum((m * c for m, c, _ in parts), np.zeros(3)) / mass
    offsets = [(m, c - com, i) for m, c, i in parts]
    inertia = sum((i + m * (d @ d * np.eye(3) - np.outer(d, d)) for m, d, i in offsets), np.zeros((3, 3)))
    return mass, com, inertia


def _spin_inertia(urdf: Description, joint: str) -> float:
    """Computes the moment of inertia of a wheel about the axis of its joint [kg m2]."""
    link = urdf.links[urdf.joints[joint].child]
    axis = link.centre[:3, :3].T @ urdf.joints[joint].axis
    return float(axis @ np.asarray(link.inertia) @ axis)


def _check_wheel(wheel: Link) -> Iterator[str]:
    """Checks that a wheel has one collision shape, a sphere on its axle."""
    spheres = _spheres(wheel)
    if not spheres:
        yield f"wheel '{wheel.name}' has no <sphere> collision shape; contact with the ground is true only for spheres"
    elif len(wheel.solids) > 1:
        yield f"wheel '{wheel.name}' has {len(wheel.solids)} collision shapes; leave it one <sphere>"
    elif np.any(np.abs(offset := spheres[0].origin[:3, 3]) > NEAR):
        yield f"the sphere of wheel '{wheel.name}' is at {_rounded(offset)} from its axle; put it at 0 0 0"


def _spheres(wheel: Link) -> list[Solid]:
    return [solid for solid in wheel.solids if solid.kind == "sphere" and solid.sizes and solid.sizes[0] > NEAR]


def _check_effort(joint: Joint) -> Iterator[str]:
    """Checks that a driven joint has a torque limit."""
    if joint.effort is None or not 0 < joint.effort < inf:
        yield f"joint '{joint.name}' has no <limit effort>; give its torque limit in N m"


def _check_box(base: Link) -> Iterator[str]:
    """Checks that the base link has one collision shape, a box that is parallel to the axes of its frame."""
    if [solid.kind for solid in base.solids] != ["box"] or len(base.solids[0].sizes) != 3:
        there = ", ".join(solid.title for solid in base.solids) or "none"
        yield f"base link '{base.name}' must have exactly one collision shape, a <box> over the footprint, not: {there}"
        return
    turned = np.abs(base.solids[0].origin[:3, :3])
    if np.any((turned > NEAR) & (turned < 1 - NEAR)):
        yield f"the box of base link '{base.name}' is askew; turn it by quarters only, or draw a box around it"


def _reach(box: Solid) -> Array:
    """Computes half the edges of the upright box around a turned box (3,) [m]."""
    return np.asarray(np.abs(box.origin[:3, :3]) @ (np.array(box.sizes) / 2))


def _footprint(box: Solid) -> OrientedBox:
    """Computes the rectangle that a box covers, seen from above."""
    length, width, _ = _reach(box).tolist()
    return OrientedBox(float(box.origin[0, 3]), float(box.origin[1, 3]), length, width)


def _rounded(vector: Array) -> tuple[float, ...]:
    return tuple(round(value, 4) + 0.0 for value in vector.tolist())
