"""What a vehicle can follow: turns through the space of speed, period, heading change, friction and payload.

A turn goes from straight to straight in exactly one control period. Its yaw rate rises for a third of the period, holds
for a third and falls for a third, whatever the vehicle's own limits say: here they are what is asked about.
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
from nnql_bullet.vehicle.limits import TurnDemand, static_rear_load, tip_angle, turn_demand
from nnql_bullet.vehicle.payload import deck_load, loaded
from nnql_bullet.vehicle.profiles import plan_turn
from nnql_bullet.vehicle.spec import VehicleSpec

RAMP = 1 / 3
"""Share of the period in which the yaw rate rises; it falls in another."""
HEADINGS = (0.0, radians(60.0), radians(75.0))
"""From which a turn is tried; the worst counts [rad]. Friction with axes fixed in the world grips worse in some
directions than in others: PyBullet's worst at the last two, for a turn to the left."""
SETTLE_TIME = 0.25
"""Run straight before the turn [s]."""

HEADING_TOLERANCE = radians(1.0)
"""What may be left of a heading change [rad]. At the end of the sensors' 10 m it is 0.17 m, about the free way that
worlds leave on either side of the vehicle (0.15 m). A turn that grips ends fifty times closer."""
SLIP_TOLERANCE = 0.05
"""Of the speed. Rolling wheels creep by less than 1 % of it, so this is sliding."""

Quantity = Literal["speed", "heading_change", "friction", "payload"]


@dataclass(frozen=True, slots=True)
class Case:
    """A turn to be followed, and under which conditions."""

    speed: float
    """[m/s]"""
    period: float
    """From straight to straight [s]."""
    heading_change: float
    """[rad]"""
    friction: float
    """Of the wheels, against ground of friction 1."""
    payload: float
    """On the middle of the deck [kg]."""


@dataclass(frozen=True, slots=True)
class Slice:
    """A quantity against the control period, all else as in a base case."""

    quantity: Quantity
    values: tuple[float, ...]
    periods: tuple[float, ...]
    base: Case

    def case(self, value: float, period: float) -> Case:
        """The case at one point."""
        return replace(self.base, period=period, **{self.quantity: value})

    @property
    def cases(self) -> tuple[Case, ...]:
        """All of them, period by period for each value."""
        return tuple(self.case(value, period) for value in self.values for period in self.periods)


@dataclass(frozen=True, slots=True)
class Followed:
    """How a turn was followed, at the worst of all headings."""

    heading_error: float
    """Heading change less the one reached, at the end of the period [rad]."""
    slip: float
    """Largest speed of a drive wheel's contact point over the ground, over the vehicle's speed."""
    least_load: float
    """On either drive wheel over its load at rest, mean over a look of the controller."""
    tip_margin: float
    """What is left until a drive wheel lifts: 1 - |N_left - N_right|/(N_left + N_right), at its least. The quotient is
    the load transfer ratio (Rajamani, Vehicle Dynamics and Control, ch. 15)."""
    friction_used: float
    """Of what both drive wheels have together, largest mean over a look of the controller."""
    wheel_friction_used: float
    """The same of either drive wheel."""
    roll: float
    """Largest angle of the axle out of the level, in the turn and one period straight after it [rad]."""
    fell_over: bool
    """Whether it rolled, in that time, beyond where a vehicle comes back from."""

    @property
    def follows(self) -> bool:
        """Whether the vehicle did what it was told: on course, without sliding, on all its wheels."""
        on_course = abs(self.heading_error) <= HEADING_TOLERANCE and self.slip <= SLIP_TOLERANCE
        return on_course and self.least_load > 0 and not self.fell_over


@dataclass(frozen=True, slots=True)
class EnvelopeTask:
    """One case to be measured."""

    bench: Bench
    """Its vehicle carries nothing."""
    case: Case
    seed: int
    """Its number. Nothing here is random."""


@dataclass(frozen=True, slots=True)
class Result:
    """A case, measured and on paper."""

    case: Case
    measured: Followed
    on_paper: TurnDemand
    torque_limit: float
    """Of each drive [N m]."""

    @property
    def allowed(self) -> bool:
        """Whether the vehicle can follow it by what stands on paper: enough friction, enough torque, no wheel lifts."""
        asked = self.on_paper
        return asked.friction <= self.case.friction and asked.torque <= self.torque_limit and asked.least_load > 0


def base_case(vehicle: VehicleSpec) -> Case:
    """What the vehicle was made for: the largest turn of the paper, at its speed, in one second."""
    return Case(paper.SPEED, 1.0, max(paper.TURNS), vehicle.contact.wheel_friction, 0.0)


def envelope_slices(vehicle: VehicleSpec) -> tuple[Slice, ...]:
    """The four slices through the base case."""
    base = base_case(vehicle)
    periods = tuple(tenths / 10 for tenths in range(6, 16))
    values: dict[Quantity, tuple[float, ...]] = {
        "speed": (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0),
        "heading_change": tuple(radians(angle) for angle in (15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 105.0, 120.0)),
        "friction": (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0),
        "payload": (0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0),
    }
    return tuple(
        Slice(quantity, tuple(sorted({*points, getattr(base, quantity)})), periods, base)
        for quantity, points in values.items()
    )


def envelope_tasks(bench: Bench, slices: tuple[Slice, ...]) -> list[EnvelopeTask]:
    """Every case of these slices once."""
    cases = dict.fromkeys(chain.from_iterable(each.cases for each in slices))
    return [EnvelopeTask(bench, case, number) for number, case in enumerate(cases)]


def vehicle_for(vehicle: VehicleSpec, case: Case) -> VehicleSpec:
    """The vehicle under the conditions of a case, with limits that make its turn last exactly the period.

    Raises:
        UserError: If it carries a payload already.
    """
    peak = case.heading_change / ((1 - RAMP) * case.period)
    return replace(
        loaded(vehicle, deck_load(vehicle, case.payload)).gripping(case.friction),
        limits=replace(vehicle.limits, yaw_rate=abs(peak), yaw_acceleration=abs(peak) / (RAMP * case.period)),
    )


def on_paper(vehicle: VehicleSpec, case: Case) -> TurnDemand:
    """What a case asks for.

    Raises:
        UserError: If the vehicle carries a payload already.
    """
    made = vehicle_for(vehicle, case)
    return turn_demand(made, case.speed, plan_turn(0.0, case.heading_change, made.limits))


def measure_turn(task: EnvelopeTask) -> Result:
    """Drives one case in contact physics, on open ground, from each of the headings.

    Raises:
        UserError: If the period is not a whole number of wheel commands, or the vehicle carries a payload already.
    """
    case = task.case
    vehicle = vehicle_for(task.bench.vehicle, case)
    with task.bench.open_engine(vehicle, decision_period=case.period, speed=case.speed) as engine:
        measured = worst_of([_followed(engine, case, heading) for heading in HEADINGS])
    return Result(case, measured, on_paper(task.bench.vehicle, case), vehicle.wheel_torque)


def worst_of(turns: Sequence[Followed]) -> Followed:
    """The worst of each quantity."""
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
    """One turn from a heading [rad], and a control period straight after it."""
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
