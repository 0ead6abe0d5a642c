"""Trains with more and more vehicles in lockstep, in the kinematic model, and prints what that does to what is learned.

Every policy then drives the same validation worlds, in the kinematic model too.

    python scripts/vehicles_at_once.py --seeds 3 --vehicles 1 8 64      # as in the documentation
    python scripts/vehicles_at_once.py                                  # more of it
"""

import argparse
import sys
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np
from rich.progress import track

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.executors import ExecutorKind, make_executor

COVERS = {"5 %": "paper", "10 %": "cover_10"}


@dataclass(frozen=True)
class Trial:
    """One training and its test."""

    vehicles: int
    seed: int
    worlds: int


def successes(trial: Trial) -> list[float]:
    """Share of worlds in which the trained policy reaches the target, by cover."""
    with TemporaryDirectory() as folder:
        policy = nb.train("paper", simulator="kinematic", vehicles=trial.vehicles, seed=trial.seed, out=folder).policy
        worlds = list(COVERS.values())
        results = nb.evaluate(policy, worlds=worlds, n_worlds=trial.worlds, simulator="kinematic")
        return [row["goal"] for row in results.rows if row["world"] in worlds]


def main() -> None:
    """Runs all trials, then prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[1, 8, 32, 64, 128], help="how many at once")
    parser.add_argument("--seeds", type=int, default=8, help="training seeds of each")
    parser.add_argument("--worlds", type=int, default=300, help="validation worlds")
    parser.add_argument("--executor", choices=get_args(ExecutorKind), default="processes", help="where it runs")
    parser.add_argument("--workers", type=int, default=2, help="trainings at a time")
    a = parser.parse_args()
    try:
        executor = make_executor(a.executor, a.workers)
    except UserError as error:
        parser.error(str(error))
    trials = [Trial(vehicles, seed, a.worlds) for seed in range(a.seeds) for vehicles in a.vehicles]
    outcomes = list(track(executor.map(successes, trials), "training and testing", total=len(trials)))
    failed = [outcome for outcome in outcomes if outcome.error]
    for outcome in failed:
        print(f"{outcome.task}: {outcome.error.message}", file=sys.stderr)
    if failed:
        sys.exit(1)
    print(f"| vehicles | {' | '.join(f'{cover} cover' for cover in COVERS)} |\n|---|{'---|' * len(COVERS)}")
    for vehicles in a.vehicles:
        shares = 100 * np.array([outcome.value for outcome in outcomes if outcome.task.vehicles == vehicles])
        cells = [f"{one.mean():.1f} ({one.min():.0f}-{one.max():.0f})" for one in shares.T]
        print(f"| {vehicles} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
