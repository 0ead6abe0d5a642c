"""How many control steps a second the kinematic model takes: the whole task, in worlds that are drawn before."""

import time

import numpy as np

from nnql_bullet.env import FleetNavigation
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
from nnql_bullet.task import GOES_ON

from .drives import hand_rule

VEHICLES, WORLDS, WORLD = 1024, 64, "cover_10"
"""In that world there are about 40 boxes."""


def kinematic_steps_per_second(cores: int, seconds: float) -> float:
    """Steps of many vehicles under the hand rule, whose own time does not count; each goes on in a new world."""
    experiment = Experiment(RunConfig(simulator="kinematic", world=WORLD, vehicles=VEHICLES))
    worlds = [experiment.world(seed) for seed in range(WORLDS)]
    navigation = FleetNavigation(experiment.fleet(cores), experiment.config.task)
    navigation.reset({i: worlds[i % WORLDS] for i in range(VEHICLES)})
    taken, spent = 0, 0.0
    while spent < seconds:
        actions = hand_rule(navigation.observations.readings)
        begin = time.perf_counter()
        over = np.flatnonzero(navigation.step(actions).ending != GOES_ON)
        navigation.reset({i: worlds[(i + taken) % WORLDS] for i in over.tolist()})
        spent += time.perf_counter() - begin
        taken += VEHICLES
    navigation.fleet.close()
    return taken / spent
