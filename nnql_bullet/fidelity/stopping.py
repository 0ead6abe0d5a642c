"""Stopping distances of a vehicle, and the largest speed from which it stops within the range of its sensors."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np
from scipy.optimize import brentq

from nnql_bullet.errors import UserError
from nnql_bullet.fidelity.envelope import SETTLE_TIME
from nnql_bullet.fidelity.probe import Bench, open_ground
from nnql_bullet.fidelity.turning import mean_forces
from nnql_bullet.sim.base import SAMPLE_EVERY
from nnql_bullet.vehicle.controller import DriveOptions, own_speed
from nnql_bullet.vehicle.limits import Braking, braking, braking_rear_load, static_rear_load
from nnql_bullet.vehicle.payload import deck_load, fitting_mass, loaded
from nnql_bullet.vehicle.spec import VehicleSpec

STANDSTILL_SPEED = 0.01
"""Speed below which a vehicle stands [m/s]."""
TIME_LIMIT_FACTOR = 10.0
"""Time limit for a stop, over the computed stopping time plus one second."""
REACTION = DriveOptions().decision_period
"""Longest time until the brakes act [s]: an obstacle may come into sight just after a decision."""


@dataclass(frozen=True, slots=True)
class StopConditions:
    """Conditions of a stop."""

    payload: float
    """Load on the middle of the deck [kg]."""
    friction: float
    """Friction of the wheels on ground of coefficient 1."""


@dataclass(frozen=True, slots=True)
class StopTask:
    """A stop to measure."""

    bench: Bench
    """The bench; its vehicle carries no payload."""
    conditions: StopConditions
    speed: float
    """[m/s]"""
    seed: int
    """Number of the task; nothing is random."""


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop from a speed, straight ahead, with wheels commanded to stop at once."""

    conditions: StopConditions
    speed: float
    """[m/s]"""
    distance: float
    """Measured distance after the command [m]."""
    distance_on_paper: float
    """Computed distance [m]."""
    heading_drift: float
    """Heading change at the end [rad]."""
    friction_used: float
    """Largest share of the available friction that a drive wheel uses; mean over the controller's period."""
    least_load: float
    """Smallest load on a drive wheel over its load at rest; mean over the controller's period."""
    least_load_on_paper: float
    """Computed load on a drive wheel over its load at rest."""


@dataclass(frozen=True, slots=True)
class SafeSpeed:
    """The largest speed from which the vehicle stops within the range of its sensors."""

    conditions: StopConditions
    measured: float | None
    """Measured speed; None if it is above all measured speeds [m/s]."""
    on_paper: float
    """Computed speed [m/s]."""
    braking: Braking


def stopping_tasks(bench: Bench) -> list[StopTask]:
    """Lists tasks for all stops: several speeds, loads and frictions, including the vehicle's own."""
    frictions = sorted({0.4, 0.6, 0.8, bench.vehicle.contact.wheel_friction})
    payloads = [fitting_mass(bench.vehicle, thirds / 3) for thirds in range(3)]
    conditions = [StopConditions(payload, friction) for friction in frictions for payload in payloads]
    half = own_speed(bench.vehicle) / 2
    cases = [(each, half * count) for each in conditions for count in range(1, 13)]
    return [StopTask(bench, each, speed, number) for number, (each, speed) in enumerate(cases)]


def braking_vehicle(vehicle: VehicleSpec, conditions: StopConditions) -> VehicleSpec:
    """Returns the vehicle under some conditions.

    Raises:
        UserError: If the vehicle already carries a payload.
    """
    return loaded(vehicle, deck_load(vehicle, conditions.payload)).gripping(conditions.friction)


def measure_stop(task: StopTask) -> Stop:
    """Measures a stop in contact physics, on open ground.

    Raises:
        UserError: If the vehicle already carries a payload, or does not stop.
    """
    vehicle = braking_vehicle(task.bench.vehicle, task.conditions)
    paper_says = braking(vehicle)
    with task.bench.open_engine(vehicle, speed=task.speed) as engine:
        engine.reset(open_ground())
        rolling = task.speed / vehicle.wheel_radius
        engine.command_wheels(rolling, rolling)
        engine.run(SETTLE_TIME)
        begin, began = engine.pose(), engine.time()
        time_limit = TIME_LIMIT_FACTOR * (1 + task.speed / paper_says.deceleration)
        times, forces = [], []
        engine.command_wheels(0.0, 0.0)
        while engine.speed() > STANDSTILL_SPEED:
            if engine.time() - began > time_limit:
                friction = task.conditions.friction
                raise UserError(f"the vehicle does not stop from {task.speed:g} m/s on friction {friction:g}; raise it")
            engine.step()
            times.append(engine.time() - began)
            forces.append(engine.wheel_forces())
        end = engine.pose()
    seen = mean_forces(times, forces, SAMPLE_EVERY)
    return Stop(
        conditions=task.conditions,
        speed=task.speed,
        distance=hypot(end.x - begin.x, end.y - begin.y),
        distance_on_paper=paper_says.stopping_distance(task.speed),
        heading_drift=end.yaw - begin.yaw,
        friction_used=float(seen.used(vehicle).max()),
        least_load=float(seen.normal[:, :2].min()) / static_rear_load(vehicle),
        least_load_on_paper=braking_rear_load(vehicle, paper_says.deceleration),
    )


def sight(vehicle: VehicleSpec) -> float:
    """Computes the range of the sensors ahead of the vehicle's front edge [m]."""
    front = vehicle.footprint.x + vehicle.footprint.half_length
    return vehicle.sensor.range - (front - vehicle.sensor.position[0])


def safe_speeds(vehicle: VehicleSpec, stops: Sequence[Stop]) -> list[SafeSpeed]:
    """Finds the largest safe speed under each of the conditions of some stops.

    Between measured speeds, and from zero to the first, the braking distance over the speed is interpolated linearly.
    The interpolation is exact for a constant deceleration.
    """
    visible, found = sight(vehicle), []
    for conditions in dict.fromkeys(stop.conditions for stop in stops):
        limit = braking(braking_vehicle(vehicle, conditions))
        measured = _largest_within(visible, [stop for stop in stops if stop.conditions == conditions])
        found.append(SafeSpeed(conditions, measured, limit.largest_speed(visible, REACTION), limit))
    return found


def _largest_within(visible: float, stops: Sequence[Stop]) -> float | None:
    """Finds the speed v at which v t + D(v) reaches a distance [m]; D(v)/v is linear between measured speeds."""
    ordered = sorted(stops, key=lambda stop: stop.speed)
    speeds = [0.0, *(stop.speed for stop in ordered)]
    lasting = [0.0, *(stop.distance / stop.speed for stop in ordered)]

    def beyond(speed: float) -> float:
        return float(speed * (REACTION + np.interp(speed, speeds, lasting)) - visible)

    return None if beyond(speeds[-1]) < 0 else float(brentq(beyond, 0.0, speeds[-1], xtol=1e-6))
