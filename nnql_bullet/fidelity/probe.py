"""What a probe of physics is: a closed form, what an engine makes of it, and how far the two may be apart."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.sim.contact import ContactSimulator
from nnql_bullet.sim.engines import EngineName, PhysicsName, contact_simulator
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

MIDDLE = Pose(100.0, 100.0, 0.0)
"""Of the open ground."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """One quantity: what mechanics says, what the engine does, and what is accepted."""

    quantity: str
    unit: str
    """Empty for a bare number."""
    expected: float
    measured: float
    low: float
    """The smallest that is accepted."""
    high: float
    """The largest that is accepted."""

    @property
    def ok(self) -> bool:
        """Whether it is accepted; NaN never is."""
        return bool(self.low <= self.measured <= self.high)


def close_to(
    quantity: str, unit: str, expected: float, measured: float, absolute: float = 0.0, relative: float = 0.0
) -> Measurement:
    """A quantity that may be off by a tolerance, absolute or in proportion to what is expected, to either side."""
    tolerance = max(absolute, relative * abs(expected))
    return Measurement(quantity, unit, expected, measured, expected - tolerance, expected + tolerance)


def at_most(quantity: str, unit: str, limit: float, measured: float, slack: float = 0.0) -> Measurement:
    """A quantity that is not negative and may reach a limit, or exceed it by a share `slack` of it."""
    return Measurement(quantity, unit, limit, measured, 0.0, limit * (1 + slack))


def step_factor(simulator: ContactSimulator) -> float:
    """What a tolerance that was found at a time step of 1/240 s is multiplied by where errors grow with the step.

    A smaller step does not narrow it.
    """
    return max(1.0, 240 * simulator.time_step)


@dataclass(frozen=True, slots=True)
class Bench:
    """A vehicle in an engine, to be probed."""

    vehicle: VehicleSpec
    """As its files describe it: what is expected follows from this."""
    engine: EngineName = "bullet"
    physics: PhysicsName = "reference"
    refinement: int = 1
    """What the settings' time step is divided by."""

    @contextmanager
    def simulator(self, vehicle: VehicleSpec | None = None, **drive: float) -> Iterator[ContactSimulator]:
        """A new simulator, closed in the end.

        Args:
            vehicle: Another one than the bench's.
            drive: See `DriveOptions`.
        """
        made = contact_simulator(
            self.engine, self.physics, vehicle or self.vehicle, DriveOptions(**drive), self.refinement
        )
        with closing(made):
            yield made


@dataclass(frozen=True, slots=True)
class Probe:
    """A question to an engine that mechanics answers."""

    name: str
    title: str
    closed_form: str
    """What mechanics says, as a formula."""
    source: str
    """Where the formula stands."""
    measure: Callable[[Bench], list[Measurement]]


def open_ground(*boxes: OrientedBox, start: Pose = MIDDLE) -> WorldSpec:
    """A plain of 200 m x 200 m, with nothing on it but these boxes."""
    return WorldSpec("open ground", 0, 200.0, 200.0, boxes, start, (190.0, 190.0), 2.0, 1.5)
