"""The vehicle: its dimensions, masses, limits and friction, as its URDF and TOML describe them."""

from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from nnql_bullet.config import options
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.sensing import Sensor
from nnql_bullet.types import NonNegative, Positive

if TYPE_CHECKING:
    from nnql_bullet.vehicle.stances import Stance


@options
class JointNames:
    """Names of the vehicle's joints in its URDF."""

    left_drive: str
    right_drive: str
    swivel: str = ""
    """The free vertical axis of the caster; casters are found by their shapes and joints, so it need not be named."""
    caster_roll: str = ""


@options
class Limits:
    """Limits of the commanded motion."""

    yaw_rate: Positive
    """[rad/s]"""
    yaw_acceleration: Positive
    """[rad/s2]"""
    acceleration: Positive
    """Acceleration and deceleration along the vehicle [m/s2]."""
    speed: Positive | None = None
    """Largest speed, at which it drives unless told otherwise [m/s]; by default it has none of its own."""
    wheel_torque: Positive | None = None
    """Torque limit of each drive, in place of the URDF's effort [N m]."""


@options
class ContactCoefficients:
    """Friction of the wheels on ground of coefficient 1."""

    wheel_friction: NonNegative
    rolling_friction: NonNegative
    """Lever arm of the drive wheels' rolling resistance [m]."""
    spinning_friction: NonNegative
    """Lever arm of the drive wheels' resistance to turning on the spot [m]."""
    ball_friction: NonNegative = 0.1
    """Friction of casters that do not swivel, which slide."""


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
class Delays:
    """How late the drive obeys; at once by default."""

    decision: float = 0.0
    """Time after which a decision takes effect [s]; until then the vehicle keeps to the former one."""
    wheels: float = 0.0
    """Time constant with which the commanded wheel speeds follow those of the controller [s], as a first-order lag."""

    @property
    def any(self) -> bool:
        """Whether anything is late."""
        return self.decision > 0 or self.wheels > 0


@dataclass(frozen=True, slots=True)
class Caster:
    """A support besides the drive wheels: a wheel that trails its swivel, or a ball that slides."""

    link: str
    """Name of the link that touches the ground."""
    x: float
    """Distance of its contact point ahead of the drive axle, when it trails straight ahead [m]."""
    y: float
    """Distance of its contact point to the left [m]."""
    radius: float
    """[m]"""
    trail: float = 0.0
    """Distance of its contact point behind its swivel axis [m]; 0 for a ball."""
    spin_inertia: float = 0.0
    """Moment of inertia of the wheel about its axle [kg m2]."""
    swivel: str = ""
    """Name of the joint that swivels; empty for a ball."""
    roll: str = ""
    """Name of the joint of the wheel; empty for a ball."""

    @property
    def swivels(self) -> bool:
        """Whether it is a wheel that swivels."""
        return bool(self.swivel)


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """A vehicle, in SI units and the chassis frame: origin at the drive-axle centre, x ahead, y left, z up."""

    name: str
    urdf: Path
    description: str = field(repr=False)
    """Its URDF in the form that is loaded; see `canonical`."""
    joints: dict[str, str]
    """Names of the joints that move: `left_drive`, `right_drive`, and of each caster that swivels `swivel` and
    `caster_roll`, from the second one on with its number."""
    links: dict[str, str]
    """Names of the links that these joints move, by the same keys."""
    limits: Limits
    contact: ContactCoefficients
    sensor: Sensor
    footprint: OrientedBox
    """The rectangle around all that sticks out, seen from above."""
    mass: float
    """Mass of all links and the payload [kg]."""
    com_ahead: float
    """Distance of the centre of mass ahead of the drive axle [m]."""
    com_left: float
    """Its distance to the left of the centre line [m]."""
    com_height: float
    """Height of the centre of mass above the ground [m]."""
    yaw_inertia: float
    """Moment of inertia about the vertical axis through the centre of mass [kg m2]."""
    track: float
    """Distance between the drive wheels [m]."""
    wheel_radius: float
    """[m]"""
    casters: tuple[Caster, ...]
    """What it stands on besides its drive wheels."""
    wheel_spin_inertia: float
    """Moment of inertia of one drive wheel about its axle [kg m2]."""
    wheel_torque: float
    """Torque limit of each drive [N m]."""
    payload: Payload | None = None
    """The load; `mass`, the centre of mass and `yaw_inertia` include it."""
    source: str = ""
    """Name of the shipped robot or path of the TOML file from which it was read."""
    delays: Delays = field(default=Delays(), repr=False)
    """Of the drive, which are no part of the vehicle's body."""

    @staticmethod
    def load(name: "str | Path | VehicleSpec") -> "VehicleSpec":
        """Reads a shipped robot or a TOML file; see `urdf.load_vehicle`."""
        from nnql_bullet.vehicle.urdf import load_vehicle

        return load_vehicle(name)

    @staticmethod
    def from_toml(path: str | Path) -> "VehicleSpec":
        """Reads a robot's TOML file and its URDF; see `urdf.load_vehicle`."""
        return VehicleSpec.load(path)

    @staticmethod
    def from_urdf(path: str | Path) -> "VehicleSpec":
        """Reads a robot's URDF or xacro, with the limits that suit it; see `translation.read_robot`."""
        from nnql_bullet.vehicle.translation import read_robot

        return read_robot(path).vehicle

    @property
    def digest(self) -> str:
        """Hash of all that it drives by, wherever its files are, whatever its name is and however it looks."""
        from nnql_bullet.vehicle.description import without_looks

        said = replace(self, name="", urdf=Path(), source="")
        return sha256(f"{said!r} {without_looks(self.description)}".encode()).hexdigest()[:16]

    @property
    def sensor_height(self) -> float:
        """Height of the rays above the ground [m]."""
        return self.sensor.position[2] + self.wheel_radius

    @property
    def rolling_mass(self) -> float:
        """Effective mass for acceleration straight ahead: the mass and the inertia of the spinning wheels [kg]."""
        drive = self.wheel_spin_inertia / self.wheel_radius**2
        return self.mass + 2 * drive + sum(its.spin_inertia / its.radius**2 for its in self.casters)

    @property
    def contacts(self) -> tuple[tuple[float, float], ...]:
        """Where it stands, x ahead of the drive axle and y left: drive wheels, casters [m]."""
        return ((0.0, self.track / 2), (0.0, -self.track / 2), *((its.x, its.y) for its in self.casters))

    @property
    def stance(self) -> "Stance":
        """How the ground carries it; see `stances.stance`."""
        from nnql_bullet.vehicle.stances import stance

        return stance(self)

    @property
    def wheelbase(self) -> float:
        """Distance from the drive axle to the casters, negative behind it; see `Stance.wheelbase` for several [m]."""
        return self.stance.wheelbase

    @property
    def rear_share(self) -> float:
        """Share of the weight on both drive wheels together at rest."""
        stance = self.stance
        return stance.axle_share - self.com_ahead / stance.wheelbase

    def gripping(self, friction: float) -> "VehicleSpec":
        """Returns the vehicle with another friction of its wheels."""
        return replace(self, contact=replace(self.contact, wheel_friction=friction))

    def driving_at(self, speed: float | None) -> "VehicleSpec":
        """Returns the vehicle with another speed of its own [m/s]; None keeps it."""
        return self if speed is None else replace(self, limits=replace(self.limits, speed=speed))

    @property
    def length(self) -> float:
        """Length of the footprint [m]."""
        return 2 * self.footprint.half_length

    @property
    def width(self) -> float:
        """Width of the footprint [m]."""
        return 2 * self.footprint.half_width
