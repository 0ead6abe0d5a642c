"""Beyond grip: the whole vehicle slides on locked wheels, and friction is all that slows it.

The engine's friction axes are fixed in the world, along x and y. A skid along one of them is slowed as it should be. In
between only the size of the force is right, not its direction: skids are qualitative there.
"""

from collections.abc import Callable
from dataclasses import replace
from math import cos, hypot, pi, sin

import pybullet
import pytest

from nnql_bullet.sim.bullet import GRAVITY, BulletSimulator
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

SPEED = 4.0  # [m/s]

Make = Callable[..., BulletSimulator]


def skid(simulator: BulletSimulator, world: WorldSpec, direction: float) -> None:
    """Has the vehicle, which faces along x, slide in a direction [rad] with every joint locked."""
    simulator.place(world, world.start, 0.0)
    body, client = simulator.body, simulator.client
    for joint in range(pybullet.getNumJoints(body, client)):
        pybullet.resetJointState(body, joint, 0.0, 0.0, client)
        pybullet.setJointMotorControl2(body, joint, pybullet.VELOCITY_CONTROL, force=1e4, physicsClientId=client)
    velocity = [SPEED * cos(direction), SPEED * sin(direction), 0.0]
    pybullet.resetBaseVelocity(body, velocity, [0.0, 0.0, 0.0], client)


def sliding_speed(simulator: BulletSimulator) -> float:
    (vx, vy, _), _ = pybullet.getBaseVelocity(simulator.body, simulator.client)
    return hypot(vx, vy)


@pytest.mark.parametrize("friction", [0.8, 0.4])
@pytest.mark.parametrize("direction", [0.0, pi / 2], ids=["ahead", "sideways"])
def test_a_skid_along_a_friction_axis_stops_where_grip_says(
    simulator_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec, physics: str, direction: float, friction: float
) -> None:
    simulator = simulator_of(physics, replace(vehicle, contact=replace(vehicle.contact, wheel_friction=friction)))
    skid(simulator, empty_world, direction)
    while sliding_speed(simulator) > 1e-2 and simulator.time() < 3.0:
        simulator.step()
    start, pose = empty_world.start, simulator.pose()
    assert hypot(pose.x - start.x, pose.y - start.y) == pytest.approx(SPEED**2 / (2 * friction * GRAVITY), rel=3e-2)


@pytest.mark.parametrize("direction", [0.0, pi / 4, pi / 3, pi / 2])
def test_friction_never_exceeds_the_cone(
    simulator_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec, physics: str, direction: float
) -> None:
    simulator = simulator_of(physics)
    skid(simulator, empty_world, direction)
    used = []
    while sliding_speed(simulator) > SPEED / 2:
        simulator.step()
        for contact in pybullet.getContactPoints(bodyA=simulator.body, physicsClientId=simulator.client):
            normal, along, across = contact[9], contact[10], contact[12]
            if normal > 0:
                used.append(hypot(along, across) / (vehicle.contact.wheel_friction * normal))
    assert max(used) <= 1.001
    assert sum(used) / len(used) > 0.99  # it does slide
