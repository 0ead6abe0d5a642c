"""The kinematic model against contact physics, and against closed forms of its own."""

from math import hypot, pi, radians

import numpy as np
import pytest
from helpers import Alone
from hypothesis import given, settings
from hypothesis import strategies as st

from nnql_bullet.blocks import bounds_of, cast_rays
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import OrientedBox, Pose, as_rows, clearance_at, ray_distances
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sensing import ray_angles, sector_readings
from nnql_bullet.sim.bullet import PHYSICS, BulletEngine
from nnql_bullet.sim.kinematic import KinematicSimulator, _caster_rates
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.worlds.source import load_world
from nnql_bullet.worlds.spec import WorldSpec

EMPTY = WorldSpec("empty", 0, 100.0, 100.0, (), Pose(50.0, 50.0, 0.0), (95.0, 95.0), 1.0, 1.5)


@pytest.fixture(scope="module")
def pair(vehicle):
    drive = DriveOptions(decision_period=1.0)
    kinematic, contact = (
        Alone(KinematicSimulator(vehicle, drive, 1)),
        BulletEngine(vehicle, drive, PHYSICS["reference"]),
    )
    yield kinematic, contact
    contact.close()


@pytest.mark.parametrize("degrees", [0, 30, 60, -30, -60])
def test_each_of_the_five_turns_ends_where_contact_physics_ends(pair, degrees):
    motions = []
    for simulator in pair:
        simulator.reset(EMPTY)
        motions.append(simulator.advance(radians(degrees)))
    ideal, contact = motions
    assert hypot(ideal.pose.x - contact.pose.x, ideal.pose.y - contact.pose.y) < 0.006
    assert abs(ideal.pose.yaw - contact.pose.yaw) < radians(0.1)
    assert ideal.heading_error == pytest.approx(contact.heading_error, abs=radians(0.1))
    assert ideal.path_length == pytest.approx(contact.path_length, abs=0.006)


def test_the_joints_turn_as_in_contact_physics(pair):
    traces = []
    for simulator in pair:
        simulator.reset(EMPTY)
        traces.append([])
        for degrees in (60, 0, -30):
            simulator.advance(radians(degrees), traces[-1])
    ideal, contact = (np.array([sample.joint_angles for sample in trace]) for trace in traces)
    assert ideal.shape == contact.shape == (90, 4)
    assert np.abs(ideal - contact).max(axis=0) == pytest.approx([0, 0, 0, 0], abs=0.05)
    times = [[sample.time for sample in trace] for trace in traces]
    assert times[0] == pytest.approx(times[1])


@pytest.mark.parametrize("seed", range(4))
def test_readings_agree_with_contact_physics_on_random_worlds(vehicle, seed):
    world = load_world("cover_20").draw(seed, 0.8)
    kinematic, contact = (
        Alone(KinematicSimulator(vehicle, DriveOptions(), 1)),
        BulletEngine(vehicle, DriveOptions(), PHYSICS["fast"]),
    )
    for simulator in (kinematic, contact):
        simulator.reset(world)
    for _ in range(4):
        assert np.abs(sector_readings(kinematic.rays) - sector_readings(contact.scan())).max() < 0.002
        if contact.advance(0.0).touching:
            break
        kinematic.advance(0.0)
    contact.close()


boxes = st.lists(
    st.builds(OrientedBox, *[st.floats(-12, 12)] * 2, *[st.floats(0.1, 6)] * 2, st.floats(-pi, pi)), max_size=6
)


@given(boxes=boxes, yaw=st.floats(-pi, pi))
@settings(deadline=None, max_examples=60)
def test_the_ray_kernel_is_the_slab_method(boxes, yaw):
    rows, angles = as_rows(tuple(boxes)), ray_angles()
    distances = np.empty(len(angles))
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cast_rays(0.0, 0.0, yaw, directions, rows, bounds_of(rows), 10.0, distances)
    expected = ray_distances((0.0, 0.0), angles + yaw, rows, 10.0)
    assert distances == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(6))
def test_no_clearance_between_two_commands_is_missed(vehicle, seed):
    """The kinematic model looks only where the clearance may have become the smallest; here it is taken after every
    command."""
    world = load_world("cover_20").draw(seed, 0.8)
    footprint, turns = as_rows((vehicle.footprint,))[0], np.random.default_rng(seed)
    fleet = KinematicSimulator(vehicle, DriveOptions(), 1, threads=1)
    fleet.reset({0: world})
    for _ in range(60):
        motions, _ = fleet.advance(turns.choice(np.radians([0, 30, 60, -30, -60]), 1), np.ones(1, np.bool_))
        taken = [clearance_at(*pose, footprint, world.solids) for pose in fleet.path(0).tolist()]
        assert motions.clearance[0] == pytest.approx(min(taken), abs=1e-9)
        assert motions.touching[0] == (min(taken) == 0.0)
        assert len(taken) == 61 or motions.touching[0] or motions.at_target[0]
        if motions.touching[0] or motions.at_target[0]:
            break
    fleet.close()


def test_it_stops_at_a_wall_within_the_stride_of_one_command(vehicle):
    ahead = vehicle.footprint.x + vehicle.footprint.half_length
    wall = OrientedBox(50.0 + ahead + 0.7 + 0.5, 50.0, 0.5, 3.0)
    world = WorldSpec("wall", 0, 100.0, 100.0, (wall,), Pose(50.0, 50.0, 0.0), (95.0, 95.0), 1.0, 1.5)
    kinematic = Alone(KinematicSimulator(vehicle, DriveOptions(), 1))
    kinematic.reset(world)
    motion = kinematic.advance(0.0)
    assert motion.touching and motion.clearance == 0.0
    assert 0.7 <= motion.path_length < 0.7 + 2.0 / 120 + 1e-9


def test_it_ends_inside_the_target(vehicle):
    world = WorldSpec("target", 0, 100.0, 100.0, (), Pose(50.0, 50.0, 0.0), (51.5, 50.0), 1.0, 1.5)
    kinematic = Alone(KinematicSimulator(vehicle, DriveOptions(), 1))
    kinematic.reset(world)
    motion = kinematic.advance(0.0)
    assert motion.at_target and 0.5 <= motion.path_length < 0.5 + 2.0 / 120 + 1e-9


def test_a_caster_in_a_steady_turn_settles_at_the_angle_of_the_circle():
    speed, yaw_rate, ahead, trail = 2.0, 0.8, 0.74, 0.04
    swivel = 0.0
    for _ in range(2000):
        swivel += _caster_rates(swivel, speed, yaw_rate, ahead, 0.0, trail, 0.05)[0] / 1000
    # The wheel rolls along its own circle: its axle points at the centre of the turn, speed / yaw_rate to the left.
    x, y = ahead - trail * np.cos(swivel), -trail * np.sin(swivel)
    to_centre = np.array([-x, speed / yaw_rate - y])
    assert np.dot(to_centre, [np.cos(swivel), np.sin(swivel)]) == pytest.approx(0.0, abs=1e-6)


def test_a_run_can_be_trained_in_it():
    experiment = Experiment(RunConfig(simulator="kinematic"))
    navigation = experiment.navigation
    assert isinstance(navigation.simulator, KinematicSimulator)
    navigation.reset({0: experiment.world(0)})
    step = navigation.step(experiment.agent.act(navigation.observation, None)[0])
    assert step.motion.path_length == pytest.approx(1.0)
