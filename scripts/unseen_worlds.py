"""Trains both presets over several seeds, drives each policy through unseen worlds, and prints the README's table.

Training runs in contact physics (`fast`), the test in contact physics (`reference`) on the test split, which nothing
is chosen on. Each policy drives the same worlds. Runs and drives that are finished are kept and not repeated.

    python scripts/unseen_worlds.py                        # as in the README: 41 minutes on 2 busy cores
    python scripts/unseen_worlds.py --seeds 1 --worlds 20 --out /tmp/small
"""

import argparse
import csv
import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from rich.progress import track

from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.statistics import share
from nnql_bullet.executors import ExecutorKind, make_executor

PRESETS = ("paper", "literal")
ENDINGS = ("goal", "collision", "timeout")


@dataclass(frozen=True)
class Trial:
    """One run to train, and what it is tested in."""

    preset: str
    seed: int
    out: Path
    worlds: int
    world: str
    physics: str

    @property
    def run(self) -> Path:
        """The run folder."""
        return self.out / f"{self.preset}-{self.seed}"

    @property
    def result(self) -> Path:
        """Where `evaluate` leaves its result."""
        return self.run / f"test-{self.world}-{self.physics}-{self.worlds}.csv"


def work(trial: Trial) -> None:
    """Trains the run, or goes on with it, and drives its policy."""
    if (trial.run / "checkpoint.safetensors").exists():
        train("--resume", str(trial.run))
    else:
        train("--config", trial.preset, "--seed", str(trial.seed), "--out", str(trial.run))
    if not trial.result.exists():
        evaluate(trial)


def train(*arguments: str) -> None:
    """Runs `nnql-bullet train` unseen, and raises what it complains about."""
    from nnql_bullet.cli.parser import run

    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = run(["train", *arguments])
    if code == 130:
        raise KeyboardInterrupt
    if code:
        raise RuntimeError(said.getvalue().strip().rpartition("\n")[2])


def evaluate(trial: Trial) -> None:
    """Drives the first test worlds and writes one line each to a CSV beside the policy, whole or not at all."""
    from nnql_bullet.config import parse
    from nnql_bullet.experiment import Experiment, RunConfig, changed
    from nnql_bullet.files import write_text
    from nnql_bullet.rollout import run_episode
    from nnql_bullet.runs import POLICY
    from nnql_bullet.seeding import TEST_WORLDS
    from nnql_bullet.training.checkpoint import load_weights

    weights = load_weights(trial.run / POLICY)
    config = changed(parse(RunConfig, weights.config, str(trial.run)), world=trial.world, physics=trial.physics)
    experiment = Experiment(config)
    experiment.taught.load(weights.arrays)
    lines = ["world_seed,ending,duration,path_length,clearance"]
    for seed in TEST_WORLDS[: trial.worlds]:
        s = run_episode(experiment.navigation, experiment.world(seed), experiment.agent)
        lines.append(f"{seed},{s.ending},{s.duration!r},{s.path_length!r},{s.clearance!r}")
    write_text(trial.result, "\n".join(lines) + "\n")


def table(trials: list[Trial]) -> str:
    """The Markdown table: all seeds of a preset together, then each seed's successes."""
    lines = [
        "| preset | goal | collision | timeout | goals by training seed |",
        "|---|---|---|---|---|",
    ]
    for preset in PRESETS:
        by_seed = []
        for trial in trials:
            if trial.preset == preset:
                with trial.result.open(encoding="utf-8", newline="") as file:
                    by_seed.append([row["ending"] for row in csv.DictReader(file)])
        endings = [ending for one in by_seed for ending in one]
        shares = [str(share(endings.count(ending), len(endings))) for ending in ENDINGS]
        each = ", ".join(str(one.count("goal")) for one in by_seed)
        lines.append(f"| `{preset}` | {' | '.join(shares)} | {each} of {trials[0].worlds} |")
    return "\n".join(lines)


def main() -> None:
    """Runs what is missing, then prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="training seeds of each preset")
    parser.add_argument("--worlds", type=int, default=100, help="test worlds")
    parser.add_argument("--world", default="paper", help="world file to test in")
    parser.add_argument("--physics", default="reference", help="of the test")
    parser.add_argument("--executor", choices=get_args(ExecutorKind), default="processes", help="where it runs")
    parser.add_argument("--workers", type=int, default=2, help="runs at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/unseen_worlds"), help="where the runs go")
    a = parser.parse_args()
    try:
        executor = make_executor(a.executor, a.workers)
    except UserError as error:
        parser.error(str(error))
    out = a.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    trials = [Trial(preset, seed, out, a.worlds, a.world, a.physics) for seed in range(a.seeds) for preset in PRESETS]
    ended = track(executor.map(work, trials), "training and testing", total=len(trials))
    failed = [(outcome.task, outcome.error) for outcome in ended if outcome.error]
    for trial, error in failed:
        print(f"{error.traceback}{trial.preset}, seed {trial.seed}: {error.message}", file=sys.stderr)
    if failed:
        sys.exit(1)
    print(table(trials))


if __name__ == "__main__":
    main()
