"""A load on the vehicle's deck, which changes its mass, centre of mass and inertia."""

from dataclasses import replace
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.vehicle.description import for_physics, parse, root_of, text_of
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import Payload, VehicleSpec
from nnql_bullet.vehicle.stances import margin

LINK = "payload"
"""Name of the load's link in the URDF, fixed to the base."""
LOAD_HEIGHT = 0.55
"""Height of the centre of a load above the ground, on the shipped vehicle [m]."""


def deck_load(vehicle: VehicleSpec, mass: float, height: float | None = None) -> Payload:
    """Makes a load of a mass [kg] on the middle of the deck.

    `height` is that of its centre above the ground [m]; without one, size and height are those on the shipped vehicle,
    smaller as the vehicle is.
    """
    scale = min(length_scale(vehicle.footprint), 1.0)
    usual = Payload(mass, vehicle.footprint.x, LOAD_HEIGHT if height is None else height)
    return usual if height is not None else replace(usual, height=scale * usual.height, side=scale * usual.side)


def fitting_mass(vehicle: VehicleSpec, share: float) -> float:
    """Returns the mass of a load that is a share of the vehicle's own, to two digits [kg]."""
    return float(f"{share * vehicle.mass:.2g}")


def loaded(vehicle: VehicleSpec, payload: Payload) -> VehicleSpec:
    """Adds a load to a vehicle: to its mass, centre of mass and inertia (parallel-axis theorem).

    Raises:
        UserError: If the vehicle already carries a load, or tips over under this one.
    """
    if vehicle.payload:
        raise UserError(f"vehicle '{vehicle.name}' carries a payload already")
    if payload.mass == 0:
        return vehicle
    m, p = vehicle.mass, payload.mass
    together = m + p
    apart = payload.ahead - vehicle.com_ahead
    com_ahead = (m * vehicle.com_ahead + p * payload.ahead) / together
    com_left = m * vehicle.com_left / together
    if margin(np.array(vehicle.contacts), com_ahead, com_left) <= 0:
        stance = vehicle.stance
        raise UserError(
            f"vehicle '{vehicle.name}' would tip over under {p:g} kg at x = {payload.ahead:.4g} m: the centre of mass "
            f"would be at x = {com_ahead:.4g} m, and the wheels stand at {-stance.behind + 0.0:.4g} and "
            f"{stance.ahead:.4g} m"
        )
    return replace(
        vehicle,
        payload=payload,
        mass=together,
        com_ahead=com_ahead,
        com_left=com_left,
        com_height=(m * vehicle.com_height + p * payload.height) / together,
        yaw_inertia=vehicle.yaw_inertia + payload.inertia + m * p / together * apart * apart,
    )


def urdf_text(vehicle: VehicleSpec) -> str:
    """Returns the text of the vehicle's URDF with its looks, and with an additional link for its load."""
    return text_of(_with_load(vehicle))


def physics_text(vehicle: VehicleSpec) -> str:
    """Returns the text of the vehicle's URDF that engines load, with an additional link for its load."""
    return for_physics(_with_load(vehicle))


def _with_load(vehicle: VehicleSpec) -> Element:
    robot = parse(vehicle.description)
    if vehicle.payload is None:
        return robot
    payload, inertia = vehicle.payload, repr(vehicle.payload.inertia)
    if any(part.get("name") == LINK for part in robot):
        raise UserError(f"{vehicle.urdf}: has a part named '{LINK}'; give it another name, which a load has")
    base = root_of(robot)
    link = ElementTree.SubElement(robot, "link", name=LINK)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "mass", value=repr(payload.mass))
    moments = {"ixx": inertia, "iyy": inertia, "izz": inertia, "ixy": "0", "ixz": "0", "iyz": "0"}
    ElementTree.SubElement(inertial, "inertia", moments)
    visual = ElementTree.SubElement(link, "visual")
    geometry = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(geometry, "box", size=" ".join([repr(payload.side)] * 3))
    ElementTree.SubElement(ElementTree.SubElement(visual, "material", name=LINK), "color", rgba="0.66 0.50 0.34 1")
    joint = ElementTree.SubElement(robot, "joint", name=LINK, type="fixed")
    ElementTree.SubElement(joint, "parent", link=base)
    ElementTree.SubElement(joint, "child", link=LINK)
    above_axle = payload.height - vehicle.wheel_radius
    ElementTree.SubElement(joint, "origin", xyz=f"{payload.ahead!r} 0 {above_axle!r}", rpy="0 0 0")
    return robot
