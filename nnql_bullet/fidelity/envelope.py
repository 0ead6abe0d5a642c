"""The envelope: the turns that a vehicle can follow, over speed, period, heading change, friction and payload.

A turn goes from straight to straight in exactly one control period. Its yaw rate rises for a third of the period, is
constant for a third and falls for a third; the vehicle's own limits do not apply.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import radians
from typing import Literal

import numpy as np

from nnql_bullet import paper
from nnql_bullet.fidelity.probe import MIDDLE, Bench, open_ground
from nnql_bullet.fidelity.turning import follow_turn, forces_by_command, largest_slip
from nnql_bullet.geometry import wrap_angle
from nnql_bullet.sim.base import SAMPLE_EVERY
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.vehicle.controller import own_speed
from nnql_bullet.vehicle.limits import TurnDemand, static_rear_load, tip_angle, turn_demand
from nnql_bullet.vehicle.payload import deck_load, fitting_mass, loaded
from nnql_bullet.vehicle.profiles import plan_turn
from nnql_bullet.vehicle.spec import VehicleSpec

RAMP = 1 / 3
"""Share of the period in which the yaw rate rises, and share in which it falls."""
HEADINGS = (0.0, radians(60.0), radians(75.0))
"""Start headings of each turn [rad]; the worst counts. Some engines fix friction directions in the world."""
SETTLE_TIME = 0.25
"""Time straight ahead before the turn [s]."""

HEADING_TOLERANCE = radians(1.0)
"""Largest heading error of a turn that the vehicle follows [rad].

At the sensors' range it shifts the path by about the free space that worlds leave on either side of the vehicle.
"""
SLIP_TOLERANCE = 0.05
"""Largest slip of a turn that the vehicle follows, over its speed; above it the wheels slide."""

Quantity = Literal["speed", "heading_change", "friction", "payload"]


@dataclass(frozen=True, slots=True)
class Case:
    """A turn and its conditions."""

    speed: float
    """[m/s]"""
    period: float
    """Time from straight to straight [s]."""
    heading_change: float
    """[rad]"""
    friction: float
    """Friction of the wheels on ground of coefficient 1."""
    payload: float
    """Load on the middle of the deck [kg]."""


@dataclass(frozen=True, slots=True)
class Slice:
    """Cases that vary a quantity and the control period of a base case."""

    quantity: Quantity
    values: tuple[float, ...]
    periods: tuple[float, ...]
    base: Case

    def case(self, value: float, period: float) -> Case:
        """Returns the case at one point."""
        return replace(self.base, period=period, **{self.quantity: value})

    @property
    def cases(self) -> tuple[Case, ...]:
        """All cases, by value and then by period."""
        return tuple(self.case(value, period) for value in self.values for period in self.periods)


@dataclass(frozen=True, slots=True)
class Followed:
    """Measures of a turn, each at its worst start heading."""

    heading_error: float
    """Commanded less reached heading change at the end of the period [rad]."""
    slip: float
    """Largest speed of a drive wheel's contact point over the ground, over the vehicle's speed."""
    least_load: float
    """Smallest load on a drive wheel over its load at rest; mean over the controller's period."""
    tip_margin: float
    """Smallest margin before a drive wheel lifts: 1 - |N_left - N_right|/(N_left + N_right). The quotient is the load
    transfer ratio (Rajamani, Vehicle Dynamics and Control, ch. 15)."""
    friction_used: float
    """Largest share of the available friction that both wheels use together; mean over the controller's period."""
    wheel_friction_used: float
    """Largest share of the available friction that one drive wheel uses; mean over the controller's period."""
    roll: float
    """Largest roll angle of the axle, in the turn and one straight period after it [rad]."""
    fell_over: bool
    """Whether the roll angle exceeded the tip angle."""

    @property
    def follows(self) -> bool:
        """Whether the vehicle followed the turn: on course, without sliding, on all its wheels."""
        on_course = abs(self.heading_error) <= HEADING_TOLERANCE and self.slip <= SLIP_TOLERANCE
        return on_course and self.least_load > 0 and not self.fell_over


@dataclass(frozen=True, slots=True)
class EnvelopeTask:
    """A case to measure."""

    bench: Bench
    """The bench; its vehicle carries no payload."""
    case: Case
    seed: int
    """Number of the task; nothing is random."""


@dataclass(frozen=True, slots=True)
class Result:
    """Measured and computed values of a case."""

    case: Case
    measured: Followed
    on_paper: TurnDemand
    torque_limit: float
    """Torque limit of each drive [N m]."""

    @property
    def allowed(self) -> bool:
        """Whether the computed demand is within friction and torque, and no wheel lifts."""
        asked = self.on_paper
        return asked.friction <= self.case.friction and asked.torque <= self.torque_limit and asked.least_load > 0


def base_case(vehicle: VehicleSpec) -> Case:
    """Makes the base case: the paper's largest turn at the vehicle's own speed, in one second."""
    return Case(own_speed(vehicle), 1.0, max(paper.TURNS), vehicle.contact.wheel_friction, 0.0)


def envelope_slices(vehicle: VehicleSpec) -> tuple[Slice, ...]:
    """Makes the four slices through the base case."""
    base = base_case(vehicle)
    periods = tuple(tenths / 10 for tenths in range(6, 16))
    values: dict[Quantity, tuple[float, ...]] = {
        "speed": tuple(share * base.speed for share in (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)),
        "heading_change": tuple(radians(angle) for angle in (15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 105.0, 120.0)),
        "friction": (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0),
        "payload": tuple(fitting_mass(vehicle, sixths / 6) for sixths in range(7)),
    }
    return tuple(
        Slice(quantity, tuple(sorted({*points, getattr(base, quantity)})), periods, base)
        for quantity, points in values.items()
    )


def envelope_tasks(bench: Bench, slices: tuple[Slice, ...]) -> list[EnvelopeTask]:
    """Lists tasks for all cases of some slices, each case once."""
    cases = dict.fromkeys(chain.from_iterable(each.cases for each in slices))
    return [EnvelopeTask(bench, case, number) for number, case in enumerate(cases)]


def vehicle_for(vehicle: VehicleSpec, case: Case) -> VehicleSpec:
    """Returns the vehicle under the conditions of a case, with limits so that its turn lasts exactly the period.

    Raises:
        UserError: If the vehicle already carries a payload.
    """
    peak = case.heading_change / ((1 - RAMP) * case.period)
    return replace(
        loaded(vehicle, deck_load(vehicle, case.payload)).gripping(case.friction),
        limits=replace(vehicle.limits, yaw_rate=abs(peak), yaw_acceleration=abs(peak) / (RAMP * case.period)),
    )


def on_paper(vehicle: VehicleSpec, case: Case) -> TurnDemand:
    """Computes the demand of a case.

    Raises:
        UserError: If the vehicle already carries a payload.
    """
    made = vehicle_for(vehicle, case)
    return turn_demand(made, case.speed, plan_turn(0.0, case.heading_change, made.limits))


def measure_turn(task: EnvelopeTask) -> Result:
    """Measures a case in contact physics, on open ground, from each of the start headings.

    Raises:
        UserError: If the period is not a whole number of wheel commands, or the vehicle already carries a payload.
    """
    case = task.case
    vehicle = vehicle_for(task.bench.vehicle, case)
    with task.bench.open_engine(vehicle, decision_period=case.period, speed=case.speed) as engine:
        measured = worst_of([_followed(engine, case, heading) for heading in HEADINGS])
    return Result(case, measured, on_paper(task.bench.vehicle, case), vehicle.wheel_torque)


def worst_of(turns: Sequence[Followed]) -> Followed:
    """Finds the worst value of each measure over several turns."""
    return Followed(
        heading_error=max((turn.heading_error for turn in turns), key=abs),
        slip=max(turn.slip for turn in turns),
        least_load=min(turn.least_load for turn in turns),
        tip_margin=min(turn.tip_margin for turn in turns),
        friction_used=max(turn.friction_used for turn in turns),
        wheel_friction_used=max(turn.wheel_friction_used for turn in turns),
        roll=max(turn.roll for turn in turns),
        fell_over=any(turn.fell_over for turn in turns),
    )


def _followed(engine: ContactEngine, case: Case, heading: float) -> Followed:
    """Measures one turn from a start heading [rad], and a straight control period after it."""
    vehicle = engine.vehicle
    engine.reset(open_ground(start=replace(MIDDLE, yaw=heading)))
    rolling = case.speed / vehicle.wheel_radius
    engine.command_wheels(rolling, rolling)
    engine.run(SETTLE_TIME)
    begin = engine.pose()
    turn, after = follow_turn(engine, case.heading_change), follow_turn(engine, 0.0)
    forces = forces_by_command(turn, SAMPLE_EVERY)
    left, right = forces.normal[:, :2].T
    roll = max(abs(instant.roll) for instant in chain(turn, after))
    return Followed(
        heading_error=wrap_angle(begin.yaw + case.heading_change - turn[-1].pose.yaw),
        slip=largest_slip(turn, case.speed),
        least_load=float(forces.normal[:, :2].min()) / static_rear_load(vehicle),
        tip_margin=float(np.min(1 - abs(left - right) / np.maximum(left + right, 1e-9))),
        friction_used=float(forces.used_by_axle(vehicle).max()),
        wheel_friction_used=float(forces.used(vehicle).max()),
        roll=roll,
        fell_over=roll > tip_angle(vehicle),
    )
