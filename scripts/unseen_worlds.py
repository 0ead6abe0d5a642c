"""Trains both presets over several seeds, drives each policy through unseen worlds, and prints the README's table.

Training runs in contact physics (`fast`), the test in contact physics (`reference`) on the test split, which nothing
is chosen on. Each policy drives the same worlds. Runs and drives that are finished are kept and not repeated.

    python scripts/unseen_worlds.py                        # as in the README: 36 minutes on 2 cores
    python scripts/unseen_worlds.py --seeds 1 --worlds 20 --out /tmp/small
"""

import argparse
import csv
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from rich.progress import track
from scipy.stats import binomtest

PRESETS = ("paper", "literal")
ENDINGS = ("goal", "collision", "timeout")


def evaluate(run: Path, worlds: int, world: str, physics: str) -> None:
    """Drives the first test worlds and writes one line each to a CSV beside the policy, whole or not at all."""
    from nnql_bullet.config import parse
    from nnql_bullet.experiment import Experiment, RunConfig, changed
    from nnql_bullet.files import write_text
    from nnql_bullet.rollout import run_episode
    from nnql_bullet.runs import POLICY
    from nnql_bullet.seeding import TEST_WORLDS
    from nnql_bullet.training.checkpoint import load_weights

    weights = load_weights(run / POLICY)
    config = changed(parse(RunConfig, weights.config, str(run)), world=world, physics=physics)
    experiment = Experiment(config)
    experiment.agent.load(weights.arrays)
    lines = ["world_seed,ending,duration,path_length,clearance"]
    for seed in TEST_WORLDS[:worlds]:
        s = run_episode(experiment.navigation, experiment.world(seed), experiment.agent.exploit)
        lines.append(f"{seed},{s.ending},{s.duration!r},{s.path_length!r},{s.clearance!r}")
    write_text(result_path(run, worlds, world, physics), "\n".join(lines) + "\n")


def result_path(run: Path, worlds: int, world: str, physics: str) -> Path:
    """Where `evaluate` leaves its result."""
    return run / f"test-{world}-{physics}-{worlds}.csv"


def work(out: Path, preset: str, seed: int, worlds: int, world: str, physics: str) -> None:
    """Trains and evaluates one run in processes of its own."""
    run = out / f"{preset}-{seed}"
    command = [sys.executable, "-m", "nnql_bullet", "train"]
    if (run / "checkpoint.safetensors").exists():
        command += ["--resume", str(run)]
    else:
        command += ["--config", preset, "--seed", str(seed), "--out", str(run)]
    subprocess.run(command, check=True, capture_output=True)
    if not result_path(run, worlds, world, physics).exists():
        again = [sys.executable, __file__, "--one", str(run), "--worlds", str(worlds)]
        subprocess.run([*again, "--world", world, "--physics", physics], check=True)


def wilson(count: int, total: int) -> str:
    """A share and its Wilson 95 % interval, in percent."""
    interval = binomtest(count, total).proportion_ci(method="wilson")
    return f"{100 * count / total:.1f} ({100 * interval.low:.1f}-{100 * interval.high:.1f})"


def table(out: Path, seeds: int, worlds: int, world: str, physics: str) -> str:
    """The Markdown table: all seeds of a preset together, then each seed's successes."""
    lines = [
        "| preset | goal | collision | timeout | goals by training seed |",
        "|---|---|---|---|---|",
    ]
    for preset in PRESETS:
        by_seed = []
        for seed in range(seeds):
            path = result_path(out / f"{preset}-{seed}", worlds, world, physics)
            with path.open(encoding="utf-8", newline="") as file:
                by_seed.append([row["ending"] for row in csv.DictReader(file)])
        endings = [ending for one in by_seed for ending in one]
        shares = [wilson(endings.count(ending), len(endings)) for ending in ENDINGS]
        each = ", ".join(str(one.count("goal")) for one in by_seed)
        lines.append(f"| `{preset}` | {' | '.join(shares)} | {each} of {worlds} |")
    return "\n".join(lines)


def main() -> None:
    """Runs what is missing, then prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="training seeds of each preset")
    parser.add_argument("--worlds", type=int, default=100, help="test worlds")
    parser.add_argument("--world", default="paper", help="world file to test in")
    parser.add_argument("--physics", default="reference", help="of the test")
    parser.add_argument("--workers", type=int, default=2, help="processes at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/unseen_worlds"), help="where the runs go")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    a = parser.parse_args()
    if a.one:
        evaluate(a.one, a.worlds, a.world, a.physics)
        return
    a.out.mkdir(parents=True, exist_ok=True)
    jobs = [(preset, seed) for seed in range(a.seeds) for preset in PRESETS]
    with ThreadPoolExecutor(a.workers) as pool:
        futures = [pool.submit(work, a.out, preset, seed, a.worlds, a.world, a.physics) for preset, seed in jobs]
        for future in track(futures, "training and testing"):
            future.result()
    print(table(a.out, a.seeds, a.worlds, a.world, a.physics))


if __name__ == "__main__":
    main()
