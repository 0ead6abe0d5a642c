"""Measures speed as ratios: both sides of a ratio run in this one process, in turn, so that a noisy machine hurts both.

python scripts/benchmark.py            # a table, some six minutes on 2 cores
python scripts/benchmark.py --quick    # a minute or two: fewer and shorter drives, no whole trainings
python scripts/benchmark.py --json     # one object, key to number
"""

import argparse
import json
import platform
from collections.abc import Callable
from functools import cache, partial
from importlib.metadata import version
from typing import get_args

from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

from nnql_bullet.machine import allowed_cores

CORES = allowed_cores()
WIDTH = 140
"""Of the table, wherever it is printed."""


def measurements(quick: bool) -> dict[str, tuple[str, Callable[[], float]]]:
    """What there is to measure: key, what it is, and how."""
    # Not at the top: worker processes import this file again, and would carry along all that these need.
    from benchmarks.contact import contact_over_bare
    from benchmarks.decisions import BESIDE, decision_times
    from benchmarks.engines import mujoco_over_bullet
    from benchmarks.floor import fast_over_floor
    from benchmarks.kinematic import kinematic_steps_per_second
    from benchmarks.many_shapes import FEW, MANY, many_over_few
    from benchmarks.rendering import film_frames_per_second, film_over_bare
    from benchmarks.training import VEHICLES, nnql_over_sb3, paper_training_s
    from benchmarks.workers import simulator_mb, two_workers_over_one

    from nnql_bullet.agents import RULES
    from nnql_bullet.run_config import SimulatorName
    from nnql_bullet.sim.engines import PhysicsName

    decisions = cache(partial(decision_times, *(60, 2) if quick else (200, 5)))  # of all rules in turn

    table: dict[str, tuple[str, Callable[[], float]]] = {
        "contact_over_bare": (
            "speed of the contact environment over a bare loop with the same settings; the lower of both settings",
            lambda: min(contact_over_bare(*(range(3), 4, 12) if quick else (range(10), 12, 20)).values()),
        ),
        "fast_over_floor": (
            "simulated over wall seconds, `fast` physics over the plain floor",
            lambda: fast_over_floor(*(range(2), 2, 20) if quick else (range(8), 5, 40)),
        ),
        "two_workers_over_one": (
            "speed of two worker processes over one's",
            lambda: two_workers_over_one(*(4, 3) if quick else (30, 4)),
        ),
        "kinematic_steps_per_second": (
            f"kinematic model, control steps a second on {CORES} cores, 72 rays, about 40 boxes",
            lambda: kinematic_steps_per_second(CORES, 2.0 if quick else 10.0),
        ),
        **{
            f"many_over_few_{simulator}": (
                f"control steps a second among {MANY} boxes over those among {FEW}, {simulator}, `fast`",
                partial(many_over_few, simulator, *(4, 30) if quick else (12, 60)),
            )
            for simulator in get_args(SimulatorName)
        },
        **{
            f"mujoco_over_bullet_{physics}": (
                f"simulated over wall seconds, MuJoCo over PyBullet, {physics}",
                partial(mujoco_over_bullet, physics, *(4, 30) if quick else (12, 60)),
            )
            for physics in get_args(PhysicsName)
        },
        **{
            f"decision_us_{kind}": (
                f"processor time of one decision of `{kind}` [us]",
                lambda kind=kind: 1e6 * decisions()[kind],
            )
            for kind in RULES
        },
        **{
            f"decision_{kind}_over_{BESIDE}": (
                f"processor time of one decision of `{kind}` over that of `{BESIDE}`",
                lambda kind=kind: decisions()[kind] / decisions()[BESIDE],
            )
            for kind in RULES
            if kind != BESIDE
        },
        "paper_training_kinematic_s": (
            f"1000 paper episodes in the kinematic model, {VEHICLES} vehicles [s]",
            lambda: paper_training_s("kinematic", CORES),
        ),
        "paper_training_contact_s": (
            f"1000 paper episodes in contact physics, {VEHICLES} vehicles [s]",
            lambda: paper_training_s("bullet", CORES),
        ),
        "nnql_over_sb3": (
            "training steps a second, NNQL with one vehicle over stable-baselines3 DQN (train_freq 1)",
            lambda: nnql_over_sb3(*(2, 200) if quick else (6, 500)),
        ),
        "film_over_bare": (
            "frames a second of a whole film, 640x360, over PyBullet's bare getCameraImage in one process",
            lambda: film_over_bare(6.0 if quick else 30.0),
        ),
        "film_frames_per_second": (
            f"frames a second of a whole film, 1280x720, on {CORES} cores",
            lambda: film_frames_per_second(6.0 if quick else 30.0),
        ),
        "simulator_mb": ("memory of one contact simulator process [MB]", simulator_mb),
    }
    if quick:
        del table["paper_training_kinematic_s"], table["paper_training_contact_s"]
    return table


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--quick", action="store_true", help="a minute or two: fewer and shorter drives, no whole trainings"
    )
    arguments = parser.parse_args()
    table = Table("key", "what", "measured", box=MARKDOWN)
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
    console = Console(width=WIDTH)
    console.print(table)
    names = ("pybullet", "numpy", "numba", "torch", "stable-baselines3")
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    machine = f"{CORES} cores, {platform.machine()}, {platform.python_implementation()} {platform.python_version()}"
    console.print(f"{machine}, {versions}", highlight=False)


if __name__ == "__main__":
    main()
