"""Speed in a world of many shapes over that in a world of few.

A vehicle drives in a circle in a free square; around it small boxes stand at random, in an arena of one size.
"""

import time
from math import radians

import numpy as np

from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.run_config import RunConfig, SimulatorName
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.worlds.spec import WorldSpec

from .drives import quickest

MANY, FEW = 20_000, 100
SIDE, FREE = 300.0, 20.0
"""Sides of the arena and of the free square in its middle [m]."""
TURN = radians(20.0)
"""Of each decision [rad]."""


def many_over_few(simulator: SimulatorName, rounds: int, steps: int) -> float:
    """Control steps a second among 20 000 boxes over those among 100; building the worlds does not count."""
    experiment = Experiment(RunConfig(simulator=simulator, physics="fast"))
    driven, turn = experiment.simulator, np.array([TURN])

    def drive(world: WorldSpec) -> float:
        driven.reset({0: world})
        begin = time.perf_counter()
        for _ in range(steps):
            driven.advance(turn)
        return time.perf_counter() - begin

    worlds = {count: scattered(count) for count in (FEW, MANY)}
    spent = quickest({str(count): lambda world=world: drive(world) for count, world in worlds.items()}, rounds)
    driven.close()
    return spent[str(FEW)] / spent[str(MANY)]


def scattered(count: int) -> WorldSpec:
    """A world with so many boxes of 0.6 m x 0.4 m, which may overlap, and the start in the free square."""
    generator, middle, boxes = rng(0, Stream.LAYOUT), SIDE / 2, list[OrientedBox]()
    while len(boxes) < count:
        x, y, yaw = generator.uniform((0.0, 0.0, 0.0), (SIDE, SIDE, 3.0)).tolist()
        if max(abs(x - middle), abs(y - middle)) > FREE / 2:
            boxes.append(OrientedBox(x, y, 0.3, 0.2, yaw))
    start = Pose(middle, middle, 0.0)
    return WorldSpec("scattered", 0, SIDE, SIDE, tuple(boxes), start, (SIDE - 1.0, middle), 1.0, 1.5)
