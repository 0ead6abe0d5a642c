"""Trains every method over its seeds, drives all of them and every rule through the test worlds, and fills results/.

Learning methods are trained in the ideal twin, one vehicle at a time as in the paper unless their own recipe says
otherwise; everything is tested in contact physics on the split `test`, which nothing is chosen on. What is trained and
driven is kept in --out, so the same command goes on after an interrupt. The ledger of open choices is a part of it.

    python scripts/results.py                    # as in the README
    python scripts/results.py --scale 0.1        # a tenth of the seeds and worlds: a look at what comes out
"""

import argparse
import io
import shutil
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from rich.progress import track

from nnql_bullet.agents import RULES
from nnql_bullet.errors import UserError
from nnql_bullet.executors import ExecutorKind, make_executor

SEEDS = {"paper": 10, "literal": 10, "q_table": 5, "genetic": 5, "sb3_dqn": 5}
"""Training seeds of each preset."""
COVERS = "5,10,15,20"
WORLDS = "traps,aisles,moving"
KEPT = ("evaluation.md", "results.json", "results.csv", "outcomes.png", "cover.png", "failures.png")
"""Files of the report that go into results/."""


@dataclass(frozen=True)
class Trial:
    """One training."""

    preset: str
    seed: int
    out: Path

    @property
    def run(self) -> Path:
        """The run folder."""
        return self.out / f"{self.preset}-{self.seed}"


def train(trial: Trial) -> None:
    """Trains the run, or goes on with it, unseen; raises what is complained about."""
    from nnql_bullet.cli.parser import run

    if (trial.run / "checkpoint.safetensors").exists():
        arguments = ["--resume", str(trial.run)]
    else:
        arguments = ["--config", trial.preset, "--seed", str(trial.seed), "--sim", "twin", "--out", str(trial.run)]
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = run(["train", *arguments, "--workers", "1"])
    if code == 130:
        raise KeyboardInterrupt
    if code:
        raise RuntimeError(said.getvalue().strip().rpartition("\n")[2])


def main() -> None:
    """Does what is missing."""
    from nnql_bullet.cli.parser import run

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="of the numbers of seeds and worlds")
    parser.add_argument("--worlds", type=int, default=50, help="test worlds of each kind")
    parser.add_argument("--physics", default="fast", help="of the test")
    parser.add_argument("--executor", choices=get_args(ExecutorKind), default="processes", help="where it runs")
    parser.add_argument("--workers", type=int, default=2, help="trainings and drives at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/results"), help="where runs and drives are kept")
    parser.add_argument("--results", type=Path, default=Path("results"), help="where the report goes")
    a = parser.parse_args()
    try:
        executor = make_executor(a.executor, a.workers)
    except UserError as error:
        parser.error(str(error))
    out = a.out
    out.mkdir(parents=True, exist_ok=True)
    seeds = {preset: max(1, round(count * a.scale)) for preset, count in SEEDS.items()}
    trials = [Trial(preset, seed, out) for preset, count in seeds.items() for seed in range(count)]
    for outcome in track(executor.map(train, trials), "training", total=len(trials)):
        if outcome.error:
            sys.exit(f"{outcome.task.run}: {outcome.error.message}")
    where = ["--split", "test", "--worlds", str(max(1, round(a.worlds * a.scale))), "--physics", a.physics]
    spread = ["--executor", a.executor, "--workers", str(a.workers)]
    policies = [*(str(trial.run) for trial in trials), *RULES]
    tiers = ["--cover", COVERS, "--world", WORLDS]
    ledger = ["--seeds", str(max(1, round(10 * a.scale)))]
    for arguments in (
        ["ledger", *ledger, *spread, "--out", str(out / "ledger")],
        ["evaluate", *policies, *tiers, *where, *spread, "--out", str(out / "evaluate")],
    ):
        code = run(arguments)
        if code:
            sys.exit(code)
    a.results.mkdir(exist_ok=True)
    for name in KEPT:
        shutil.copy(out / "evaluate" / name, a.results / name)
    for name in ("ledger.md", "ledger.json", "ledger.csv", "ledger.png"):
        shutil.copy(out / "ledger" / name, a.results / name)
    print(f"results: {a.results / 'evaluation.md'}, {a.results / 'ledger.md'}")


if __name__ == "__main__":
    main()
