"""Two worker processes against one, and what one weighs: the same vehicles, the same drives, contact physics."""

import multiprocessing
import time
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from statistics import median

from nnql_bullet.env import Navigation
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.sim.workers import WorkerSimulator
from nnql_bullet.task import NO_ENDING

from .drives import hand_rule

VEHICLES, WORLD = 64, "paper"


def two_workers_over_one(slices: int, steps: int) -> float:
    """How much sooner two workers are done with a slice of lockstep driving: the median over slices.

    One and two take turns, and do the very same, world by world.
    """
    experiment = Experiment(RunConfig(world=WORLD))
    config = experiment.config
    make = partial(contact_simulator, "bullet", config.physics, experiment.vehicle, config.drive)
    with ExitStack() as stack:
        simulators = [stack.enter_context(closing(WorkerSimulator(make, VEHICLES, workers))) for workers in (1, 2)]
        navigations = [Navigation(simulator, config.task) for simulator in simulators]
        seeds = [0, 0]
        ratios = []

        def worlds(side: int, vehicles: range | list[int]) -> dict:
            first = seeds[side]
            seeds[side] += len(vehicles)
            return {i: experiment.world(first + k) for k, i in enumerate(vehicles)}

        for side, navigation in enumerate(navigations):
            navigation.reset(worlds(side, range(VEHICLES)))
        for _ in range(slices):
            spent = []
            for side, navigation in enumerate(navigations):
                begin = time.perf_counter()
                for _ in range(steps):
                    ending = navigation.step(hand_rule(navigation.observation.readings)).ending
                    navigation.reset(worlds(side, (ending != NO_ENDING).nonzero()[0].tolist()))
                spent.append(time.perf_counter() - begin)
            ratios.append(spent[0] / spent[1])
        if (navigations[0].observation.readings != navigations[1].observation.readings).any():
            raise RuntimeError("one worker and two did not do the same")
    return median(ratios)


def simulator_mb() -> float:
    """Resident memory of a worker process with one vehicle in a world [MB = 10^6 bytes]."""
    experiment = Experiment(RunConfig(world="cover_10"))
    config = experiment.config
    make = partial(contact_simulator, "bullet", config.physics, experiment.vehicle, config.drive)
    before = set(multiprocessing.active_children())
    with closing(WorkerSimulator(make, 1, 1)) as simulator:
        navigation = Navigation(simulator, config.task)
        navigation.reset({0: experiment.world(0)})
        for _ in range(20):
            navigation.step(hand_rule(navigation.observation.readings))
        (worker,) = set(multiprocessing.active_children()) - before
        status = Path(f"/proc/{worker.pid}/status").read_text(encoding="ascii")
    return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6
