"""Trains every method over its seeds, drives all of them and every rule through the test worlds, and fills results/.

Everything is tested on the split `test`, which nothing is chosen on: in contact physics, in the kinematic model through
more of the same worlds, in a shield, and under conditions that nothing was trained with. The ablations of choices are a
part of it. What is trained and driven is kept in --out, so the same command goes on after an interrupt.

    python scripts/results.py                    # as in the documentation
    python scripts/results.py --scale 0.1        # a tenth of the seeds and worlds: a look at what comes out
    python scripts/results.py --only shield      # one part of it
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from rich.progress import track
from scipy.stats import bootstrap

import nnql_bullet as nb
from nnql_bullet.agents import RULES
from nnql_bullet.errors import UserError
from nnql_bullet.executors import ExecutorKind, make_executor
from nnql_bullet.presets import load_config
from nnql_bullet.training.base import TrainingEpisode


@dataclass(frozen=True)
class Method:
    """Something that learns."""

    preset: str
    seeds: int
    """Trainings."""
    changes: dict[str, Any] = field(default_factory=lambda: {"simulator": "kinematic"})
    """Further arguments of `nb.train`."""
    stages: tuple[int, ...] = ()
    """Episodes after which it is looked at on the way."""


METHODS = {
    "paper": Method("paper", 10),
    "literal": Method("literal", 10),
    "tuned": Method("tuned", 10),
    "tuned_contact": Method("tuned", 3, {"simulator": "bullet"}),
    "q_table": Method("q_table", 5),
    "genetic": Method("genetic", 5, {"simulator": "kinematic", "vehicles": 200}),  # changes nothing but the time
    "sb3_dqn": Method("sb3_dqn", 1, {"simulator": "kinematic", "vehicles": 16}),
    "double_dqn": Method("double_dqn", 5, stages=(500, 1000, 1500, 2000, 3000, 4500, 6000, 8000, 10_000)),
}
LEARNING_FROM_STEPS = ("paper", "tuned", "q_table", "sb3_dqn")
"""Methods whose success during training is drawn."""
COVERS = ("paper", "cover_10", "cover_15", "cover_20")
HARD = ("traps", "aisles", "moving")
HARD_SEEDS = 2
"""Training seeds that are driven through those in contact physics, where drives last long."""
SHIELDED_RULES = ("straight", "hand_rule")
"""Rules that the success in a shield is compared with."""
CONDITIONS: dict[str, dict[str, Any]] = {
    "none": {},
    "the kinematic model": {"simulator": "kinematic"},
    "friction 0.5": {"conditions": nb.Conditions(wheel_friction=0.5)},
    "payload 80 kg": {"conditions": nb.Conditions(payload=80.0)},
    "noise of 5 cm": {"conditions": nb.Conditions(sensor_noise=0.05)},
}
"""Arguments of `nb.evaluate` for a bare policy; the others are compared with the first of them."""
CONDITION_COVERS = COVERS[:3]
DEAD_SECTORS = (0, 1)
"""Sensors that are dead, one at a time, in the shield."""
STAGE_WORLDS = ("cover_10", "cover_20", *HARD)
PARTS = ("ablations", "covers", "hard", "kinematic", "shield", "conditions", "learning")
"""Methods of `Results`, in the order in which they are called."""
KEPT = ("evaluation.md", "results.json", "results.csv", "outcomes.png", "cover.png", "failures.png")
"""Files of a report that go into results/."""
DOUBLE_DQN_FACTORS = ("map", "frames")
"""Factors of its ablation, whose trainings take long."""
ABLATION = ("ablation.md", "ablation.json", "ablation.csv", "ablation.png")
"""Files of an ablation."""


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


def train(trial: Trial) -> None:
    """Trains the run, or continues it, with a copy of the policy at each stage."""
    method = METHODS[trial.method]
    for episodes in (*method.stages, None):
        if episodes is None or not trial.stage(episodes).exists():
            if (trial.run / "checkpoint.safetensors").exists():
                nb.resume(trial.run, episodes or load_config(method.preset, {}).episodes)
            else:
                nb.train(method.preset, seed=trial.seed, out=trial.run, episodes=episodes, **method.changes)
            if episodes is not None:
                trial.stage(episodes).parent.mkdir(exist_ok=True)
                shutil.copyfile(trial.run / "policy.safetensors", trial.stage(episodes))


def draw_learning(trials: Sequence[Trial], path: Path) -> None:
    """How fast methods that learn from every step come to succeed."""
    from nnql_bullet.reports.plots import draw_success

    recipes: dict[str, dict[str, list[TrainingEpisode]]] = {}
    for trial in trials:
        if trial.method in LEARNING_FROM_STEPS:
            recipes.setdefault(trial.method, {})[trial.run.name] = nb.load_run(trial.run).episodes
    draw_success(recipes, path)


class Results:
    """The parts of the results, each made by a method of its name."""

    def __init__(self, trials: Sequence[Trial], spread: dict[str, Any], a: argparse.Namespace) -> None:
        self.trials = trials
        self.spread = spread
        self.a = a

    def scaled(self, number: int) -> int:
        """A number of seeds or worlds."""
        return max(1, round(number * self.a.scale))

    def runs(self, *methods: str, seeds: int | None = None) -> list[str]:
        """Run folders of methods, of every one if none is named."""
        found = [t for t in self.trials if not methods or t.method in methods]
        return [str(trial.run) for trial in found if seeds is None or trial.seed < seeds]

    def keep(self, name: str, files: Sequence[str]) -> None:
        """Copies files of a report into the results."""
        (self.a.results / name).mkdir(parents=True, exist_ok=True)
        for file in files:
            if (self.a.out / name / file).exists():  # without several covers there is no picture of them
                shutil.copy(self.a.out / name / file, self.a.results / name / file)

    def evaluate(self, name: str, policies: Sequence[str], worlds: Sequence[str], count: int, **more: Any) -> None:
        """Drives policies through test worlds."""
        nb.evaluate(
            policies,
            worlds=worlds,
            split="test",
            n_worlds=self.scaled(count),
            out=self.a.out / name,
            **{"physics": self.a.physics, **self.spread, **more},
        )
        self.keep(name, KEPT)

    def ablate(self, name: str, preset: str, seeds: int, **more: Any) -> None:
        """Trains and tests the variants of a preset."""
        nb.ablate(preset, seeds=self.scaled(seeds), out=self.a.out / name, **self.spread, **more)
        self.keep(name, ABLATION)

    def ablations(self) -> None:
        """What each choice of a preset is worth."""
        self.ablate("ablation", "paper", self.a.ablation_seeds)
        self.ablate("ablation-tuned", "tuned", 3)
        self.ablate("ablation-double_dqn", "double_dqn", 2, n_worlds=self.scaled(100), only=DOUBLE_DQN_FACTORS)

    def covers(self) -> None:
        """Everything in contact physics, by cover."""
        self.evaluate("covers", [*self.runs(), *RULES], COVERS, self.a.worlds)

    def hard(self) -> None:
        """The same through worlds that need more than reflexes."""
        self.evaluate("hard", [*self.runs(seeds=HARD_SEEDS), *RULES], HARD, self.a.worlds)

    def kinematic(self) -> None:
        """The same through more worlds of all kinds, in the kinematic model."""
        everyone, worlds = [*self.runs(), *RULES], (*COVERS, *HARD)
        self.evaluate("kinematic", everyone, worlds, self.a.kinematic_worlds, simulator="kinematic")

    def shield(self) -> None:
        """What learning is worth where a shield makes almost anything succeed."""
        policies = [*self.runs("double_dqn"), *SHIELDED_RULES]
        self.evaluate("shield", policies, (*COVERS, *HARD), self.a.shield_worlds, shield=True)

    def conditions(self) -> None:
        """What conditions cost that nothing was trained with."""
        bare = self.runs("tuned", "double_dqn", seeds=5)
        found = {condition: self._under(condition, bare, **more) for condition, more in CONDITIONS.items()}
        for sector in DEAD_SECTORS:
            condition, dead = f"sector {sector} dead", nb.Conditions(dead_sector=sector)
            found[condition] = self._under(condition, self.runs("double_dqn"), conditions=dead, shield=True)
        folder = self.a.results / "conditions"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "conditions.md").write_text(conditions_markdown(found), encoding="utf-8")

    def _under(self, condition: str, runs: Sequence[str], **more: Any) -> "Drives":
        results = nb.evaluate(
            runs,
            worlds=CONDITION_COVERS,
            split="test",
            n_worlds=self.scaled(self.a.condition_worlds),
            out=self.a.out / "conditions" / condition.replace(" ", "_"),
            **{"physics": self.a.physics, **self.spread, **more},
        )
        return {
            (row["method"], row["policy"], row["world"], row["world_seed"]): row["ending"] == "goal"
            for row in results.episodes
        }

    def learning(self) -> None:
        """How fast methods come to succeed: during training, and on validation worlds."""
        draw_learning(self.trials, self.a.results / "learning.png")
        trials = [trial for trial in self.trials if trial.method == "double_dqn"]
        rows: list[dict[str, Any]] = []
        stages = [*METHODS["double_dqn"].stages, None]
        for episodes in stages:
            policies = [str(trial.stage(episodes) if episodes else trial.run) for trial in trials]
            results = nb.evaluate(
                policies,
                worlds=STAGE_WORLDS,
                n_worlds=self.scaled(self.a.stage_worlds),
                simulator="kinematic",
                out=self.a.out / "stages",
                **self.spread,
            )
            titles = {tier.name: tier.title for tier in results.evaluation.tiers}
            learned = results.evaluation.policies[0].episodes
            rows += [{**row, "episodes": learned, "title": titles.get(row["world"])} for row in results.rows]
        draw_stages(rows, len(trials), self.a.results / "double_dqn.png")


Drives = dict[tuple[str, str, str, int], bool]
"""Whether a drive arrived, by method, policy, world and seed."""


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
    from nnql_bullet.reports.drawing import OPEN, finish_axes, picture

    with picture(path, 9.0, 4.4) as figure:
        axes = figure.add_subplot()
        kinds = list(dict.fromkeys(row["title"] for row in rows if row["title"]))
        for kind, colour in zip(kinds, LINES, strict=False):
            its = [row for row in rows if row["title"] == kind]
            episodes = [row["episodes"] for row in its]
            shown = ["goal" if row["over_seeds"] is None else "over_seeds" for row in its]
            parts = [[row[name + part] for part in ("", "_low", "_high")] for name, row in zip(shown, its, strict=True)]
            value, low, high = 100 * np.array(parts).T
            axes.fill_between(episodes, low, high, color=colour, alpha=0.2, lw=0)
            axes.plot(episodes, value, color=colour, lw=2, marker="o", ms=4, mew=0, label=kind)
        axes.set(xlabel="training episodes", ylabel="success [%]", ylim=(-2, 102), xlim=(0, None))
        title = f"double_dqn, greedy, on validation worlds: {seeds} trainings, inter-quartile mean and 95 % interval"
        finish_axes(axes, title, 11, hidden=OPEN)
        figure.legend(loc="outside right center", frameon=False, fontsize=9)


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
    results = Results(trials, {"executor": a.executor, "workers": a.workers}, a)
    for part in a.only:
        getattr(results, part)()
    print(f"results: {a.results}")


if __name__ == "__main__":
    main()
