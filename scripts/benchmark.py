"""Measures speed as ratios: both sides of a ratio run in this one process, in turn, so that a noisy machine hurts both.

python scripts/benchmark.py            # a table, some six minutes on 2 cores
python scripts/benchmark.py --quick    # under a minute: fewer and shorter drives, no whole trainings
python scripts/benchmark.py --json     # one object, key to number
"""

import argparse
import json
import os
import platform
from collections.abc import Callable
from importlib.metadata import version

from benchmarks.contact import contact_over_bare
from benchmarks.floor import fast_over_floor
from benchmarks.training import nnql_over_sb3, paper_training_s
from benchmarks.twin import twin_steps_per_second
from benchmarks.workers import simulator_mb, two_workers_over_one
from rich.console import Console
from rich.table import Table

CORES = os.cpu_count() or 1


def measurements(quick: bool) -> dict[str, tuple[str, Callable[[], float]]]:
    """What there is to measure: key, what it is, and how."""
    few, rounds = (range(2), 2) if quick else (range(8), 5)
    steps = 30 if quick else 60
    table: dict[str, tuple[str, Callable[[], float]]] = {
        "contact_over_bare": (
            "contact environment's speed over that of a bare loop with the same settings, the lower of both settings",
            lambda: min(contact_over_bare(few, rounds, steps).values()),
        ),
        "fast_over_floor": (
            "simulated over wall seconds, `fast` physics over the plain floor",
            lambda: fast_over_floor(few, rounds, steps),
        ),
        "two_workers_over_one": (
            "two worker processes' speed over one's, 32 vehicles",
            lambda: two_workers_over_one(*(2, 5) if quick else (6, 25)),
        ),
        "twin_steps_per_second": (
            f"control steps a second, twin, {CORES} cores, 72 rays, about 40 boxes",
            lambda: twin_steps_per_second(CORES, 2.0 if quick else 10.0),
        ),
        "paper_training_twin_s": (
            "`train --sim twin --vehicles 64`, 1000 episodes, the whole command [s]",
            lambda: paper_training_s("twin", CORES),
        ),
        "paper_training_contact_s": (
            "`train --vehicles 32`, 1000 episodes in contact physics, the whole command [s]",
            lambda: paper_training_s("bullet", CORES),
        ),
        "nnql_over_sb3": (
            "training steps a second, NNQL with one vehicle over stable-baselines3's DQN (train_freq 1)",
            lambda: nnql_over_sb3(*(2, 200) if quick else (6, 500)),
        ),
        "simulator_mb": ("memory of one contact simulator process [MB]", simulator_mb),
    }
    if quick:
        del table["paper_training_twin_s"], table["paper_training_contact_s"]
    return table


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quick", action="store_true", help="under a minute")
    arguments = parser.parse_args()
    table = Table("key", "what", "measured")
    results = {}
    progress = Console(stderr=True)
    with progress.status("") as status:
        for key, (what, measure) in measurements(arguments.quick).items():
            status.update(f"measuring {key}")
            results[key] = measure()
            table.add_row(key, what, f"{results[key]:.3g}")
    if arguments.json:
        print(json.dumps(results))
        return
    console = Console()
    console.print(table)
    names = ("pybullet", "numpy", "numba", "torch", "stable-baselines3")
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    machine = f"{CORES} cores, {platform.machine()}, {platform.python_implementation()} {platform.python_version()}"
    console.print(f"{machine}, {versions}", highlight=False)


if __name__ == "__main__":
    main()
