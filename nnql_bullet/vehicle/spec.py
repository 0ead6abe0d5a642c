"""The vehicle: its dimensions, masses, limits and friction, as its URDF and TOML describe them."""

from dataclasses import dataclass, replace
from pathlib import Path

from nnql_bullet.config import options
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.sensing import Sensor
from nnql_bullet.types import NonNegative, Positive


@options
class JointNames:
    """Names of the vehicle's joints in its URDF."""

    left_drive: str
    right_drive: str
    swivel: str
    """The free vertical axis of the caster."""
    caster_roll: str


@options
class Limits:
    """Limits of the commanded motion."""

    yaw_rate: Positive
    """[rad/s]"""
    yaw_acceleration: Positive
    """[rad/s2]"""
    acceleration: Positive
    """Acceleration and deceleration along the vehicle [m/s2]."""


@options
class ContactCoefficients:
    """Friction of the wheels on ground of coefficient 1."""

    wheel_friction: NonNegative
    rolling_friction: NonNegative
    """Lever arm of the drive wheels' rolling resistance [m]."""
    spinning_friction: NonNegative
    """Lever arm of the drive wheels' resistance to turning on the spot [m]."""


@dataclass(frozen=True, slots=True)
class Payload:
    """A load fixed to the vehicle: a solid cube."""

    mass: float
    """[kg]"""
    ahead: float
    """Distance of its centre ahead of the rear axle [m]."""
    height: float
    """Height of its centre above the ground [m]."""
    side: float = 0.4
    """Length of an edge [m]."""

    @property
    def inertia(self) -> float:
        """Moment of inertia about any axis through its centre [kg m2]."""
        return self.mass * self.side**2 / 6


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """A vehicle, in SI units and the chassis frame: origin at the rear-axle centre, x ahead, y left, z up."""

    name: str
    urdf: Path
    joints: JointNames
    links: dict[str, str]
    """Names of the links that the joints move, by the fields of `joints`."""
    limits: Limits
    contact: ContactCoefficients
    sensor: Sensor
    footprint: OrientedBox
    """The collision box of the chassis, seen from above."""
    mass: float
    """Mass of all links and the payload [kg]."""
    com_ahead: float
    """Distance of the centre of mass ahead of the rear axle [m]."""
    com_height: float
    """Height of the centre of mass above the ground [m]."""
    yaw_inertia: float
    """Moment of inertia about the vertical axis through the centre of mass [kg m2]."""
    track: float
    """Distance between the drive wheels [m]."""
    wheelbase: float
    """Distance from the rear axle to the contact point of the trailing caster [m]."""
    wheel_radius: float
    """[m]"""
    caster_radius: float
    """[m]"""
    caster_trail: float
    """Distance of the caster's contact point behind its swivel axis [m]."""
    wheel_spin_inertia: float
    """Moment of inertia of one drive wheel about its axle [kg m2]."""
    caster_spin_inertia: float
    """Moment of inertia of the caster wheel about its axle [kg m2]."""
    wheel_torque: float
    """Torque limit of each drive [N m]."""
    payload: Payload | None = None
    """The load; `mass`, the centre of mass and `yaw_inertia` include it."""
    source: str = ""
    """Name of the shipped robot or path of the TOML file from which it was read."""

    @staticmethod
    def load(name: "str | Path | VehicleSpec") -> "VehicleSpec":
        """Reads a shipped robot or a TOML file; see `urdf.load_vehicle`."""
        from nnql_bullet.vehicle.urdf import load_vehicle

        return load_vehicle(name)

    @staticmethod
    def from_toml(path: str | Path) -> "VehicleSpec":
        """Reads a robot's TOML file and its URDF; see `urdf.load_vehicle`."""
        return VehicleSpec.load(path)

    @property
    def sensor_height(self) -> float:
        """Height of the rays above the ground [m]."""
        return self.sensor.position[2] + self.wheel_radius

    @property
    def rolling_mass(self) -> float:
        """Effective mass for acceleration straight ahead: the mass and the inertia of the spinning wheels [kg]."""
        drive, caster = self.wheel_spin_inertia / self.wheel_radius**2, self.caster_spin_inertia / self.caster_radius**2
        return self.mass + 2 * drive + caster

    @property
    def rear_share(self) -> float:
        """Share of the weight on both drive wheels together at rest."""
        return 1 - self.com_ahead / self.wheelbase

    def gripping(self, friction: float) -> "VehicleSpec":
        """Returns the vehicle with another friction of its wheels."""
        return replace(self, contact=replace(self.contact, wheel_friction=friction))

    @property
    def length(self) -> float:
        """Length of the footprint [m]."""
        return 2 * self.footprint.half_length

    @property
    def width(self) -> float:
        """Width of the footprint [m]."""
        return 2 * self.footprint.half_width
