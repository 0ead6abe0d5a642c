"""Simulated seconds a wall second in MuJoCo over those in PyBullet: one vehicle, the same turns at the same time step.

It drives in circles in a free square among boxes; rays count, building the world does not.
"""

import time
from collections.abc import Callable

import numpy as np

from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sim.engines import PhysicsName

from .drives import quickest
from .many_shapes import FEW, TURN, scattered


def mujoco_over_bullet(physics: PhysicsName, rounds: int, steps: int) -> float:
    """The ratio with some settings of physics, over so many control steps."""
    world, turn = scattered(FEW), np.array([TURN])
    simulators = {
        name: Experiment(RunConfig(simulator=name, physics=physics)).simulator for name in ("mujoco", "bullet")
    }

    def side(name: str) -> Callable[[], float]:
        def drive() -> float:
            simulators[name].reset({0: world})
            begin = time.perf_counter()
            for _ in range(steps):
                simulators[name].advance(turn)
            return time.perf_counter() - begin

        return drive

    spent = quickest({name: side(name) for name in simulators}, rounds)
    for simulator in simulators.values():
        simulator.close()
    return spent["bullet"] / spent["mujoco"]
