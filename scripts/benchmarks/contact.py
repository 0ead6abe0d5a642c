"""Contact physics through the environment, against a bare loop around the engine that does the same work.

The bare loop replays the recorded wheel commands with `stepSimulation` and one batch of 72 rays a control step, and
does nothing else. Both must end in the very same pose, so the engine's work is equal and the ratio is what everything
around it costs. Building the worlds does not count.
"""

import time
from dataclasses import dataclass, field
from unittest.mock import patch

import gymnasium

from nnql_bullet.geometry import Array
from nnql_bullet.gym_env.single import TricycleEnv
from nnql_bullet.sim.bullet import OBSTACLE, PHYSICS, BulletEngine
from nnql_bullet.sim.bullet import bullet as pybullet
from nnql_bullet.sim.engines import ContactSimulator
from nnql_bullet.vehicle.controller import COMMAND_RATE
from nnql_bullet.worlds.spec import WorldSpec

from .drives import hand_rule, quickest


@dataclass
class Record:
    """What was done in one drive: enough to do it again, through the environment and without it."""

    actions: list[int] = field(default_factory=list)
    commands: list[list[float]] = field(default_factory=list)
    """Wheel speeds [rad/s]."""
    rays: list[tuple[Array, Array]] = field(default_factory=list)
    """Begins and ends [m], the first from the start."""


def contact_over_bare(seeds: range, rounds: int, steps: int) -> dict[str, float]:
    """The environment's speed over the bare loop's, by physics settings."""
    return {physics: _ratio(physics, seeds, rounds, steps) for physics in PHYSICS}


def _ratio(physics: str, seeds: range, rounds: int, steps: int) -> float:
    environment = gymnasium.make("nnql_bullet/Tricycle-v0", physics=physics)
    inner = environment.unwrapped
    assert isinstance(inner, TricycleEnv) and isinstance(inner.simulator, ContactSimulator)
    (engine,) = inner.simulator.engines
    assert isinstance(engine, BulletEngine)
    spent = {"environment": 0.0, "bare": 0.0}
    for seed in seeds:
        record, world = _recorded(environment, seed, steps), inner.world(seed)
        end = engine.pose()
        sides = {
            "environment": lambda seed=seed, record=record: _drive(environment, seed, record),
            "bare": lambda world=world, record=record: _replay(engine, world, record),
        }
        for name, seconds in quickest(sides, rounds).items():
            spent[name] += seconds
            if engine.pose() != end:
                raise RuntimeError(f"the drive ended in {end}, doing it again in {engine.pose()}")
    environment.close()
    return spent["bare"] / spent["environment"]


def _recorded(environment: gymnasium.Env, seed: int, most: int) -> Record:
    """Drives one world by the hand rule and takes down what is done."""
    record = Record()
    motors, ray_test_batch = pybullet.setJointMotorControlArray, pybullet.rayTestBatch

    def command(*arguments: object, targetVelocities: list[float], **options: object) -> None:
        record.commands.append(targetVelocities)
        motors(*arguments, targetVelocities=targetVelocities, **options)

    def cast(begins: Array, ends: Array, **options: int) -> object:
        record.rays.append((begins.copy(), ends.copy()))
        return ray_test_batch(begins, ends, **options)

    patched = {"setJointMotorControlArray": command, "rayTestBatch": cast}
    with patch.multiple(pybullet, **patched):
        observation, _ = environment.reset(options={"world_seed": seed})
        for _ in range(most):
            record.actions.append(int(hand_rule(observation)))
            observation, _, terminated, truncated, _ = environment.step(record.actions[-1])
            if terminated or truncated:
                break
    return record


def _drive(environment: gymnasium.Env, seed: int, record: Record) -> float:
    """The same through the environment; how long it took [s]."""
    environment.reset(options={"world_seed": seed})
    begin = time.perf_counter()
    for action in record.actions:
        environment.step(action)
    return time.perf_counter() - begin


def _replay(engine: BulletEngine, world: WorldSpec, record: Record) -> float:
    """The same as a bare loop; how long it took [s]."""
    engine.reset(world)
    engine.command_wheels(*record.commands[0])  # from here on the wheels are driven ones
    step, motors, rays = pybullet.stepSimulation, pybullet.setJointMotorControlArray, pybullet.rayTestBatch
    client, body, wheels = engine.client, engine.body, (engine.left, engine.right)
    mode, torques = pybullet.VELOCITY_CONTROL, (engine.vehicle.wheel_torque,) * 2
    per_command = round(1 / COMMAND_RATE / engine.physics.time_step)
    per_control = round(engine.drive.decision_period * COMMAND_RATE)
    scans = iter(record.rays[1:])
    with engine.own_threshold():
        begin = time.perf_counter()
        for number, speeds in enumerate(record.commands, 1):
            motors(body, wheels, mode, targetVelocities=speeds, forces=torques, physicsClientId=client)
            for _ in range(per_command):
                step(client)
            if number % per_control == 0:
                rays(*next(scans), collisionFilterMask=OBSTACLE, physicsClientId=client)
        return time.perf_counter() - begin
