"""Writes the URDFs of the shipped vehicles from lists of solid parts, and checks them against their geometry.

Masses are given; inertia follows from each part's solid by trimesh (uniform density). The sizes of `tricycle` stand
between two industrial platforms: Neobotix MP-500 (two driven wheels and a caster, wheel diameter 0.26 m) and MiR250
(97 kg base, caster radius 0.0625 m, trail 0.038 m). `jackal_tricycle` is an own three-wheeler with the length, width,
height, mass and top speed of Clearpath's Jackal (508 x 430 x 250 mm, 17 kg, 2 m/s by its public datasheet), which
itself has four driven wheels; nothing else of it is taken.

    python scripts/make_tricycle.py            # regenerate
    python scripts/make_tricycle.py --check    # exit 1 if a committed file differs
"""

import argparse
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np
import trimesh

FOLDER = Path(__file__).resolve().parent.parent / "robots"

TRACK, WHEELBASE = 0.60, 0.70
WHEEL_RADIUS, WHEEL_WIDTH = 0.125, 0.05
CASTER_RADIUS, CASTER_WIDTH, CASTER_TRAIL = 0.05, 0.03, 0.04
WHEEL_TORQUE = 40.0
FOOTPRINT_LENGTH, FOOTPRINT_WIDTH = 1.10, 0.65
MAST_HEIGHT = 0.60  # sensor above the ground

Vector = tuple[float, float, float]
COLOURS = {
    "body": "0.96 0.62 0.07 1",
    "deck": "0.20 0.23 0.27 1",
    "tyre": "0.10 0.10 0.11 1",
    "metal": "0.72 0.74 0.77 1",
    "sensor": "0.05 0.36 0.65 1",
    "light": "0.98 0.96 0.85 1",
}


@dataclass(frozen=True)
class Solid:
    """A box (size x, y, z) or, along y or z, a cylinder or sphere (radius[, length]), at an offset in its link."""

    shape: str
    size: tuple[float, ...]
    at: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    colour: str = ""

    def mesh(self) -> trimesh.Trimesh:
        """The solid as a watertight mesh, in the link's frame."""
        if self.shape == "box":
            mesh = trimesh.creation.box(self.size)
        elif self.shape == "cylinder":
            mesh = trimesh.creation.cylinder(radius=self.size[0], height=self.size[1], sections=512)
        else:
            mesh = trimesh.creation.icosphere(subdivisions=4, radius=self.size[0])
        mesh.apply_transform(trimesh.transformations.euler_matrix(*self.rpy))
        mesh.apply_translation(self.at)
        return mesh


@dataclass(frozen=True)
class Link:
    """A link: its mass and the solid that carries it, what is seen of it, and what touches."""

    name: str
    mass: float
    solid: Solid
    visuals: tuple[Solid, ...]
    collisions: tuple[Solid, ...] = ()

    def inertia(self) -> np.ndarray:
        """Inertia (3, 3) about the solid's centre of mass [kg m2]."""
        mesh = self.solid.mesh()
        mesh.density = self.mass / mesh.volume
        return np.asarray(mesh.moment_inertia)


@dataclass(frozen=True)
class Joint:
    """A continuous joint."""

    name: str
    parent: str
    child: str
    at: Vector
    axis: Vector = (0.0, 1.0, 0.0)
    effort: float = 0.0


def box(size: Vector, at: Vector, colour: str = "") -> Solid:
    """A box."""
    return Solid("box", size, at, colour=colour)


def disc(radius: float, width: float, at: Vector = (0.0, 0.0, 0.0), colour: str = "") -> Solid:
    """A cylinder along y, as a wheel is."""
    return Solid("cylinder", (radius, width), at, (pi / 2, 0.0, 0.0), colour)


def post(radius: float, height: float, at: Vector, colour: str = "") -> Solid:
    """A cylinder along z."""
    return Solid("cylinder", (radius, height), at, colour=colour)


def tricycle() -> tuple[list[Link], list[Joint]]:
    """The parts of the industrial vehicle. The chassis frame is the centre of the rear axle, at wheel height."""
    r = WHEEL_RADIUS
    middle = WHEELBASE / 2
    swivel = WHEELBASE + CASTER_TRAIL
    chassis = Link(
        "chassis",
        104.5,
        # Not a part but a distribution of mass: the block with the inertia of battery and drives, low and to the rear.
        box((1.0, 0.5, 0.26), (0.12, 0.0, 0.22 - r)),
        visuals=(
            box((0.92, 0.50, 0.20), (0.39, 0.0, 0.255 - r), "body"),
            box((0.18, 0.50, 0.20), (-0.11, 0.0, 0.255 - r), "body"),
            box((1.06, 0.60, 0.03), (middle, 0.0, 0.37 - r), "deck"),
            box((0.05, 0.65, 0.08), (0.875, 0.0, 0.22 - r), "deck"),
            box((0.02, 0.10, 0.04), (0.86, 0.18, 0.30 - r), "light"),
            box((0.02, 0.10, 0.04), (0.86, -0.18, 0.30 - r), "light"),
            post(0.025, MAST_HEIGHT - 0.40, (middle, 0.0, (MAST_HEIGHT + 0.34) / 2 - r), "metal"),
            post(0.06, 0.07, (middle, 0.0, MAST_HEIGHT - r), "sensor"),
        ),
        # One box over the vehicle's true length and width: wheels touch only the ground, this touches the rest.
        collisions=(box((FOOTPRINT_LENGTH, FOOTPRINT_WIDTH, 0.28), (middle, 0.0, 0.245 - r)),),
    )
    wheels = [
        Link(
            f"{side}_wheel",
            6.0,
            disc(r, WHEEL_WIDTH),
            visuals=(
                disc(r, WHEEL_WIDTH, colour="tyre"),
                disc(0.075, WHEEL_WIDTH + 0.006, colour="metal"),
                box((0.16, WHEEL_WIDTH + 0.008, 0.02), (0.0, 0.0, 0.0), "deck"),
            ),
            # A sphere meets the ground in one true point; cylinders and hulls do not.
            collisions=(Solid("sphere", (r,)),),
        )
        for side in ("left", "right")
    ]
    fork = Link(
        "fork",
        1.5,
        box((0.06, 0.06, 0.08), (-0.02, 0.0, 0.02)),
        visuals=(
            post(0.03, 0.03, (0.0, 0.0, 0.075), "metal"),
            box((0.09, 0.07, 0.012), (-0.02, 0.0, 0.062), "metal"),
            box((0.03, 0.008, 0.09), (-CASTER_TRAIL, 0.025, 0.02), "metal"),
            box((0.03, 0.008, 0.09), (-CASTER_TRAIL, -0.025, 0.02), "metal"),
        ),
    )
    caster = Link(
        "caster_wheel",
        2.0,
        disc(CASTER_RADIUS, CASTER_WIDTH),
        visuals=(disc(CASTER_RADIUS, CASTER_WIDTH, colour="tyre"), disc(0.02, CASTER_WIDTH + 0.004, colour="metal")),
        collisions=(Solid("sphere", (CASTER_RADIUS,)),),
    )
    joints = [
        Joint("left_drive", "chassis", "left_wheel", (0.0, TRACK / 2, 0.0), effort=WHEEL_TORQUE),
        Joint("right_drive", "chassis", "right_wheel", (0.0, -TRACK / 2, 0.0), effort=WHEEL_TORQUE),
        Joint("swivel", "chassis", "fork", (swivel, 0.0, CASTER_RADIUS - r), (0.0, 0.0, 1.0)),
        Joint("caster_roll", "fork", "caster_wheel", (-CASTER_TRAIL, 0.0, 0.0)),
    ]
    return [chassis, *wheels, fork, caster], joints


def jackal_tricycle() -> tuple[list[Link], list[Joint]]:
    """The parts of the three-wheeler with a Jackal's footprint, in the same frame."""
    length, width, height, floor = 0.508, 0.430, 0.250, 0.10
    r, tyre, track = 0.098, 0.04, 0.39
    caster_radius, trail, swivel = 0.045, 0.03, 0.26
    middle = 0.09  # of its length, ahead of the axle
    chassis = Link(
        "chassis",
        15.2,
        # Battery and drives, low between the wheels.
        box((0.36, 0.28, 0.10), (0.045, 0.0, 0.115 - r)),
        visuals=(
            box((0.48, 0.31, 0.09), (middle, 0.0, 0.155 - r), "deck"),
            box((length, width, 0.03), (middle, 0.0, 0.215 - r), "body"),
            box((0.40, 0.30, 0.02), (middle, 0.0, 0.240 - r), "deck"),
            box((0.02, width, 0.05), (middle + length / 2 - 0.01, 0.0, 0.175 - r), "deck"),
            box((0.01, 0.06, 0.02), (middle + length / 2 - 0.005, 0.14, 0.215 - r), "light"),
            box((0.01, 0.06, 0.02), (middle + length / 2 - 0.005, -0.14, 0.215 - r), "light"),
            post(0.045, 0.06, (middle, 0.0, 0.28 - r), "sensor"),
        ),
        collisions=(box((length, width, height - floor), (middle, 0.0, (floor + height) / 2 - r)),),
    )
    wheels = [
        Link(
            f"{side}_wheel",
            0.6,
            disc(r, tyre),
            visuals=(disc(r, tyre, colour="tyre"), disc(0.055, tyre + 0.004, colour="metal")),
            collisions=(Solid("sphere", (r,)),),
        )
        for side in ("left", "right")
    ]
    fork = Link(
        "fork",
        0.3,
        box((0.05, 0.05, 0.05), (-0.01, 0.0, 0.03)),
        visuals=(
            post(0.02, 0.012, (0.0, 0.0, 0.056), "metal"),
            box((0.06, 0.05, 0.006), (-0.012, 0.0, 0.05), "metal"),
            box((0.02, 0.005, 0.06), (-trail, 0.02, 0.02), "metal"),
            box((0.02, 0.005, 0.06), (-trail, -0.02, 0.02), "metal"),
        ),
    )
    caster = Link(
        "caster_wheel",
        0.3,
        disc(caster_radius, 0.025),
        visuals=(disc(caster_radius, 0.025, colour="tyre"), disc(0.02, 0.028, colour="metal")),
        collisions=(Solid("sphere", (caster_radius,)),),
    )
    joints = [
        Joint("left_drive", "chassis", "left_wheel", (0.0, track / 2, 0.0), effort=5.0),
        Joint("right_drive", "chassis", "right_wheel", (0.0, -track / 2, 0.0), effort=5.0),
        Joint("swivel", "chassis", "fork", (swivel, 0.0, caster_radius - r), (0.0, 0.0, 1.0)),
        Joint("caster_roll", "fork", "caster_wheel", (-trail, 0.0, 0.0)),
    ]
    return [chassis, *wheels, fork, caster], joints


VEHICLES = {"tricycle": tricycle, "jackal_tricycle": jackal_tricycle}
"""What makes the parts of each."""


def numbers(values: tuple[float, ...] | np.ndarray) -> str:
    """Numbers as URDF writes them."""
    return " ".join(f"{round(float(value), 9):.9g}" for value in values)


def add_geometry(parent: ET.Element, solid: Solid) -> None:
    """Adds <origin> and <geometry>."""
    ET.SubElement(parent, "origin", xyz=numbers(solid.at), rpy=numbers(solid.rpy))
    geometry = ET.SubElement(parent, "geometry")
    if solid.shape == "box":
        ET.SubElement(geometry, "box", size=numbers(solid.size))
    elif solid.shape == "cylinder":
        ET.SubElement(geometry, "cylinder", radius=numbers(solid.size[:1]), length=numbers(solid.size[1:]))
    else:
        ET.SubElement(geometry, "sphere", radius=numbers(solid.size))


def add_link(robot: ET.Element, link: Link) -> None:
    """Adds <link>."""
    element = ET.SubElement(robot, "link", name=link.name)
    inertial = ET.SubElement(element, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(link.solid.at), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=numbers((link.mass,)))
    i = link.inertia()
    names = {"ixx": i[0, 0], "ixy": i[0, 1], "ixz": i[0, 2], "iyy": i[1, 1], "iyz": i[1, 2], "izz": i[2, 2]}
    ET.SubElement(inertial, "inertia", {name: f"{round(value, 6) + 0.0:.6g}" for name, value in names.items()})
    for solid in link.visuals:
        visual = ET.SubElement(element, "visual")
        add_geometry(visual, solid)
        ET.SubElement(visual, "material", name=solid.colour)
    for solid in link.collisions:
        add_geometry(ET.SubElement(element, "collision"), solid)


def add_joint(robot: ET.Element, joint: Joint) -> None:
    """Adds <joint>."""
    element = ET.SubElement(robot, "joint", name=joint.name, type="continuous")
    ET.SubElement(element, "parent", link=joint.parent)
    ET.SubElement(element, "child", link=joint.child)
    ET.SubElement(element, "origin", xyz=numbers(joint.at), rpy="0 0 0")
    ET.SubElement(element, "axis", xyz=numbers(joint.axis))
    if joint.effort:
        ET.SubElement(element, "limit", effort=numbers((joint.effort,)), velocity="100")


def urdf(name: str = "tricycle") -> str:
    """The whole file of a vehicle."""
    links, joints = VEHICLES[name]()
    robot = ET.Element("robot", name=name)
    for colour, rgba in COLOURS.items():
        ET.SubElement(ET.SubElement(robot, "material", name=colour), "color", rgba=rgba)
    for link in links:
        add_link(robot, link)
    for joint in joints:
        add_joint(robot, joint)
    ET.indent(robot)
    note = "<!-- Written by scripts/make_tricycle.py: change that, not this. -->"
    return f'<?xml version="1.0"?>\n{note}\n{ET.tostring(robot, encoding="unicode")}\n'


def main() -> int:
    """Writes or checks the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a committed file differs")
    check, differs = parser.parse_args().check, False
    for name, parts in VEHICLES.items():
        file, text = FOLDER / f"{name}.urdf", urdf(name)
        if check:
            same = file.read_text(encoding="utf-8") == text
            print(f"{file.name} {'is' if same else 'is NOT'} what the parts give")
            differs |= not same
        else:
            file.write_text(text, encoding="utf-8")
            print(f"wrote {file.name}: {sum(link.mass for link in parts()[0]):g} kg")
    return int(differs)


if __name__ == "__main__":
    sys.exit(main())
