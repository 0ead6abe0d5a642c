"""Control steps a second of the whole task in the kinematic model; the worlds are drawn before."""

import time

import numpy as np

from nnql_bullet.env import Navigation
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
from nnql_bullet.task import NO_ENDING

from .drives import hand_rule

VEHICLES, WORLDS, WORLD = 1024, 64, "cover_10"
"""In that world there are about 40 boxes."""


def kinematic_steps_per_second(cores: int, seconds: float) -> float:
    """Drives many vehicles by the hand rule, whose time does not count; each goes on in world after world."""
    experiment = Experiment(RunConfig(simulator="kinematic", world=WORLD, vehicles=VEHICLES))
    worlds = [experiment.world(seed) for seed in range(WORLDS)]
    navigation = Navigation(experiment.new_simulator(cores), experiment.config.task)
    navigation.reset({i: worlds[i % WORLDS] for i in range(VEHICLES)})
    taken, spent = 0, 0.0
    while spent < seconds:
        actions = hand_rule(navigation.observation.readings)
        begin = time.perf_counter()
        over = np.flatnonzero(navigation.step(actions).ending != NO_ENDING)
        navigation.reset({i: worlds[(i + taken) % WORLDS] for i in over.tolist()})
        spent += time.perf_counter() - begin
        taken += VEHICLES
    navigation.simulator.close()
    return taken / spent
