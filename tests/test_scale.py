"""Lengths follow the vehicle: of a world and a vehicle that are k times as large, every drive is k times as long."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from nnql_bullet.agents import Trainable
from nnql_bullet.env import Navigation
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Circle, OrientedBox, Pose, Shape
from nnql_bullet.run_config import changed
from nnql_bullet.runs import load_policy
from nnql_bullet.task import NO_ENDING, TaskOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.source import World
from nnql_bullet.worlds.spec import WorldSpec

TRICYCLE = VehicleSpec.load("tricycle")
POLICIES = (
    "paper",
    "tuned",
    "double_dqn",
    "straight",
    "random",
    "hand_rule",
    "potential_field",
    "fuzzy",
    "vfh",
    "look_ahead",
    "dwa",
    "pure_pursuit",
    "mppi",
    "orca",
    pytest.param("guided_search", marks=pytest.mark.slow),
    pytest.param("distilled", marks=pytest.mark.slow),
)


def larger(box: OrientedBox, k: float) -> OrientedBox:
    return OrientedBox(k * box.x, k * box.y, k * box.half_length, k * box.half_width, box.yaw)


def larger_vehicle(vehicle: VehicleSpec, k: float) -> VehicleSpec:
    """As the kinematic model has it: it knows no masses."""
    ahead, left, up = vehicle.sensor.position
    lengths = ("x", "y", "radius", "trail")
    casters = [replace(one, **{name: k * getattr(one, name) for name in lengths}) for one in vehicle.casters]
    return replace(
        vehicle,
        footprint=larger(vehicle.footprint, k),
        sensor=replace(vehicle.sensor, position=(k * ahead, k * left, k * up), range=k * vehicle.sensor.range),
        limits=replace(vehicle.limits, acceleration=k * vehicle.limits.acceleration),
        track=k * vehicle.track,
        wheel_radius=k * vehicle.wheel_radius,
        casters=tuple(casters),
    )


def larger_world(world: WorldSpec, k: float) -> WorldSpec:
    def shape(its: Shape) -> Shape:
        return Circle(k * its.x, k * its.y, k * its.radius) if isinstance(its, Circle) else larger(its, k)

    return replace(
        world,
        width=k * world.width,
        depth=k * world.depth,
        obstacles=tuple(map(shape, world.obstacles)),
        start=Pose(k * world.start.x, k * world.start.y, world.start.yaw),
        target=(k * world.target[0], k * world.target[1]),
        target_radius=k * world.target_radius,
        obstacle_height=k * world.obstacle_height,
    )


def driven(policy: str, k: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Poses (steps, n, 3) and actions (steps, n) of drives by vehicles k times as large in worlds k times as large."""
    loaded = load_policy(policy).experiment
    worlds = [World.load(kind).draw(seed) for kind in ("cover_20", "traps") for seed in (0, 1)]
    n = len(worlds)
    experiment = Experiment(changed(loaded.config, simulator="kinematic", vehicles=n))
    experiment.vehicle = larger_vehicle(loaded.vehicle, k)
    experiment.config = changed(experiment.config, drive={"speed": 2.0 * k})
    if isinstance(experiment.agent, Trainable):
        experiment.agent.load_state_dict(loaded.trainable.state_dict())
    with closing(experiment.new_simulator(workers=1)) as simulator:
        navigation = Navigation(simulator, experiment.task)
        navigation.reset({i: larger_world(world, k) for i, world in enumerate(worlds)})
        state = experiment.agent.reset(experiment.agent.initial_state(n), {i: i for i in range(n)})
        active, poses, chosen = np.ones(n, np.bool_), [], []
        for _ in range(60):
            actions, state = experiment.agent.act(navigation.observation, state)
            t = navigation.step(actions, active)
            poses.append(t.motion.pose / [k, k, 1.0])
            chosen.append(np.where(active, actions, -1))
            active &= t.ending == NO_ENDING
    return np.array(poses), np.array(chosen)


@pytest.mark.parametrize("k", [0.125, 2.0])
@pytest.mark.parametrize("policy", POLICIES)
def test_drives_are_as_large_as_vehicle_and_world(policy: str, k: float) -> None:
    if policy == "fuzzy":
        pytest.importorskip("skfuzzy")
    (poses, actions), (usual_poses, usual_actions) = driven(policy, k), driven(policy, 1.0)
    assert len(np.unique(usual_actions)) > 2 or policy == "straight"
    assert np.array_equal(actions, usual_actions)
    assert poses == pytest.approx(usual_poses, abs=1e-9)


def test_the_lengths_of_the_shipped_vehicle_are_those_that_are_stated() -> None:
    assert length_scale(TRICYCLE.footprint) == 1.0
    task = TaskOptions(other_distance=1.0, hysteresis=0.5)
    assert task.scaled(1.0, 10.0) == task
    assert (task.scaled(2.0, 8.0).front_distance, task.scaled(2.0, 8.0).front_side_distance) == (8.0, 7.0)
