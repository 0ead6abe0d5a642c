"""Probes of physics: a quantity by a closed form, its value in an engine, and the accepted difference."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

from nnql_bullet import paper
from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.sim.engines import EngineName, PhysicsName, contact_engine
from nnql_bullet.vehicle.controller import DriveOptions, own_speed
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

MIDDLE = Pose(100.0, 100.0, 0.0)
"""Middle of the open ground."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """One quantity: its value by mechanics, its value in the engine, and the accepted range."""

    quantity: str
    unit: str
    """Empty for a bare number."""
    expected: float
    measured: float
    low: float
    """Smallest accepted value."""
    high: float
    """Largest accepted value."""

    @property
    def ok(self) -> bool:
        """Whether the measured value is accepted; NaN never is."""
        return bool(self.low <= self.measured <= self.high)


def close_to(
    quantity: str, unit: str, expected: float, measured: float, absolute: float = 0.0, relative: float = 0.0
) -> Measurement:
    """Makes a measurement with a tolerance on both sides: the larger of an absolute and a relative one."""
    tolerance = max(absolute, relative * abs(expected))
    return Measurement(quantity, unit, expected, measured, expected - tolerance, expected + tolerance)


def at_most(quantity: str, unit: str, limit: float, measured: float, slack: float = 0.0) -> Measurement:
    """Makes a measurement from 0 to a limit; the share `slack` above the limit is accepted."""
    return Measurement(quantity, unit, limit, measured, 0.0, limit * (1 + slack))


def step_factor(engine: ContactEngine) -> float:
    """Computes a factor for tolerances that grow with the time step: 1 at 1/240 s and below."""
    return max(1.0, 240 * engine.time_step)


@dataclass(frozen=True, slots=True)
class Bench:
    """A vehicle and an engine, for probes."""

    vehicle: VehicleSpec
    """The vehicle as its files describe it; expected values follow from it."""
    engine: EngineName = "bullet"
    physics: PhysicsName = "reference"
    refinement: int = 1
    """Divisor of the settings' time step."""

    @property
    def size(self) -> float:
        """Factor of tolerances that are lengths: 1 for the shipped vehicle, whose lengths they are stated for."""
        return length_scale(self.vehicle.footprint)

    @property
    def pace(self) -> float:
        """Factor of tolerances that are speeds, or ways in a physics step: 1 for the shipped vehicle's speed."""
        return own_speed(self.vehicle) / paper.SPEED

    @contextmanager
    def open_engine(self, vehicle: VehicleSpec | None = None, **drive: float) -> Iterator[ContactEngine]:
        """Makes an engine and closes it at the end.

        Args:
            vehicle: The vehicle in it, the bench's by default.
            drive: See `DriveOptions`; the speed is at most the vehicle's own by default.
        """
        vehicle = vehicle or self.vehicle
        options = DriveOptions(**{"speed": own_speed(vehicle), **drive})
        with closing(contact_engine(self.engine, self.physics, vehicle, options, self.refinement)) as made:
            yield made


@dataclass(frozen=True, slots=True)
class Probe:
    """A test of an engine against mechanics."""

    name: str
    title: str
    closed_form: str
    """The formula of mechanics."""
    source: str
    """Source of the formula."""
    measure: Callable[[Bench], list[Measurement]]
    applies: Callable[[VehicleSpec], bool] = lambda vehicle: True
    """Whether the formula holds for a vehicle; the probe is left out for others."""


def open_ground(*boxes: OrientedBox, start: Pose = MIDDLE) -> WorldSpec:
    """Makes an arena of 200 m x 200 m with the given boxes only."""
    return WorldSpec("open ground", 0, 200.0, 200.0, boxes, start, (190.0, 190.0), 2.0, 1.5)
