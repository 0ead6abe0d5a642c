"""Names the fields of PyBullet's answers, which are plain tuples. No other module reads these tuples."""

from collections.abc import Iterable
from math import hypot
from typing import Any, NamedTuple

from nnql_bullet.sim.physics import ContactForce, LinkDynamics, Quaternion
from nnql_bullet.types import Vector


class JointInfo(NamedTuple):
    """The answer of `getJointInfo`."""

    number: int
    joint_name: bytes
    joint_type: int
    q_index: int
    u_index: int
    flags: int
    damping: float
    friction: float
    lower_limit: float
    upper_limit: float
    max_force: float
    max_velocity: float
    child_link_name: bytes
    axis: Vector
    parent_position: Vector
    parent_orientation: Quaternion
    parent_index: int

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.joint_name.decode()

    @property
    def link_name(self) -> str:
        """Name of the link that the joint moves; its number is that of the joint."""
        return self.child_link_name.decode()


class JointState(NamedTuple):
    """The answer of `getJointState`."""

    position: float
    """[rad]"""
    velocity: float
    """[rad/s]"""
    reaction: tuple[float, ...]
    torque: float


class DynamicsInfo(NamedTuple):
    """The answer of `getDynamicsInfo`."""

    mass: float
    lateral_friction: float
    inertia_diagonal: Vector
    inertia_position: Vector
    """Centre of mass in the link's frame [m]."""
    inertia_orientation: Quaternion
    restitution: float
    rolling_friction: float
    spinning_friction: float
    contact_damping: float
    contact_stiffness: float
    body_type: int
    collision_margin: float

    @property
    def dynamics(self) -> LinkDynamics:
        """The values that every engine has."""
        return LinkDynamics(
            self.mass, self.inertia_diagonal, self.lateral_friction, self.rolling_friction, self.spinning_friction
        )


class ContactPoint(NamedTuple):
    """A row of the answer of `getContactPoints`."""

    flag: int
    body_a: int
    body_b: int
    link_a: int
    link_b: int
    position_on_a: Vector
    position_on_b: Vector
    normal_on_b: Vector
    distance: float
    normal_force: float
    friction_1: float
    direction_1: Vector
    friction_2: float
    direction_2: Vector


class LinkState(NamedTuple):
    """The answer of `getLinkState`, without velocities."""

    com_position: Vector
    com_orientation: Quaternion
    local_com_position: Vector
    local_com_orientation: Quaternion
    position: Vector
    """Origin of the link's frame in the world [m]."""
    orientation: Quaternion


def contact_force(contacts: Iterable[Any]) -> ContactForce:
    """Sums the forces of contacts from `getContactPoints`."""
    points = [ContactPoint(*contact) for contact in contacts]
    return ContactForce(
        normal=float(sum(point.normal_force for point in points)),
        friction=float(sum(hypot(point.friction_1, point.friction_2) for point in points)),
    )


def hit_fractions(hits: Iterable[Any]) -> list[float]:
    """Returns the share of its length at which each ray of `rayTestBatch` ended."""
    return [fraction for _body, _link, fraction, _position, _normal in hits]
