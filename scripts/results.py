"""Trains every method over its seeds, drives all of them and every rule through the test worlds, and fills results/.

Learning methods are trained in the ideal twin. Everything is tested in contact physics on the split `test`, which
nothing is chosen on, and in the twin through more of the same worlds. What is trained and driven is kept in --out, so
the same command goes on after an interrupt. The ledger of open choices is a part of it.

    python scripts/results.py                    # as in the README
    python scripts/results.py --scale 0.1        # a tenth of the seeds and worlds: a look at what comes out
"""

import argparse
import io
import shutil
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from rich.progress import track

from nnql_bullet.agents import RULES
from nnql_bullet.errors import UserError
from nnql_bullet.executors import ExecutorKind, make_executor
from nnql_bullet.training.base import TrainingEpisode

METHODS = {
    "paper": (10, []),
    "literal": (10, []),
    "q_table": (5, []),
    "genetic": (5, ["--vehicles", "200"]),  # that changes nothing but the time
    "sb3_dqn": (1, ["--vehicles", "16"]),
}
"""Presets, with the number of their training seeds and what else `train` is told."""
COVERS = "5,10,15,20"
WORLDS = "traps,aisles,moving"
HARD_SEEDS = 2
"""Training seeds that are driven through those in contact physics, where drives last long."""
KEPT = ("evaluation.md", "results.json", "results.csv", "outcomes.png", "cover.png", "failures.png")
"""Files of a report that go into results/."""
LEDGER = ("ledger.md", "ledger.json", "ledger.csv", "ledger.png")
"""Of the ledger."""


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
        arguments += METHODS[trial.preset][1]
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = run(["train", *arguments, "--workers", "1"])
    if code == 130:
        raise KeyboardInterrupt
    if code:
        raise RuntimeError(said.getvalue().strip().rpartition("\n")[2])


def draw_learning(trials: Sequence[Trial], path: Path) -> None:
    """How fast methods that learn from every step come to succeed."""
    from nnql_bullet.reports.plots import draw_success
    from nnql_bullet.runs import open_run

    recipes: dict[str, dict[str, list[TrainingEpisode]]] = {}
    for trial in trials:
        recipes.setdefault(trial.preset, {})[trial.run.name] = open_run(trial.run, None)[0].episodes
    draw_success(recipes, path)


def main() -> None:
    """Does what is missing."""
    from nnql_bullet.cli.parser import run

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="of the numbers of seeds and worlds")
    parser.add_argument("--worlds", type=int, default=25, help="test worlds of each kind in contact physics")
    parser.add_argument("--twin-worlds", type=int, default=300, help="and in the twin")
    parser.add_argument("--ledger-seeds", type=int, default=10, help="trainings of each alternative of the ledger")
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
    counts = {preset: max(1, round(count * a.scale)) for preset, (count, _) in METHODS.items()}
    trials = [Trial(preset, seed, out) for preset, count in counts.items() for seed in range(count)]
    for outcome in track(executor.map(train, trials), "training", total=len(trials)):
        if outcome.error:
            sys.exit(f"{outcome.task.run}: {outcome.error.message}")
    step_by_step = [trial for trial in trials if trial.preset not in ("genetic", "literal")]
    a.results.mkdir(exist_ok=True)
    draw_learning(step_by_step, a.results / "learning.png")
    spread = ["--executor", a.executor, "--workers", str(a.workers)]
    policies = [*(str(trial.run) for trial in trials), *RULES]
    some = [*(str(trial.run) for trial in trials if trial.seed < HARD_SEEDS), *RULES]
    test = ["--split", "test", *spread]
    contact = ["--physics", a.physics, *test]
    scaled = {
        name: str(max(1, round(number * a.scale)))
        for name, number in (("seeds", a.ledger_seeds), ("worlds", a.worlds), ("twin", a.twin_worlds))
    }
    for name, arguments, kept in (
        ("ledger", ["ledger", "--seeds", scaled["seeds"], *spread], LEDGER),
        ("covers", ["evaluate", *policies, "--cover", COVERS, "--worlds", scaled["worlds"], *contact], KEPT),
        ("hard", ["evaluate", *some, "--world", WORLDS, "--worlds", scaled["worlds"], *contact], KEPT),
        (
            "twin",
            [
                "evaluate",
                *policies,
                "--cover",
                COVERS,
                "--world",
                WORLDS,
                "--sim",
                "twin",
                "--worlds",
                scaled["twin"],
                *test,
            ],
            KEPT,
        ),
    ):
        code = run([*arguments, "--out", str(out / name)])
        if code:
            sys.exit(code)
        (a.results / name).mkdir(parents=True, exist_ok=True)
        for file in kept:
            if (out / name / file).exists():  # without several covers there is no picture of them
                shutil.copy(out / name / file, a.results / name / file)
    print(f"results: {', '.join(str(a.results / name) for name in ('ledger', 'covers', 'hard', 'twin'))}")


if __name__ == "__main__":
    main()
