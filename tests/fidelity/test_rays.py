"""Rays against the analytic distance on the move, while the vehicle rears up, and in the sectors that read them."""

from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest

from nnql_bullet.geometry import OrientedBox, Pose, as_rows, ray_distances
from nnql_bullet.sensing import sector_readings
from nnql_bullet.sim.bullet import BulletEngine
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

RANGE, TOLERANCE = 10.0, 2e-3  # [m]
SIDE = 40.0
ANGLES = np.radians(np.arange(72) * 5.0 - 20.0)  # sector 0 is centred straight ahead: nine rays from -20 to 20 degrees
WALLS = (  # the arena is a hole of SIDE x SIDE
    OrientedBox(SIDE / 2, -0.5, 30.0, 0.5),
    OrientedBox(SIDE / 2, SIDE + 0.5, 30.0, 0.5),
    OrientedBox(-0.5, SIDE / 2, 0.5, 30.0),
    OrientedBox(SIDE + 0.5, SIDE / 2, 0.5, 30.0),
)

Make = Callable[..., BulletEngine]
WorldOf = Callable[..., WorldSpec]


def random_boxes(generator: np.random.Generator) -> tuple[OrientedBox, ...]:
    places = generator.uniform(0.0, SIDE, (25, 2))
    halves = generator.uniform(0.1, 3.0, (25, 2))
    yaws = generator.uniform(-pi, pi, 25)
    return tuple(OrientedBox(*map(float, (*p, *h, y))) for p, h, y in zip(places, halves, yaws, strict=True))


def origin_of(pose: Pose, vehicle: VehicleSpec) -> tuple[float, float]:
    ahead, left, _ = vehicle.sensor.position
    return pose.x + cos(pose.yaw) * ahead - sin(pose.yaw) * left, pose.y + sin(pose.yaw) * ahead + cos(pose.yaw) * left


def test_rays_read_the_analytic_distance_on_the_move(
    engine_of: Make, world_of: WorldOf, vehicle: VehicleSpec, physics: str
) -> None:
    boxes = (OrientedBox(20.0, 24.0, 6.0, 1.0, 0.1), OrientedBox(17.0, 12.0, 2.0, 1.0, 0.7))
    engine = engine_of(physics)
    engine.reset(world_of(*boxes, start=Pose(5.0, 18.0, 0.0), side=SIDE))
    for turn in (0.3, -0.6, 0.4, 0.0, -0.5, 0.5, 0.2, 0.0):
        motion = engine.advance(turn)
        assert not motion.touching
        origin = origin_of(motion.pose, vehicle)
        expected = ray_distances(origin, ANGLES + motion.pose.yaw, as_rows(boxes + WALLS), RANGE)
        # In a turn the chassis leans by less than a milliradian; a ray that slips past a corner is not compared.
        grazing = np.zeros(72, dtype=bool)
        for nudge in (-1e-3, 1e-3):
            beside = ray_distances(origin, ANGLES + motion.pose.yaw + nudge, as_rows(boxes + WALLS), RANGE)
            grazing |= np.abs(beside - expected) > 0.2
        assert engine.scan()[~grazing] == pytest.approx(expected[~grazing], abs=TOLERANCE)
        assert grazing.sum() < 4


def test_rays_do_not_see_the_ground_when_the_vehicle_rears_up(
    engine_of: Make, empty_world: WorldSpec, vehicle: VehicleSpec, physics: str
) -> None:
    engine = engine_of(physics, replace(vehicle, wheel_torque=400.0))
    engine.place(empty_world, empty_world.start, 0.0)
    engine.command_wheels(1e3, 1e3)
    for _ in range(2 * 240):
        engine.step()
        if engine.wheel_heights()[2] > 0.05 + 0.7 * sin(0.15):  # nose up by 0.15 rad: 10 m behind, 1.5 m lower
            break
    else:
        pytest.fail("the vehicle did not rear up")
    assert np.all(engine.scan() == RANGE)


def test_a_sector_reads_the_nearest_of_its_nine_rays(engine_of: Make, world_of: WorldOf, physics: str) -> None:
    engine = engine_of(physics)
    pose = Pose(20.0, 20.0, 0.5)
    engine.place(world_of(*random_boxes(np.random.default_rng(5)), side=SIDE), pose, 0.0)
    rays = engine.scan()
    assert sector_readings(rays).tolist() == [min(rays[9 * sector : 9 * sector + 9]) for sector in range(8)]


def test_a_post_is_read_in_its_own_sector_only(
    engine_of: Make, world_of: WorldOf, vehicle: VehicleSpec, physics: str
) -> None:
    pose = Pose(20.0, 20.0, 0.3)
    x, y = origin_of(pose, vehicle)
    engine = engine_of(physics)
    for sector in range(8):
        direction = pose.yaw + sector * pi / 4
        post = OrientedBox(x + 4.0 * cos(direction), y + 4.0 * sin(direction), 0.4, 0.4, direction)
        engine.place(world_of(post, side=SIDE), pose, 0.0)
        expected = [RANGE] * 8
        expected[sector] = 3.6
        assert sector_readings(engine.scan()) == pytest.approx(expected, abs=TOLERANCE)
