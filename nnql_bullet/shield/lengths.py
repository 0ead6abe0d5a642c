"""Options of the shield, and the lengths that follow from them for a vehicle.

A length that is not given is a multiple of the vehicle's turning radius, its stopping distance or its sensor's range.
"""

from dataclasses import dataclass
from math import hypot, pi, sin

from nnql_bullet.config import options
from nnql_bullet.errors import UserError
from nnql_bullet.types import NonNegative, Positive, Reach
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.limits import turning_deceleration
from nnql_bullet.vehicle.scale import length_scale, turning_radius
from nnql_bullet.vehicle.spec import VehicleSpec

GRIP_SHARE = 0.9
"""Fraction of the hardest braking that load and friction allow, which the prediction counts on."""
MARGIN, TIGHT_MARGIN, LOOK_AHEAD, CORRIDOR = 0.3, 0.06, 2.0, 6.0
"""Of the shipped vehicle [m]; see `ShieldOptions`."""
BOX_SPEED, STANDSTILL = 0.5, 0.025
"""Speed at which moving obstacles may come nearer, and speed below which a vehicle stands, as shares of the drive's."""


@options
class ShieldOptions:
    """Options of the shield: the clearance that it keeps, and how far ahead. What is not given follows the vehicle."""

    least_width: Positive | None = None
    """Width from which on an obstacle is avoided even where it stands between two rays [m]. By default the least that
    the rays cannot miss within the stopping distance; the vehicle slows down for a smaller one."""
    margin: Reach | None = None
    """Smallest clearance between the footprint and what was scanned [m]; 0.3 m for the shipped vehicle."""
    tight_margin: Reach | None = None
    """The same for a vehicle that stands and has no other way out, and from obstacles that may stand unseen [m]; 0.06 m
    for the shipped vehicle."""
    look_ahead: Reach | None = None
    """Distance along every action that has to be clear [m]; more where a control period and braking take more. 2 m for
    the shipped vehicle."""
    corridor: Reach | None = None
    """Distance within which there has to be a place to turn round on the spot [m]; 6 m for the shipped vehicle."""
    box_speed: NonNegative | None = None
    """Speed at which moving obstacles may come nearer [m/s]; by default half of the vehicle's."""
    recovers: bool = True
    """Whether the shield leads an agent that gets no nearer to the target (see `recovery`)."""


@dataclass(frozen=True, slots=True)
class Lengths:
    """What `ShieldOptions` come to for a vehicle."""

    scale: float
    """See `vehicle.scale`."""
    turning_radius: float
    """Largest distance of the footprint from the rear-axle centre [m]."""
    deceleration: float
    """That the vehicle reaches when it brakes [m/s2]."""
    stopping_distance: float
    """Distance up to a stop from the drive's speed, with one more control period before [m]."""
    least_width: float
    margin: float
    tight_margin: float
    look_ahead: float
    corridor: float
    box_speed: float
    standstill: float
    """Speed below which the vehicle stands [m/s]."""

    def times(self, length: float) -> float:
        """A length that is stated for the shipped vehicle [m], for this one."""
        return length * self.scale


def lengths_of(options: ShieldOptions, vehicle: VehicleSpec, drive: DriveOptions) -> Lengths:
    """Works out the lengths of a shield.

    Args:
        options: Of the shield.
        vehicle: The vehicle with its load and grip.
        drive: How decisions reach the wheels.

    Raises:
        UserError: If obstacles of the least width could stand unseen right beside the vehicle.
    """
    scale = length_scale(vehicle.footprint)
    deceleration = min(vehicle.limits.acceleration, GRIP_SHARE * turning_deceleration(vehicle, drive.speed))
    stop = drive.speed * drive.decision_period + drive.speed * drive.speed / (2 * deceleration)
    tight = _or(options.tight_margin, TIGHT_MARGIN * scale)
    least = missed_width(vehicle, tight)
    if options.least_width is not None and options.least_width < least:
        raise UserError(
            f"shield: obstacles of {options.least_width:g} m may stand unseen right beside '{vehicle.name}' with "
            f"{vehicle.sensor.rays} rays; least_width must be at least {least:.3f} m, or the rays more"
        )
    return Lengths(
        scale=scale,
        turning_radius=turning_radius(vehicle.footprint),
        deceleration=deceleration,
        stopping_distance=stop,
        least_width=_or(options.least_width, missed_width(vehicle, tight + stop)),
        margin=_or(options.margin, MARGIN * scale),
        tight_margin=tight,
        look_ahead=max(_or(options.look_ahead, LOOK_AHEAD * scale), stop),
        corridor=_or(options.corridor, CORRIDOR * scale),
        box_speed=_or(options.box_speed, BOX_SPEED * drive.speed),
        standstill=STANDSTILL * drive.speed,
    )


def missed_width(vehicle: VehicleSpec, ahead: float) -> float:
    """The largest width that a disc between two rays can have so far ahead of the vehicle's corners [m]."""
    box, (x, y, _) = vehicle.footprint, vehicle.sensor.position
    far = hypot(box.x + box.half_length + ahead - x, abs(box.y - y) + box.half_width)
    sine = sin(pi / vehicle.sensor.rays)
    return 2 * far * sine / (1 - sine)  # the disc's centre is farther by its radius


def _or(given: float | None, derived: float) -> float:
    return derived if given is None else given
