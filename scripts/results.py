"""Trains every method over its seeds, drives all of them and every rule through the test worlds, and fills results/.

Everything is tested on the split `test`, which nothing is chosen on: in contact physics, in the kinematic model through
more of the same worlds, in a shield, and under conditions that nothing was trained with. The ablations of choices are a
part of it. What is trained and driven is kept in --out, so the same command goes on after an interrupt.

    python scripts/results.py                    # as in the documentation
    python scripts/results.py --scale 0.1        # a tenth of the seeds and worlds: a look at what comes out
    python scripts/results.py --only shield      # one part of it
"""

import argparse
import csv
import io
import json
import shutil
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from rich.progress import track
from scipy.stats import bootstrap

from nnql_bullet.agents import RULES
from nnql_bullet.errors import UserError
from nnql_bullet.executors import ExecutorKind, make_executor
from nnql_bullet.training.base import TrainingEpisode

KINEMATIC = ("--sim", "kinematic")


@dataclass(frozen=True)
class Method:
    """Something that learns."""

    preset: str
    seeds: int
    """Trainings."""
    flags: tuple[str, ...] = KINEMATIC
    """What else `train` is told."""
    stages: tuple[int, ...] = ()
    """Episodes after which it is looked at on the way."""


METHODS = {
    "paper": Method("paper", 10),
    "literal": Method("literal", 10),
    "tuned": Method("tuned", 10),
    "tuned_contact": Method("tuned", 3, ("--sim", "bullet")),
    "q_table": Method("q_table", 5),
    "genetic": Method("genetic", 5, (*KINEMATIC, "--vehicles", "200")),  # that changes nothing but the time
    "sb3_dqn": Method("sb3_dqn", 1, (*KINEMATIC, "--vehicles", "16")),
    "double_dqn": Method("double_dqn", 5, stages=(500, 1000, 1500, 2000, 3000, 4500, 6000, 8000, 10_000)),
}
LEARNING_FROM_STEPS = ("paper", "tuned", "q_table", "sb3_dqn")
"""Whose success while they act_exploring is drawn."""
COVERS = ("--cover", "5,10,15,20")
HARD = ("--world", "traps,aisles,moving")
HARD_SEEDS = 2
"""Training seeds that are driven through those in contact physics, where drives last long."""
SHIELDED_RULES = ("straight", "hand_rule")
"""That success in a shield is held against."""
CONDITIONS = {
    "none": (),
    "the kinematic model": KINEMATIC,
    "friction 0.5": ("--friction", "0.5"),
    "payload 80 kg": ("--payload", "80"),
    "noise of 5 cm": ("--noise", "0.05"),
}
"""In which a bare policy is driven, and held against the first of them."""
CONDITION_COVERS = ("--cover", "5,10,15")
DEAD_SECTORS = (0, 1)
"""One at a time, untold, in the shield."""
STAGE_WORLDS = ("--cover", "10,20", *HARD, "--split", "validation", *KINEMATIC)
PARTS = ("ablations", "covers", "hard", "kinematic", "shield", "conditions", "learning")
"""Methods of `Results`, in the order in which they are called."""
KEPT = ("evaluation.md", "results.json", "results.csv", "outcomes.png", "cover.png", "failures.png")
"""Files of a report that go into results/."""
DOUBLE_DQN_CHOICES = "map,frames"
"""Of its ablation, whose trainings take long."""
ABLATION = ("ablation.md", "ablation.json", "ablation.csv", "ablation.png")
"""Of a ablation."""


@dataclass(frozen=True)
class Trial:
    """One training."""

    method: str
    seed: int
    out: Path

    @property
    def run(self) -> Path:
        """The run folder."""
        return self.out / f"{self.method}-{self.seed}"

    def stage(self, episodes: int) -> Path:
        """What it had learned after so many episodes."""
        return self.run / "stages" / f"{episodes}.safetensors"


def nnql_bullet(*arguments: str) -> None:
    """Runs the program; ends with it if it fails."""
    from nnql_bullet.cli.parser import run

    code = run(list(arguments))
    if code:
        sys.exit(code)


def train(trial: Trial) -> None:
    """Trains the run, or goes on with it, unseen; raises what is complained about."""
    method = METHODS[trial.method]
    for episodes in (*method.stages, None):
        if episodes is None or not trial.stage(episodes).exists():
            _train_to(trial, method, episodes)
            if episodes is not None:
                trial.stage(episodes).parent.mkdir(exist_ok=True)
                shutil.copyfile(trial.run / "policy.safetensors", trial.stage(episodes))


def _train_to(trial: Trial, method: Method, episodes: int | None) -> None:
    from nnql_bullet.cli.parser import run
    from nnql_bullet.presets import load_config

    if (trial.run / "checkpoint.safetensors").exists():
        episodes = episodes or load_config(method.preset, {}).episodes
        arguments = ["--resume", str(trial.run), "--episodes", str(episodes)]
    else:
        arguments = ["--config", method.preset, "--seed", str(trial.seed), "--out", str(trial.run), *method.flags]
        arguments += [] if episodes is None else ["--episodes", str(episodes)]
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
    from nnql_bullet.runs import load_run

    recipes: dict[str, dict[str, list[TrainingEpisode]]] = {}
    for trial in trials:
        if trial.method in LEARNING_FROM_STEPS:
            recipes.setdefault(trial.method, {})[trial.run.name] = load_run(trial.run).episodes
    draw_success(recipes, path)


class Results:
    """The parts of the results, each made by a method of its name."""

    def __init__(self, trials: Sequence[Trial], spread: Sequence[str], a: argparse.Namespace) -> None:
        self.trials = trials
        self.spread = spread
        self.a = a

    def scaled(self, number: int) -> str:
        """A number of seeds or worlds."""
        return str(max(1, round(number * self.a.scale)))

    def runs(self, *methods: str, seeds: int | None = None) -> list[str]:
        """Run folders of methods, of every one if none is named."""
        found = [t for t in self.trials if not methods or t.method in methods]
        return [str(trial.run) for trial in found if seeds is None or trial.seed < seeds]

    def make(self, name: str, arguments: Sequence[str], kept: Sequence[str]) -> None:
        """Runs the program, and keeps what it leaves."""
        nnql_bullet(*arguments, *self.spread, "--out", str(self.a.out / name))
        (self.a.results / name).mkdir(parents=True, exist_ok=True)
        for file in kept:
            if (self.a.out / name / file).exists():  # without several covers there is no picture of them
                shutil.copy(self.a.out / name / file, self.a.results / name / file)

    def evaluate(self, name: str, policies: Sequence[str], worlds: int, *flags: str) -> None:
        """Drives policies through test worlds."""
        asked = ["--split", "test", "--worlds", self.scaled(worlds), *flags]
        self.make(name, ["evaluate", *policies, *asked], KEPT)

    def ablations(self) -> None:
        """What each choice of a preset is worth."""
        self.make("ablation", ["ablate", "--seeds", self.scaled(self.a.ablation_seeds)], ABLATION)
        self.make("ablation-tuned", ["ablate", "tuned", "--seeds", self.scaled(3)], ABLATION)
        budget = ["--seeds", self.scaled(2), "--worlds", self.scaled(100), "--only", DOUBLE_DQN_CHOICES]
        self.make("ablation-double_dqn", ["ablate", "double_dqn", *budget], ABLATION)

    def covers(self) -> None:
        """Everything in contact physics, by cover."""
        self.evaluate("covers", [*self.runs(), *RULES], self.a.worlds, *COVERS, "--physics", self.a.physics)

    def hard(self) -> None:
        """The same through worlds that need more than reflexes."""
        some = [*self.runs(seeds=HARD_SEEDS), *RULES]
        self.evaluate("hard", some, self.a.worlds, *HARD, "--physics", self.a.physics)

    def kinematic(self) -> None:
        """The same through more worlds of all kinds, in the kinematic model."""
        self.evaluate("kinematic", [*self.runs(), *RULES], self.a.kinematic_worlds, *COVERS, *HARD, *KINEMATIC)

    def shield(self) -> None:
        """What learning is worth where a shield makes almost anything succeed."""
        policies = [*self.runs("double_dqn"), *SHIELDED_RULES]
        where = [*COVERS, *HARD, "--physics", self.a.physics, "--shield"]
        self.evaluate("shield", policies, self.a.shield_worlds, *where)

    def conditions(self) -> None:
        """What conditions cost that nothing was trained with."""
        bare = self.runs("tuned", "double_dqn", seeds=5)
        found = {condition: self._under(condition, bare, *flags) for condition, flags in CONDITIONS.items()}
        for sector in DEAD_SECTORS:
            condition, flags = f"sector {sector} dead", ("--dead-sector", str(sector), "--shield")
            found[condition] = self._under(condition, self.runs("double_dqn"), *flags)
        folder = self.a.results / "conditions"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "conditions.md").write_text(conditions_markdown(found), encoding="utf-8")

    def _under(self, condition: str, runs: Sequence[str], *flags: str) -> "Drives":
        out = self.a.out / "conditions" / condition.replace(" ", "_")
        worlds = ["--worlds", self.scaled(self.a.condition_worlds), "--split", "test", *CONDITION_COVERS]
        where = ["--physics", self.a.physics, *flags, *self.spread, "--out", str(out)]
        nnql_bullet("evaluate", *runs, *worlds, *where)
        return drives_of(out)

    def learning(self) -> None:
        """How fast methods come to succeed: while they act_exploring, and on validation worlds."""
        draw_learning(self.trials, self.a.results / "learning.png")
        trials = [trial for trial in self.trials if trial.method == "double_dqn"]
        rows: list[dict[str, Any]] = []
        stages = [*METHODS["double_dqn"].stages, None]
        for episodes in stages:
            policies = [str(trial.stage(episodes) if episodes else trial.run) for trial in trials]
            out = self.a.out / "stages"
            worlds = ["--worlds", self.scaled(self.a.stage_worlds), *STAGE_WORLDS]
            nnql_bullet("evaluate", *policies, *worlds, *self.spread, "--out", str(out))
            values = json.loads((out / "results.json").read_text(encoding="utf-8"))
            titles = {tier["name"]: tier["title"] for tier in values["tiers"]}
            learned = values["policies"][0]["episodes"]
            rows += [{**row, "episodes": learned, "title": titles.get(row["world"])} for row in values["rows"]]
        draw_stages(rows, len(trials), self.a.results / "double_dqn.png")


Drives = dict[tuple[str, str, str, int], bool]
"""Whether a drive arrived, by method, policy, world and seed."""


def drives_of(folder: Path) -> Drives:
    """What `evaluate` left in a folder."""
    with (folder / "episodes.csv").open(encoding="utf-8", newline="") as file:
        return {
            (row["method"], row["policy"], row["world"], int(row["world_seed"])): row["ending"] == "goal"
            for row in csv.DictReader(file)
        }


def conditions_markdown(found: dict[str, Drives]) -> str:
    """Success by condition, beside what it is more or less than under none in the same worlds."""
    from nnql_bullet.reports.document import table

    none = next(iter(found))
    worlds = list(dict.fromkeys(world for _, _, world, _ in found[none]))
    rows = []
    for condition, drives in found.items():
        for method in dict.fromkeys(method for method, *_ in drives):
            cells = []
            for world in worlds:
                its = {key[1:]: arrived for key, arrived in drives.items() if (key[0], key[2]) == (method, world)}
                base = {key[1:]: arrived for key, arrived in found[none].items() if key[0] == method}
                success = f"{100 * np.mean(list(its.values())):.1f}"
                paired = [arrived - base[key] for key, arrived in its.items() if key in base]
                cells.append(success if condition == none or not paired else f"{success} ({difference(paired)})")
            rows.append((condition, method, *cells))
    lines = [
        "# Under conditions that nothing was trained with",
        "",
        "Success in %, test worlds, PyBullet `fast` where nothing else is said; in brackets the difference in points "
        "from the same policies in the same worlds under none, with its bootstrap 95 % interval over drives.",
        "",
        table(("condition", "method", *worlds), rows).markdown(),
        "",
    ]
    return "\n".join(lines)


def difference(paired: Sequence[int]) -> str:
    """A mean of paired differences, in points, with its interval."""
    values = np.array(paired, float)
    if np.ptp(values) == 0:
        return f"{100 * values[0]:+.1f}"
    interval = bootstrap(
        (values,), np.mean, n_resamples=2000, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return f"{100 * values.mean():+.1f}; {100 * interval.low:+.1f} to {100 * interval.high:+.1f}"


def draw_stages(rows: Sequence[dict[str, Any]], seeds: int, path: Path) -> None:
    """Success on validation worlds along a training, a line with its interval for each kind of world."""
    from nnql_bullet.colours import LINES
    from nnql_bullet.reports.drawing import OPEN, finish_axes, new_figure, save_figure

    figure = new_figure(9.0, 4.4)
    axes = figure.add_subplot()
    kinds = list(dict.fromkeys(row["title"] for row in rows if row["title"]))
    for kind, colour in zip(kinds, LINES, strict=False):
        its = [row for row in rows if row["title"] == kind]
        episodes = [row["episodes"] for row in its]
        value, low, high = 100 * np.array([row["over_seeds"] or row["outcomes"]["goal"] for row in its]).T
        axes.fill_between(episodes, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(episodes, value, color=colour, lw=2, marker="o", ms=4, mew=0, label=kind)
    axes.set(xlabel="training episodes", ylabel="success [%]", ylim=(-2, 102), xlim=(0, None))
    title = f"double_dqn, greedy, on validation worlds: {seeds} trainings, inter-quartile mean and 95 % interval"
    finish_axes(axes, title, 11, hidden=OPEN)
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    save_figure(figure, path)


def main() -> None:
    """Does what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=PARTS, nargs="+", default=PARTS, help="some parts")
    parser.add_argument("--scale", type=float, default=1.0, help="of the numbers of seeds and worlds")
    parser.add_argument("--worlds", type=int, default=25, help="test worlds of each kind in contact physics")
    parser.add_argument("--kinematic-worlds", type=int, default=300, help="and in the kinematic model")
    parser.add_argument("--shield-worlds", type=int, default=50, help="and in the shield")
    parser.add_argument("--condition-worlds", type=int, default=25, help="and under each condition")
    parser.add_argument("--stage-worlds", type=int, default=25, help="validation worlds along a training")
    parser.add_argument("--ablation-seeds", type=int, default=10, help="trainings of each alternative of the ablation")
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
    a.out.mkdir(parents=True, exist_ok=True)
    counts = {name: max(1, round(method.seeds * a.scale)) for name, method in METHODS.items()}
    trials = [Trial(name, seed, a.out) for name, count in counts.items() for seed in range(count)]
    for outcome in track(executor.map(train, trials), "training", total=len(trials)):
        if outcome.error:
            sys.exit(f"{outcome.task.run}: {outcome.error.message}")
    a.results.mkdir(exist_ok=True)
    results = Results(trials, ["--executor", a.executor, "--workers", str(a.workers)], a)
    for part in a.only:
        getattr(results, part)()
    print(f"results: {a.results}")


if __name__ == "__main__":
    main()
