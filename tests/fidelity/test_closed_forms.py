"""The vehicle in the engine against mechanics on paper.

Tolerances are those measured for the reference settings; `fast` has to keep the same ones here, because none of these
rows is proportional to the time step by nature.
"""

from collections.abc import Callable
from dataclasses import replace
from math import degrees, hypot, radians
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import tomlkit

from nnql_bullet.geometry import Pose
from nnql_bullet.sim.base import DriveOptions
from nnql_bullet.sim.bullet import PHYSICS, BulletSimulator
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

G = 9.81
ROBOTS = Path(__file__).resolve().parents[2] / "robots"
REST = Pose(100.0, 100.0, 0.3)

# The vehicle as designed (mass [kg], lengths [m]): composite centre of mass `A` ahead of the rear axle and `H` high.
MASS, TRACK, WHEELBASE, RADIUS, CASTER_RADIUS = 120.0, 0.60, 0.70, 0.125, 0.05
A = (104.5 * 0.12 + 1.5 * 0.72 + 2.0 * 0.70) / MASS
H = (104.5 * 0.22 + 2 * 6.0 * 0.125 + 1.5 * 0.07 + 2.0 * 0.05) / MASS
EFFECTIVE_MASS = MASS + 2 * 0.046874 / RADIUS**2 + 0.0025 / CASTER_RADIUS**2  # wheels spin up too
REAR_SHARE = 1 - A / WHEELBASE

Make = Callable[..., BulletSimulator]


@pytest.fixture
def frictionless(vehicle: VehicleSpec) -> VehicleSpec:
    return replace(vehicle, contact=replace(vehicle.contact, rolling_friction=0.0, spinning_friction=0.0))


def run(simulator: BulletSimulator, seconds: float) -> None:
    for _ in range(round(seconds / simulator.physics.time_step)):
        simulator.step()


def test_engine_holds_mass_and_inertia_of_the_urdf(simulator_of: Make, empty_world: WorldSpec, physics: str) -> None:
    simulator = simulator_of(physics)
    simulator.reset(empty_world)
    links = {link.attrib["name"]: link for link in ElementTree.parse(ROBOTS / "tricycle.urdf").getroot().iter("link")}
    held = simulator.link_dynamics()
    assert held.keys() == links.keys()
    for name, link in links.items():
        inertial: Any = link.find("inertial")
        inertia = [float(inertial.find("inertia").attrib[axis]) for axis in ("ixx", "iyy", "izz")]
        assert held[name].mass == pytest.approx(float(inertial.find("mass").attrib["value"]), rel=1e-6)
        assert held[name].inertia == pytest.approx(inertia, rel=1e-6)


def test_engine_holds_friction_of_the_toml(simulator_of: Make, empty_world: WorldSpec, physics: str) -> None:
    simulator = simulator_of(physics)
    simulator.reset(empty_world)
    contact: Any = tomlkit.parse((ROBOTS / "tricycle.toml").read_text())["contact"]
    resistance = (contact["rolling_friction"], contact["spinning_friction"])
    held = simulator.link_dynamics()
    for wheel in ("left_wheel", "right_wheel", "caster_wheel"):
        assert held[wheel].friction == pytest.approx(contact["wheel_friction"], rel=1e-6)
    for wheel in ("left_wheel", "right_wheel"):
        assert (held[wheel].rolling_friction, held[wheel].spinning_friction) == pytest.approx(resistance, rel=1e-6)
    for link in ("caster_wheel", "chassis", "fork"):
        assert (held[link].rolling_friction, held[link].spinning_friction) == (0.0, 0.0)


def test_vehicle_settles_on_its_wheel_radii_with_the_static_loads(
    simulator_of: Make, empty_world: WorldSpec, physics: str
) -> None:
    simulator = simulator_of(physics)
    simulator.place(empty_world, REST, 0.0)
    run(simulator, 2.0)
    assert simulator.wheel_heights() == pytest.approx((RADIUS, RADIUS, CASTER_RADIUS), abs=0.05e-3)
    rear, front = MASS * G * REAR_SHARE / 2, MASS * G * A / WHEELBASE
    assert simulator.wheel_loads() == pytest.approx((rear, rear, front), rel=5e-3)


def test_free_fall_is_g_t(simulator_of: Make, empty_world: WorldSpec, physics: str) -> None:
    simulator = simulator_of(physics)
    simulator.place(empty_world, REST, 0.0, height=50.0, ground=False)
    run(simulator, 1.0)
    assert simulator.time() == pytest.approx(1.0, rel=1e-9)
    assert simulator.velocity()[2] == pytest.approx(-G, rel=1e-6)


def test_rest_stays_rest(simulator_of: Make, empty_world: WorldSpec, physics: str) -> None:
    simulator = simulator_of(physics)
    simulator.place(empty_world, REST, 0.0)
    simulator.command_wheels(0.0, 0.0)
    run(simulator, 10.0)
    pose = simulator.pose()
    assert hypot(pose.x - REST.x, pose.y - REST.y) < 0.5e-3


def test_wheel_torque_accelerates_mass_and_wheels(
    simulator_of: Make, empty_world: WorldSpec, frictionless: VehicleSpec, physics: str
) -> None:
    torque = 20.0
    simulator = simulator_of(physics, replace(frictionless, wheel_torque=torque))
    simulator.place(empty_world, Pose(100.0, 100.0, 0.0), 0.0)
    simulator.command_wheels(1e6, 1e6)  # out of reach: the motors give their limit
    run(simulator, 1.0)
    assert simulator.speed() == pytest.approx(2 * torque / (RADIUS * EFFECTIVE_MASS), rel=1e-3)


def test_free_wheels_coast_at_constant_speed(
    simulator_of: Make, empty_world: WorldSpec, frictionless: VehicleSpec, physics: str
) -> None:
    simulator = simulator_of(physics, frictionless)
    simulator.place(empty_world, empty_world.start, 2.0)
    simulator.release_wheels()
    run(simulator, 5.0)
    assert simulator.speed() == pytest.approx(2.0, abs=1e-3)


def test_rolling_resistance_slows_free_wheels(simulator_of: Make, empty_world: WorldSpec, physics: str) -> None:
    simulator = simulator_of(physics)
    simulator.place(empty_world, empty_world.start, 2.0)
    simulator.release_wheels()
    run(simulator, 1.0)
    arm, load = 0.002, MASS * G * REAR_SHARE / 2
    assert simulator.speed() == pytest.approx(2.0 - 2 * arm * load / (RADIUS * EFFECTIVE_MASS), abs=5e-3)


@pytest.mark.parametrize("turn", [0.0, 30.0, 60.0, -60.0])
def test_driven_wheels_overcome_rolling_resistance(
    vehicle: VehicleSpec, empty_world: WorldSpec, physics: str, turn: float
) -> None:
    ends = []
    for resists_driven in (True, False):
        settings = replace(PHYSICS[physics], resists_driven=resists_driven)
        simulator = BulletSimulator(vehicle, DriveOptions(decision_period=1.0), settings)
        simulator.reset(empty_world)
        ends.append(simulator.advance(radians(turn)).pose)
        simulator.close()
    with_it, without = ends
    assert hypot(with_it.x - without.x, with_it.y - without.y) < 0.5e-3
    assert degrees(with_it.yaw) == pytest.approx(degrees(without.yaw), abs=0.005)


def test_straight_40_m(simulator_of: Make, empty_world: WorldSpec, physics: str) -> None:
    simulator = simulator_of(physics)
    simulator.reset(empty_world)
    path_length = sum(simulator.advance(0.0).path_length for _ in range(40))
    pose = simulator.pose()
    assert pose.x - empty_world.start.x == pytest.approx(40.0, rel=2e-4)
    assert path_length == pytest.approx(40.0, rel=2e-4)
    assert abs(pose.y - empty_world.start.y) < 10e-3
    assert abs(degrees(pose.yaw)) < 0.02


def test_steady_turn_keeps_speed_and_yaw_rate_and_shifts_load_outwards(
    simulator_of: Make, empty_world: WorldSpec, physics: str
) -> None:
    v, w = 2.0, 1.0
    simulator = simulator_of(physics)
    simulator.place(empty_world, empty_world.start, v)
    for rate in np.linspace(0.0, w, 60):
        simulator.command_wheels((v - rate * TRACK / 2) / RADIUS, (v + rate * TRACK / 2) / RADIUS)
        run(simulator, 1 / 120)
    run(simulator, 2.0)
    seen = []
    for _ in range(round(1.0 / simulator.physics.time_step)):
        simulator.step()
        seen.append((*simulator.wheel_loads(), simulator.speed(), simulator.yaw_rate()))
    left, right, front, speed, yaw_rate = np.mean(seen, axis=0)
    # The centripetal force m v w acts at the centre of mass, m a w^2 towards the rear; the caster takes no side force.
    backward = MASS * A * w * w * H / WHEELBASE
    rear, shift = MASS * G * REAR_SHARE / 2 - backward / 2, MASS * v * w * H / TRACK
    assert speed == pytest.approx(v, rel=2e-3)
    assert yaw_rate == pytest.approx(w, rel=7e-3)
    assert left == pytest.approx(rear - shift, rel=1.5e-2)
    assert right == pytest.approx(rear + shift, rel=1.5e-2)
    assert front == pytest.approx(MASS * G * A / WHEELBASE + backward, rel=1.5e-2)


def test_locked_wheels_brake_by_grip(
    simulator_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec, physics: str
) -> None:
    mu, v = 0.8, 2.0
    simulator = simulator_of(physics, replace(vehicle, wheel_torque=400.0))
    simulator.place(empty_world, empty_world.start, v)
    simulator.command_wheels(0.0, 0.0)
    run(simulator, 1.0)
    deceleration = mu * G * REAR_SHARE / (1 + mu * H / WHEELBASE)
    assert simulator.speed() == pytest.approx(0.0, abs=1e-3)
    assert simulator.pose().x - empty_world.start.x == pytest.approx(v * v / (2 * deceleration), rel=2e-2)
