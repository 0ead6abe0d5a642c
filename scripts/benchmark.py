"""Speed of contact physics through the environment, against a bare loop around the engine, in one interleaved run.

The same drives are timed twice in turn: through the Gymnasium environment, and as a bare loop that replays the
recorded wheel commands with `stepSimulation` and one batch of 72 rays a control step, and does nothing else. Both must
end in the very same pose, so the engine's work is equal and the ratio is what everything around it costs. Building the
worlds is timed apart. Of several rounds the quickest time of each world counts.

    python scripts/benchmark.py            # a table
    python scripts/benchmark.py --json     # one object
    python scripts/benchmark.py --quick    # fewer worlds
"""

import argparse
import json
import platform
import time
from dataclasses import dataclass, field
from importlib.metadata import version
from math import radians

import gymnasium
import numpy as np
from rich.console import Console
from rich.table import Table

import nnql_bullet  # noqa: F401 (registers the environment)
from nnql_bullet import paper
from nnql_bullet.env import TOWARD_TARGET
from nnql_bullet.sensing import FRONT, FRONT_LEFT, FRONT_RIGHT
from nnql_bullet.sim.base import COMMAND_RATE
from nnql_bullet.sim.bullet import OBSTACLE, PHYSICS, BulletSimulator
from nnql_bullet.sim.bullet import bullet as pybullet
from nnql_bullet.tricycle_env import TricycleEnv

LEFT_60, RIGHT_60 = paper.TURNS.index(radians(60.0)), paper.TURNS.index(radians(-60.0))
MOST_STEPS = 120


@dataclass
class Timing:
    """The drives of one physics setting, by world; each world is driven several times, and its quickest time counts."""

    steps: dict[int, int] = field(default_factory=dict)
    simulated: dict[int, float] = field(default_factory=dict)
    environment: dict[int, float] = field(default_factory=dict)
    bare: dict[int, float] = field(default_factory=dict)
    building: list[float] = field(default_factory=list)


def hand_rule(observation: np.ndarray) -> int:
    """Toward the target, but 60 degrees away from the fuller front side when something is near ahead."""
    front, left, right = observation[FRONT], observation[FRONT_LEFT], observation[FRONT_RIGHT]
    if front >= 5.0 and min(left, right) >= 3.5:
        return TOWARD_TARGET
    return RIGHT_60 if left < right else LEFT_60


class CommandLog:
    """Takes down the wheel commands that a simulator is given."""

    def __init__(self, simulator: BulletSimulator) -> None:
        self.commands: list[tuple[float, float]] = []
        self._send = simulator.command_wheels
        simulator.command_wheels = self  # type: ignore[method-assign, assignment]

    def __call__(self, left: float, right: float) -> None:
        """One command."""
        self.commands.append((left, right))
        self._send(left, right)


def drive(environment: gymnasium.Env, seed: int) -> tuple[int, float]:
    """Drives one world; how many steps, and how long they took."""
    observation, _ = environment.reset(options={"world_seed": seed})
    begin = time.perf_counter()
    over, steps = False, 0
    while not over and steps < MOST_STEPS:
        observation, _, terminated, truncated, _ = environment.step(hand_rule(observation))
        over = terminated or truncated
        steps += 1
    return steps, time.perf_counter() - begin


def replay(
    simulator: BulletSimulator, commands: list[tuple[float, float]], per_command: int, per_control: int
) -> float:
    """The bare loop; how long it took."""
    step, motor, rays = pybullet.stepSimulation, pybullet.setJointMotorControl2, pybullet.rayTestBatch
    client, body, left, right = simulator.client, simulator.body, simulator.left, simulator.right
    mode, torque = pybullet.VELOCITY_CONTROL, simulator.vehicle.wheel_torque
    angles = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    begin_rays = [[50.0, 50.0, 0.6]] * 72
    end_rays = [[50.0 + 10 * np.cos(a), 50.0 + 10 * np.sin(a), 0.6] for a in angles]
    begin = time.perf_counter()
    for number, (speed_left, speed_right) in enumerate(commands, 1):
        motor(body, left, mode, targetVelocity=speed_left, force=torque, physicsClientId=client)
        motor(body, right, mode, targetVelocity=speed_right, force=torque, physicsClientId=client)
        for _ in range(per_command):
            step(client)
        if number % per_control == 0:
            rays(begin_rays, end_rays, collisionFilterMask=OBSTACLE, physicsClientId=client)
    return time.perf_counter() - begin


def measure(physics: str, seeds: range, rounds: int) -> Timing:
    """Times the drives of one setting, environment and bare loop in turn."""
    environment = gymnasium.make("nnql_bullet/Tricycle-v0", physics=physics)
    inner = environment.unwrapped
    assert isinstance(inner, TricycleEnv)
    simulator = inner.simulator
    assert isinstance(simulator, BulletSimulator)
    per_command = round(1 / COMMAND_RATE / PHYSICS[physics].time_step)
    per_control = round(simulator.control_period * COMMAND_RATE)
    timing = Timing()
    drive(environment, seeds[0])  # compiles and warms up
    for _ in range(rounds):
        for seed in seeds:
            log = CommandLog(simulator)
            steps, seconds = drive(environment, seed)
            del simulator.command_wheels  # type: ignore[method-assign]
            end = simulator.pose()
            begin = time.perf_counter()
            world = inner.world(seed)
            simulator.reset(world)
            timing.building.append(time.perf_counter() - begin)
            bare = replay(simulator, log.commands, per_command, per_control)
            if simulator.pose() != end:
                raise RuntimeError(f"the bare loop ended in {simulator.pose()}, the environment in {end}")
            timing.environment[seed] = min(seconds, timing.environment.get(seed, seconds))
            timing.bare[seed] = min(bare, timing.bare.get(seed, bare))
            timing.steps[seed], timing.simulated[seed] = steps, len(log.commands) / COMMAND_RATE
    environment.close()
    return timing


def figures(timings: dict[str, Timing]) -> dict[str, float]:
    """The numbers of the table by their keys."""
    result = {}
    for physics, t in timings.items():
        environment = sum(t.environment.values())
        result[f"contact_over_bare_{physics}"] = sum(t.bare.values()) / environment
        result[f"steps_per_second_{physics}"] = sum(t.steps.values()) / environment
        result[f"simulated_over_wall_{physics}"] = sum(t.simulated.values()) / environment
        result[f"building_a_world_ms_{physics}"] = 1000 * float(np.median(t.building))
    return result


MEANING = {
    "contact_over_bare": "environment's speed over the bare loop's",
    "steps_per_second": "control steps a second, environment",
    "simulated_over_wall": "simulated seconds a second, environment",
    "building_a_world_ms": "drawing, checking and building a world, median [ms]",
}


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quick", action="store_true", help="under a minute")
    arguments = parser.parse_args()
    rounds, seeds = (1, range(4)) if arguments.quick else (3, range(10))
    result = figures({physics: measure(physics, seeds, rounds) for physics in ("fast", "reference")})
    if arguments.json:
        print(json.dumps(result))
        return
    table = Table("key", "what", "measured", title="one process, 0.5 s control steps, 72 rays, about 20 boxes")
    for key, value in result.items():
        what = next(text for name, text in MEANING.items() if key.startswith(name))
        table.add_row(key, what, f"{value:.3g}")
    console = Console()
    console.print(table)
    versions = ", ".join(f"{name} {version(name)}" for name in ("pybullet", "numpy", "numba"))
    console.print(f"{platform.machine()}, {platform.python_implementation()} {platform.python_version()}, {versions}")


if __name__ == "__main__":
    main()
