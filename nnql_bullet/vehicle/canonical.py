"""Writes a vehicle as a URDF of one form, which engines and renderers load, whatever the form of its own URDF.

The base link has its frame in the middle of the drive axle and one box over all that sticks out. Wheels are spheres,
which touch the ground in a point, as wheels do; they turn about y. A ball is a link that is fixed to the base link.
"""

from collections.abc import Sequence
from copy import deepcopy
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from nnql_bullet.geometry import Array
from nnql_bullet.vehicle.description import (
    Description,
    Joint,
    Link,
    describe,
    looks_of,
    place,
    words,
)
from nnql_bullet.vehicle.mechanism import Caster, Mechanism, Part, Wheel
from nnql_bullet.vehicle.shapes import Meshes

ROUNDING = 1e-12
"""Relative and absolute difference of numbers that count as equal."""
LIGHT = 1e-6
"""Mass of a support that has none of its own [kg]."""


def canonical(robot: Element, mechanism: Mechanism, meshes: Meshes) -> Element:
    """Writes a vehicle in the form that is loaded; one that has this form already is returned as it is.

    Args:
        robot: Its URDF, as `description.read` gives it.
        mechanism: What drives it.
        meshes: Where its meshes are.
    """
    written = Element("robot", name=robot.get("name", ""))
    written.extend(robot.findall("material"))
    middle, half = mechanism.box
    box = Element("box", size=words((2 * half).tolist()))
    _add_link(written, robot, mechanism, mechanism.body, meshes, box, middle)
    for wheel in (mechanism.left, mechanism.right):
        _add_wheel(written, robot, mechanism, wheel, meshes)
        _add_joint(written, mechanism, wheel.joint, mechanism.body, wheel.part, "0 1 0")
    for caster in mechanism.casters:
        _add_caster(written, robot, mechanism, caster, meshes)
    return robot if _alike(mechanism.urdf, describe(written)) else written


def _add_caster(written: Element, robot: Element, mechanism: Mechanism, caster: Caster, meshes: Meshes) -> None:
    wheel, fork = caster.wheel, caster.fork
    if fork:
        _add_link(written, robot, mechanism, fork, meshes)
        _add_joint(written, mechanism, caster.swivel, mechanism.body, fork, "0 0 1")
    _add_wheel(written, robot, mechanism, wheel, meshes)
    _add_joint(written, mechanism, wheel.joint, fork or mechanism.body, wheel.part, "0 1 0" if fork else "")


def _add_wheel(written: Element, robot: Element, mechanism: Mechanism, wheel: Wheel, meshes: Meshes) -> None:
    sphere = Element("sphere", radius=repr(float(wheel.radius)))
    _add_link(written, robot, mechanism, wheel.part, meshes, sphere)


def _add_link(
    written: Element,
    robot: Element,
    mechanism: Mechanism,
    part: Part,
    meshes: Meshes,
    solid: Element | None = None,
    at: Sequence[float] | Array = (0.0, 0.0, 0.0),
) -> None:
    link = ElementTree.SubElement(written, "link", name=part.name)
    mass, centre, inertia = _inertial(mechanism, part, solid)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=words(np.asarray(centre).tolist()), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(float(mass)))
    keys = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ElementTree.SubElement(inertial, "inertia", {key: repr(float(inertia[at])) for key, at in keys.items()})
    for name in part.links:
        source = next(its for its in robot.findall("link") if its.attrib["name"] == name)
        for look in looks_of(source, meshes.find):
            place(look, part.placed[name])
            link.append(look)
    if part is mechanism.body and solid is not None and link.find("visual") is None:
        visual = ElementTree.SubElement(link, "visual")
        ElementTree.SubElement(visual, "origin", xyz=words(np.asarray(at, dtype=float).tolist()), rpy="0 0 0")
        ElementTree.SubElement(visual, "geometry").append(deepcopy(solid))
    if solid is not None:
        collision = ElementTree.SubElement(link, "collision")
        ElementTree.SubElement(collision, "origin", xyz=words(np.asarray(at, dtype=float).tolist()), rpy="0 0 0")
        ElementTree.SubElement(collision, "geometry").append(solid)


def _add_joint(written: Element, mechanism: Mechanism, name: str, parent: Part, child: Part, axis: str) -> None:
    joint = ElementTree.SubElement(written, "joint", name=name, type="continuous" if axis else "fixed")
    ElementTree.SubElement(joint, "parent", link=parent.name)
    ElementTree.SubElement(joint, "child", link=child.name)
    ElementTree.SubElement(joint, "origin", xyz=words((child.origin - parent.origin).tolist()), rpy="0 0 0")
    if axis:
        ElementTree.SubElement(joint, "axis", xyz=axis)
    source = mechanism.urdf.joints.get(name)
    if axis and source and source.effort is not None:
        limits = {"effort": repr(source.effort)}
        limits |= {} if source.velocity is None else {"velocity": repr(source.velocity)}
        ElementTree.SubElement(joint, "limit", limits)


def _inertial(mechanism: Mechanism, part: Part, solid: Element | None) -> tuple[float, Array, Array]:
    """Computes mass, centre of mass and moments of inertia about it of a part, in the axes of its frame."""
    links = [mechanism.urdf.links[name] for name in part.links]
    bodies = [placed_inertia(link, part.placed[link.name]) for link in links if link.mass]
    if not bodies:
        radius = 0.01 if solid is None or solid.tag != "sphere" else float(solid.attrib["radius"])
        return LIGHT, np.zeros(3), np.eye(3) * (0.4 * LIGHT * radius * radius)
    return composite(bodies)


def placed_inertia(link: Link, frame: Array) -> tuple[float, Array, Array]:
    """Returns mass, centre of mass and moments of inertia about it of a link whose frame is placed by a transform."""
    placed = frame @ link.centre
    rotation = placed[:3, :3]
    inertia = np.zeros((3, 3)) if link.inertia is None else link.inertia
    return link.mass or 0.0, placed[:3, 3], rotation @ inertia @ rotation.T


def composite(bodies: Sequence[tuple[float, Array, Array]]) -> tuple[float, Array, Array]:
    """Computes mass, centre of mass and inertia about it of several bodies together (parallel-axis theorem)."""
    if len(bodies) == 1:
        return bodies[0]
    mass = sum(m for m, _, _ in bodies)
    centre = sum((m * c for m, c, _ in bodies), np.zeros(3)) / mass
    offsets = [(m, c - centre, i) for m, c, i in bodies]
    inertia = sum((i + m * (d @ d * np.eye(3) - np.outer(d, d)) for m, d, i in offsets), np.zeros((3, 3)))
    return mass, centre, inertia


def _alike(one: Description, other: Description) -> bool:
    """Whether two URDFs have the same bodies, contacts and joints, up to rounding."""
    if one.base != other.base or list(one.links) != list(other.links) or list(one.joints) != list(other.joints):
        return False
    links = zip(one.links.values(), other.links.values(), strict=True)
    joints = zip(one.joints.values(), other.joints.values(), strict=True)
    return all(_same_link(*pair) for pair in links) and all(_same_joint(*pair) for pair in joints)


def _same_link(a: Link, b: Link) -> bool:
    solids = [[(its.kind, its.sizes) for its in link.solids] for link in (a, b)]
    if a.mass != b.mass or a.inertia is None or b.inertia is None or solids[0] != solids[1]:
        return False
    placed = [(s.origin, t.origin) for s, t in zip(a.solids, b.solids, strict=True)]
    return all(_equal(*pair) for pair in [(a.centre, b.centre), (a.inertia, b.inertia), *placed])


def _same_joint(a: Joint, b: Joint) -> bool:
    same = (a.kind, a.parent, a.child, a.effort, a.velocity) == (b.kind, b.parent, b.child, b.effort, b.velocity)
    return same and _equal(a.origin, b.origin) and (a.kind == "fixed" or _equal(a.axis, b.axis))


def _equal(one: Array, other: Array) -> bool:
    return np.allclose(one, other, rtol=ROUNDING, atol=ROUNDING)
