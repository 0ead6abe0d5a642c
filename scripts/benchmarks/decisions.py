"""Processor time of one decision of each rule, beside that of `straight`, over the same observations."""

import time
from collections.abc import Callable
from contextlib import closing
from functools import partial

import numpy as np

from nnql_bullet.agents import RULES
from nnql_bullet.env import Navigation, Observation
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import load_config
from nnql_bullet.rollout import Policy
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import StateProperty

from .drives import hand_rule, quickest

WORLD = "cover_15"
BESIDE = "straight"


def decision_times(decisions: int, rounds: int) -> dict[str, float]:
    """Mean processor time of a decision of one vehicle by rule [s], the shortest of some rounds."""
    experiment = Experiment(load_config("paper", {"world": WORLD, "simulator": "kinematic"}))
    seen = _observations(experiment, decisions)
    sides: dict[str, Callable[[], float]] = {}
    for kind in RULES:
        agent = load_config("paper", {"agent": {"kind": kind}}).agent
        sides[kind] = partial(_spent, agent.make_agent(0, experiment.vehicle, experiment.config.drive), seen)
        sides[kind]()  # compiles
    return quickest(sides, rounds)


def _observations(experiment: Experiment, count: int) -> list[Observation]:
    """What one vehicle sees that the hand rule drives through world after world."""
    seen: list[Observation] = []
    with closing(KinematicSimulator(experiment.vehicle, experiment.config.drive, 1)) as fleet:
        navigation = Navigation(fleet, experiment.task)
        for seed in range(count):
            navigation.reset({0: experiment.world(seed)})
            while len(seen) < count and navigation.observation.state_property[0] <= StateProperty.NON_SAFE:
                seen.append(navigation.observation)
                navigation.step(hand_rule(navigation.observation.readings))
            if len(seen) == count:
                break
    return seen


def _spent(agent: Policy, seen: list[Observation]) -> float:
    """Mean processor time of a decision [s]."""
    state = agent.reset(agent.initial_state(1), {0: 0})
    begin = time.process_time()
    for observation in seen:
        _, state = agent.act(observation, state)
    return float(np.divide(time.process_time() - begin, len(seen)))
