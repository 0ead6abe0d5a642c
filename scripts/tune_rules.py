"""Tunes rules with options of their own, each with the same number of trials on the same validation worlds.

A trial is the success of a rule, bare, in a few validation worlds of each kind in the kinematic model; Optuna draws the
values, the first trial has the defaults. What is done is kept in --out, so the same command goes on after an interrupt.

    python scripts/tune_rules.py                      # some ten minutes on an idle core
    python scripts/tune_rules.py dwa --trials 40
"""

import argparse
import json
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from nnql_bullet.config import to_values
from nnql_bullet.evaluation.search import Search
from nnql_bullet.evaluation.space import Trial, best_of, read_space
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import load_config
from nnql_bullet.rollout import run_episodes
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.seeding import VALIDATION_WORLDS
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.worlds.spec import WorldSpec

WORLDS = ("cover_10", "cover_20", "traps", "aisles", "moving", "rooms")
FIRST = 1000
"""First of the validation worlds; an evaluation takes those from 0 on."""
SPACES: dict[str, dict[str, dict[str, Any]]] = {
    "dwa": {
        "horizon": {"low": 1.5, "high": 5.0},
        "margin": {"low": 0.05, "high": 0.5},
        "distance_weight": {"low": 0.1, "high": 4.0, "log": True},
        "velocity_weight": {"low": 0.1, "high": 4.0, "log": True},
    },
    "pure_pursuit": {
        "look_ahead_time": {"low": 0.5, "high": 3.0},
        "least_radius": {"low": 0.5, "high": 4.0},
        "proximity": {"low": 0.2, "high": 1.5},
        "rotate_degrees": {"low": 45.0, "high": 150.0},
    },
    "mppi": {
        "decisions": {"low": 4, "high": 9},
        "temperature": {"low": 0.01, "high": 0.5, "log": True},
        "margin": {"low": 0.05, "high": 0.3},
        "room": {"low": 0.3, "high": 1.2},
        "obstacle_weight": {"low": 0.2, "high": 5.0, "log": True},
        "heading_weight": {"low": 0.1, "high": 3.0, "log": True},
    },
    "orca": {
        "horizon": {"low": 0.75, "high": 4.0},
        "margin": {"low": 0.1, "high": 0.8},
        "window": {"low": 3.0, "high": 10.0},
        "least_share": {"low": 0.01, "high": 0.2},
    },
}
PLANNED = ("pure_pursuit",)
"""Rules that are tuned on a plan: without one they never drive around anything."""


def success(config: RunConfig, worlds: Sequence[WorldSpec]) -> float:
    """Share of worlds in which a rule reaches its target."""
    experiment = Experiment(config)
    with closing(KinematicSimulator(experiment.vehicle, experiment.config.drive, len(worlds))) as fleet:
        summaries = run_episodes(experiment.new_navigation(fleet), worlds, experiment.agent)
    return float(np.mean([its.ending == "goal" for its in summaries]))


def tune(kind: str, trials: int, count: int, file: Path) -> Trial:
    """The best of so many trials, each in the first so many worlds of each kind."""
    plan: dict[str, Any] = {"plan": {}} if kind in PLANNED else {}
    base = load_config("paper", {"simulator": "kinematic", "agent": {"kind": kind}, **plan})
    space = read_space({"agent": SPACES[kind]}, base, kind, kind)
    seeds = VALIDATION_WORLDS[FIRST : FIRST + count]
    worlds = [Experiment(changed(base, world=world)).world(seed) for world in WORLDS for seed in seeds]
    search = Search(file, space, json.dumps([SPACES[kind], to_values(base), WORLDS, count]), seed=0, random=trials // 2)
    for number in range(len(search.trials), trials):
        values = search.draw(number, number)
        reached = success(space.options(values), worlds)
        search.add([Trial(number, values, (reached,), "trained")])
        print(kind, number, f"{reached:.3f}", {name: float(f"{its:.3g}") for name, its in values.items()}, flush=True)
    best = best_of(search.trials)
    assert best is not None
    return best


def main() -> None:
    """Tunes and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rules", nargs="*", default=list(SPACES), metavar="RULE")
    parser.add_argument("--trials", type=int, default=24, metavar="N", help="of each rule (default 24)")
    parser.add_argument("--worlds", type=int, default=8, metavar="N", help="of each kind (default 8)")
    parser.add_argument("--out", type=Path, default=Path("runs/tune_rules"), metavar="DIR")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for kind in arguments.rules:
        best = tune(kind, arguments.trials, arguments.worlds, arguments.out / f"{kind}.db")
        print(f"{kind}: {best.score:.1%} by trial {best.number}: {json.dumps(dict(best.values))}")


if __name__ == "__main__":
    main()
