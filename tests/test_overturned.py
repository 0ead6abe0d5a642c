"""Vehicles that tip over: by the closed form of the static threshold, and in turns."""

from collections.abc import Iterator
from contextlib import closing
from math import atan, cos, radians, sin, tan
from typing import get_args

import numpy as np
import pytest

from nnql_bullet.constants import GRAVITY
from nnql_bullet.env import Navigation
from nnql_bullet.sim.base import Simulator
from nnql_bullet.sim.contact import OVERTURNED
from nnql_bullet.sim.engines import EngineName, contact_engine, contact_simulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import ENDINGS, NO_ENDING, StateProperty, TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.payload import loaded
from nnql_bullet.vehicle.spec import Payload, VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

ENGINES: tuple[EngineName, ...] = get_args(EngineName)
LEFT_60 = 2


@pytest.fixture(scope="module")
def top_heavy(vehicle: VehicleSpec) -> VehicleSpec:
    """Lifts an inner wheel at 1.5 m/s2, half of what its sharpest turn asks."""
    return loaded(vehicle, Payload(mass=200.0, ahead=vehicle.com_ahead, height=2.4))


def threshold(vehicle: VehicleSpec, side: int) -> float:
    """Slope on which the centre of mass is above the line that the vehicle tips about [rad].

    Seen from above and along the slope, the line from a drive wheel to the caster is (T/2)(1 - a/L) from the centre of
    mass, and the drive axle a behind it.

    Args:
        vehicle: A vehicle with one caster ahead.
        side: 1 for a slope down to the left, -1 to the right, 0 backwards.
    """
    a, ahead = vehicle.com_ahead, vehicle.casters[0].x
    return atan((vehicle.track / 2 * (1 - a / ahead) if side else a) / vehicle.com_height)


@pytest.mark.parametrize("side", [1, -1, 0])
@pytest.mark.parametrize("engine", ENGINES)
def test_a_vehicle_overturns_on_slopes_above_the_closed_form_and_stands_below(
    top_heavy: VehicleSpec, empty_world: WorldSpec, engine: EngineName, side: int
) -> None:
    slope = threshold(top_heavy, side)
    with closing(contact_engine(engine, "fast", top_heavy, DriveOptions(speed=1e-6))) as held:
        for share, falls in ((0.95, False), (1.05, True)):
            held.reset(empty_world)
            held.lock_joints()
            down = share * slope
            along = (0.0, side) if side else (-1.0, 0.0)
            held.set_gravity((along[0] * GRAVITY * sin(down), along[1] * GRAVITY * sin(down), -GRAVITY * cos(down)))
            held.run(6.0)
            motion = held.advance(0.0)
            assert (motion.overturned, motion.touching) == (falls, False), share


def ends(simulator: Simulator, world: WorldSpec, steps: int) -> Iterator[tuple[str | None, int]]:
    """The endings and state properties of a vehicle that turns to the left all the time."""
    navigation = Navigation(simulator, TaskOptions(max_steps=steps))
    navigation.reset({0: world})
    for _ in range(steps):
        transition = navigation.step(np.array([LEFT_60]))
        (end,) = transition.ending.tolist()
        yield None if end == NO_ENDING else ENDINGS[end], int(transition.s_t.state_property[0])
        if end != NO_ENDING:
            return


@pytest.mark.parametrize("engine", ENGINES)
def test_a_top_heavy_vehicle_overturns_in_a_fast_turn_and_the_shipped_one_does_not(
    vehicle: VehicleSpec, top_heavy: VehicleSpec, empty_world: WorldSpec, engine: EngineName
) -> None:
    assert GRAVITY * tan(threshold(top_heavy, 1)) < DriveOptions().speed * top_heavy.limits.yaw_rate / 2
    with closing(contact_simulator(engine, "fast", top_heavy, DriveOptions(), 1)) as simulator:
        *_, (end, state) = ends(simulator, empty_world, 20)
        assert (end, state) == ("overturned", StateProperty.FAILURE)
    with closing(contact_simulator(engine, "fast", vehicle, DriveOptions(), 1)) as simulator:
        *_, (end, _) = ends(simulator, empty_world, 20)
        assert end == "timeout"


def test_the_kinematic_model_never_overturns(top_heavy: VehicleSpec, empty_world: WorldSpec) -> None:
    with closing(KinematicSimulator(top_heavy, DriveOptions(), 1)) as simulator:
        *_, (end, _) = ends(simulator, empty_world, 20)
        assert end == "timeout"


def test_it_has_overturned_beyond_60_degrees() -> None:
    assert radians(60) == pytest.approx(OVERTURNED)
