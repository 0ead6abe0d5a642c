"""Trains every method over its seeds, drives all of them and every rule through the test worlds, and fills results/.

Everything is tested on the split `test`, which nothing is chosen on: in contact physics, in the kinematic model through
more of the same worlds, in a shield, under conditions that nothing was trained with, and in two simulators side by
side. The ablations of choices are a part of it. What is trained and driven is kept in --out, so the same command goes
on after an interrupt, and a part can be made in several sessions. Each part is whole when it is in results/.

    python scripts/results.py                        # as in the documentation
    python scripts/results.py --estimate             # the CPU hours of each part
    python scripts/results.py --only covers hard     # some parts, with the trainings that they need
    python scripts/results.py --hours 8              # stops after so many hours, to be gone on with
    python scripts/results.py --scale 0.1            # a tenth of the seeds and worlds: a look at what comes out
    python scripts/results.py --only barn maps --barn BARN --maps maps/    # worlds that are not in the repository

What other code has driven is driven anew (docs/explanation/evidence.md). What other code has trained is refused: train
anew in another --out, or take it with --older, which results/ then shows.
"""

import argparse
import json
import os
import resource
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy.stats import bootstrap

import nnql_bullet as nb
from nnql_bullet.agents import RULES
from nnql_bullet.api.evaluate import EvaluationResults
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.studies import STUDIES
from nnql_bullet.executors import ExecutorKind, make_executor
from nnql_bullet.presets import load_config
from nnql_bullet.provenance import TRAINING, code_digest
from nnql_bullet.runs import CHECKPOINT, CONFIG, MADE_BY
from nnql_bullet.training.base import TrainingEpisode
from nnql_bullet.training.checkpoint import POLICY
from nnql_bullet.work import Progress


@dataclass(frozen=True)
class Method:
    """Something that learns."""

    preset: str
    seeds: int
    """Trainings."""
    changes: dict[str, Any] = field(default_factory=lambda: {"simulator": "kinematic"})
    """Further arguments of `nb.train`."""
    hours: float = 0.01
    """CPU time of a training [hours], of order only."""
    stages: tuple[int, ...] = ()
    """Episodes after which it is looked at on the way."""


METHODS = {
    "paper": Method("paper", 10),
    "literal": Method("literal", 5),
    "tuned": Method("tuned", 5),
    "q_table": Method("q_table", 5),
    "genetic": Method("genetic", 5, {"simulator": "kinematic", "vehicles": 200}),  # changes nothing but the time
    "double_dqn": Method("double_dqn", 5, hours=0.15, stages=(500, 1000, 1500, 2000, 3000, 4500, 6000, 8000, 10_000)),
    "distilled": Method("distilled", 5, hours=0.25),
}
LEARNING_FROM_STEPS = ("paper", "tuned", "q_table")
"""Methods whose success during training is drawn."""
COVERS = ("paper", "cover_10", "cover_15", "cover_20")
HARD = ("traps", "aisles", "moving")
TIGHT = ("poles", "cluttered", "rooms", "cells")
HEADLINE = ("paper", "double_dqn", "distilled")
"""Learned methods of the rows that are talked about, driven through most worlds."""
PLANNED = os.path.relpath(Path(__file__).with_name("pure_pursuit_planned.toml"))
"""The one rule that is led by a plan of the whole world, which the others do not know."""
HEADLINE_RULES = ("straight", "vfh", "dwa", "mppi", PLANNED)
ALL_RULES = (*RULES, PLANNED)
KINEMATIC: dict[str, Any] = {"simulator": "kinematic"}


@dataclass(frozen=True)
class Evaluation:
    """Policies through test worlds: a part of the results."""

    worlds: tuple[str, ...]
    count: int
    """Number of test worlds of each kind."""
    learned: tuple[str, ...] = tuple(METHODS)
    rules: tuple[str, ...] = ALL_RULES
    """Rules, and policies as they are shipped."""
    seeds: int | None = None
    """Most training seeds of each method; all of them if it is not given."""
    more: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of `nb.evaluate`."""

    def drives(self, scale: float) -> float:
        """Number of drives."""
        seeds = [min(METHODS[name].seeds, self.seeds or METHODS[name].seeds) for name in self.learned]
        policies = len(self.rules) + scale * sum(seeds)
        return policies * len(self.worlds) * scale * self.count * (2 if self.more.get("shield") else 1)


SHIPPED = ("paper", "tuned", "double_dqn", "distilled")
"""Trained policies that come with the program."""
EVALUATIONS = {
    "covers": Evaluation(COVERS, 100),
    "hard": Evaluation(HARD, 100, seeds=5),
    "shield": Evaluation((*COVERS, *HARD), 100, HEADLINE, HEADLINE_RULES, 5, {"shield": True}),
    "poles-contact": Evaluation(("poles",), 100, HEADLINE, HEADLINE_RULES, 5, {"shield": True}),
    "tight": Evaluation(TIGHT, 100, HEADLINE, ALL_RULES, 5, {**KINEMATIC, "shield": True}),
    "kinematic": Evaluation((*COVERS, *HARD), 300, more=KINEMATIC),
    "thousand": Evaluation((*COVERS, *HARD), 1000, (), (*SHIPPED, *HEADLINE_RULES), more=KINEMATIC),
    "poles": Evaluation(
        *(("poles",), 300, HEADLINE, HEADLINE_RULES, 5),
        {
            **{**KINEMATIC, "shield": True, "conditions": nb.Conditions(rays=360)},
            "changes": {"shield": {"least_width": 0.02}},
        },
    ),
}
CONDITIONS: dict[str, dict[str, Any]] = {
    "none": {},
    "the kinematic model": KINEMATIC,
    **{f"friction {value}": {"conditions": nb.Conditions(wheel_friction=value)} for value in (0.4, 0.6, 0.9)},
    **{f"payload {value:g} kg": {"conditions": nb.Conditions(payload=value)} for value in (40.0, 80.0)},
    **{f"noise of {value:g} m": {"conditions": nb.Conditions(sensor_noise=value)} for value in (0.05, 0.2)},
    **{f"decisions {value:g} s late": {"conditions": nb.Conditions(decision_latency=value)} for value in (0.1, 0.2)},
    **{f"wheels {value:g} s late": {"conditions": nb.Conditions(wheel_lag=value)} for value in (0.05, 0.2)},
    **{
        f"sector {sector} dead": {"conditions": nb.Conditions(dead_sector=sector)} for sector in range(5)
    },  # the others mirror them
}
"""Arguments of `nb.evaluate`; drives under the others are compared with those under the first, bare and in a shield."""
CONDITION_COVERS = ("cover_10", "cover_20")
CONDITION_WORLDS = 50
CONDITION_SEEDS = 1
"""Trainings of each method."""
STAGE_WORLDS = ("cover_10", "cover_20", *HARD)
STAGES_COUNT = 50
"""Validation worlds of each kind along a training."""
GAP_WORLDS = ("cover_10", "aisles")
GAP_COUNT = 100
GAP_SEEDS = 1
SIDES = (("kinematic", "bullet"), ("mujoco", "bullet"))
"""Simulators that headline rows are compared in."""
FOREIGN = ("double_dqn", "distilled", *ALL_RULES)
"""Shipped policies and rules that drive in worlds of others."""
IN_BARN = ("double_dqn", "distilled", "straight")
"""Those that do so in contact physics too, through BARN."""
FOLDERS = ("barn", "maps")
"""Parts in worlds of others, whose folder a flag of that name gives."""
ABLATIONS: dict[str, tuple[int, dict[str, Any]]] = {
    "paper": (300, {}),
    "tuned": (300, {}),
    "double_dqn": (100, {"only": ("map", "frames")}),  # whose trainings take long
}
"""Validation worlds of each kind and further arguments of `nb.ablate`, by preset; seeds as the studies say."""
PARTS = ("learning", *EVALUATIONS, "gap", "conditions", "barn", "maps", "ablations")
"""In the order in which they are made."""
NEEDED = {
    **{name: its.learned for name, its in EVALUATIONS.items()},
    "conditions": HEADLINE,
    "gap": HEADLINE,
    "learning": (*LEARNING_FROM_STEPS, "double_dqn"),
}
"""Methods that are trained for a part."""
PACE = {"kinematic": 0.1, "bullet": 0.4, "mujoco": 0.4}
"""CPU time of a drive, mean over methods and kinds of worlds [s], as `--estimate` takes it; of order only. What a part
takes is in hours.json of the results."""
ABLATION_HOURS = {"paper": 0.004, "tuned": 0.004, "double_dqn": 0.06}
"""CPU time of a training of an ablation and its test [hours], of order only."""
KEPT = ("evaluation.md", "results.json", "results.csv", "outcomes.png", "cover.png", "failures.png")
"""Files of a report that go into results/."""
ABLATION = ("ablation.md", "ablation.json", "ablation.csv", "ablation.png")
BARN = ("barn.md", "results.json", "drives.csv", "bottleneck.png")
GAP = ("gap.md", "gap.json", "gap.png")


@dataclass(frozen=True)
class Trial:
    """One training."""

    method: str
    seed: int
    out: Path
    results: Path

    @property
    def name(self) -> str:
        """Name of its folders."""
        return f"{self.method}-{self.seed}"

    @property
    def run(self) -> Path:
        """The run folder."""
        return self.out / self.name

    @property
    def trained(self) -> Path:
        """The folder of the results that keeps what it has learned, and what made that."""
        return self.results / "trained" / self.name

    def stage(self, episodes: int) -> Path:
        """What it had learned after so many episodes."""
        return self.run / "stages" / f"{episodes}.safetensors"

    def check(self, folder: Path) -> None:
        """Checks that the code of now has trained what lies in a folder, if anything does.

        Raises:
            UserError: If other code has.
        """
        if (folder / CONFIG).exists():
            makers = nb.load_run(folder).makers
            if {maker.get("code") for maker in makers} != {code_digest(TRAINING)}:
                raise UserError(f"{folder}: was trained by other code; remove it, or take it with --older")


def train(trial: Trial) -> None:
    """Trains the run, or continues it, with a copy of the policy at each stage; keeps what it has learned."""
    method = METHODS[trial.method]
    for episodes in (*method.stages, None):
        if episodes is None or not trial.stage(episodes).exists():
            if (trial.run / CHECKPOINT).exists():
                nb.resume(trial.run, episodes or load_config(method.preset, {}).episodes)
            else:
                nb.train(method.preset, seed=trial.seed, out=trial.run, episodes=episodes, **method.changes)
            if episodes is not None:
                trial.stage(episodes).parent.mkdir(exist_ok=True)
                shutil.copyfile(trial.run / POLICY, trial.stage(episodes))
    trial.trained.mkdir(parents=True, exist_ok=True)
    for file in (CONFIG, MADE_BY, POLICY):
        shutil.copyfile(trial.run / file, trial.trained / file)


def _is_over(trial: Trial) -> bool:
    """Whether the run folder is there, and whole."""
    return (trial.run / CONFIG).exists() and nb.load_run(trial.run).is_over


def draw_learning(trials: Sequence[Trial], path: Path) -> None:
    """How fast methods that learn from every step come to succeed."""
    from nnql_bullet.reports.plots import draw_success

    recipes: dict[str, dict[str, list[TrainingEpisode]]] = {}
    for trial in trials:
        if trial.method in LEARNING_FROM_STEPS:
            recipes.setdefault(trial.method, {})[trial.run.name] = nb.load_run(trial.run).episodes
    draw_success(recipes, path)


class TimeIsUp(Exception):
    """Raised between two pieces of work when the time that was given is over."""


class Results:
    """Makes the parts of the results."""

    def __init__(self, trials: Sequence[Trial], a: argparse.Namespace) -> None:
        self.trials = trials
        self.a = a
        self.until = time.monotonic() + 3600 * a.hours
        self.drives: Path = a.out / "drives"
        self.spread: dict[str, Any] = {"executor": a.executor, "workers": a.workers, "on_progress": self.told}

    def told(self, progress: Progress) -> None:
        """Shows progress, and ends the work when its time is up; what is done is kept."""
        print(f"\r{progress.what} {progress.done}/{progress.total}", end="", file=sys.stderr, flush=True)
        if time.monotonic() > self.until:
            raise TimeIsUp

    def scaled(self, number: int) -> int:
        """A number of seeds or worlds."""
        return max(1, round(number * self.a.scale))

    def runs(self, methods: Sequence[str], seeds: int | None = None) -> list[str]:
        """What the trainings of methods have learned."""
        return [str(t.trained) for t in self.trials if t.method in methods and (seeds is None or t.seed < seeds)]

    def keep(self, folder: Path, name: str, files: Sequence[str]) -> None:
        """Copies files of a report into the results, in place of those that are there."""
        (self.a.results / name).mkdir(parents=True, exist_ok=True)
        for file in files:
            (self.a.results / name / file).unlink(missing_ok=True)
            if (folder / file).exists():  # without several covers there is no picture of them
                shutil.copy(folder / file, self.a.results / name / file)

    def train(self, part: str) -> None:
        """Trains what a part needs.

        Raises:
            UserError: If a training was made by other code.
        """
        needed = [trial for trial in self.trials if trial.method in NEEDED.get(part, ())]
        for trial in needed if not self.a.older else ():
            trial.check(trial.trained)
            trial.check(trial.run)
        from_runs = part == "learning"  # whose stages and episodes results/ does not keep
        trials = [its for its in needed if not (its.trained / POLICY).exists() or (from_runs and not _is_over(its))]
        executor = make_executor(self.a.executor, self.a.workers)
        self.told(Progress("training", 0, len(trials)))
        for done, outcome in enumerate(executor.map(train, trials), 1):
            if outcome.error:
                raise UserError(f"{outcome.task.run}: {outcome.error.message}")
            self.told(Progress("training", done, len(trials)))

    def make(self, part: str) -> None:
        """Makes a part, and adds its CPU time to what is known of earlier sessions."""
        before = _cpu_time()
        try:
            self.train(part)
            self.evaluate(part, EVALUATIONS[part]) if part in EVALUATIONS else getattr(self, part)()
        finally:
            file = self.a.results / "hours.json"
            hours = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
            hours[part] = hours.get(part, 0.0) + (_cpu_time() - before) / 3600
            file.write_text(json.dumps(hours, indent=1) + "\n", encoding="utf-8")
        print(f"\r{part}: in {self.a.results}; {hours[part]:.2f} CPU hours on this machine", flush=True)

    def drive(self, policies: Sequence[str], **more: Any) -> EvaluationResults:
        """Drives through worlds; in one folder, so that no part drives what another one has driven."""
        for file in KEPT:
            (self.drives / file).unlink(missing_ok=True)
        return nb.evaluate(policies, out=self.drives, **{"physics": self.a.physics, **self.spread, **more})

    def evaluate(self, name: str, its: Evaluation) -> None:
        """Drives policies through test worlds."""
        policies, n_worlds = [*self.runs(its.learned, its.seeds), *its.rules], self.scaled(its.count)
        self.drive(policies, worlds=its.worlds, split="test", n_worlds=n_worlds, **its.more)
        self.keep(self.drives, name, KEPT)

    def ablations(self) -> None:
        """What each choice of a preset is worth."""
        for preset, (worlds, more) in ABLATIONS.items():
            name = "ablation" if preset == "paper" else f"ablation-{preset}"
            seeds, n_worlds = self.scaled(STUDIES[preset].seeds), self.scaled(worlds)
            nb.ablate(preset, seeds=seeds, n_worlds=n_worlds, out=self.a.out / name, **self.spread, **more)
            self.keep(self.a.out / name, name, ABLATION)

    def conditions(self) -> None:
        """What conditions cost that nothing was trained with, bare and in a shield."""
        found: dict[str, Drives] = {}
        for condition, more in CONDITIONS.items():
            results = self.drive(
                self.runs(HEADLINE, CONDITION_SEEDS),
                worlds=CONDITION_COVERS,
                split="test",
                n_worlds=self.scaled(CONDITION_WORLDS),
                shield=True,
                **more,
            )
            found[condition] = {
                (row["method"], row["policy"], row["world"], row["world_seed"]): row["ending"] == "goal"
                for row in results.episodes
            }
        folder = self.a.results / "conditions"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "conditions.md").write_text(conditions_markdown(found), encoding="utf-8")

    def gap(self) -> None:
        """The same drives in two simulators; each comparison is made whole or not at all."""
        for first, second in SIDES:
            for world in GAP_WORLDS:
                for method in (*HEADLINE, *HEADLINE_RULES):
                    name = f"gap/{first}-{second}/{world}-{Path(method).stem}"
                    done = self.a.out / name / "gap.json"
                    made = json.loads(done.read_text(encoding="utf-8")) if done.exists() else {}
                    if made.get("made_by", {}).get("code") != code_digest(TRAINING):
                        nb.gap(
                            self.runs([method], GAP_SEEDS) or [method],
                            **{"against": first, "simulator": second, "physics": self.a.physics, "world": world},
                            split="test",
                            n_worlds=self.scaled(GAP_COUNT),
                            faults=False,
                            out=self.a.out / name,
                            **self.spread,
                        )
                    self.keep(self.a.out / name, name, GAP)

    def barn(self) -> None:
        """Shipped policies and rules through the worlds of the BARN challenge, some of them in contact physics too."""
        for name, policies, where in (
            ("barn", FOREIGN, KINEMATIC),
            ("barn-contact", IN_BARN, {"physics": self.a.physics}),
        ):
            nb.barn(self.a.barn, policies, shield=True, out=self.a.out / name, **{**self.spread, **where})
            self.keep(self.a.out / name, name, BARN)

    def maps(self) -> None:
        """Shipped policies and rules through a folder of maps."""
        n_worlds = self.scaled(100)
        self.drive(FOREIGN, worlds=[self.a.maps], split="test", n_worlds=n_worlds, shield=True, **KINEMATIC)
        self.keep(self.drives, "maps", KEPT)

    def learning(self) -> None:
        """How fast methods come to succeed: during training, and on validation worlds."""
        draw_learning(self.trials, self.a.results / "learning.png")
        trials = [trial for trial in self.trials if trial.method == "double_dqn"]
        rows: list[dict[str, Any]] = []
        stages = [*METHODS["double_dqn"].stages, None]
        for episodes in stages:
            policies = [str(trial.stage(episodes) if episodes else trial.run) for trial in trials]
            results = self.drive(policies, worlds=STAGE_WORLDS, n_worlds=self.scaled(STAGES_COUNT), **KINEMATIC)
            titles = {tier.name: tier.title for tier in results.evaluation.tiers}
            learned = results.evaluation.policies[0].episodes
            rows += [{**row, "episodes": learned, "title": titles.get(row["world"])} for row in results.rows]
        draw_stages(rows, len(trials), self.a.results / "double_dqn.png")


def _cpu_time() -> float:
    """CPU time of this process and of its workers that have ended [s]; of those of Ray nothing is known."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(its.ru_utime + its.ru_stime for its in used)


def estimated_hours(part: str, scale: float) -> float:
    """CPU hours of a part from nothing, without its trainings."""
    if part in EVALUATIONS:
        simulator = EVALUATIONS[part].more.get("simulator", "bullet")
        return EVALUATIONS[part].drives(scale) * PACE[simulator] / 3600
    if part == "conditions":
        drives = len(CONDITIONS) * len(CONDITION_COVERS) * 2 * len(HEADLINE) * CONDITION_SEEDS * CONDITION_WORLDS
        return drives * scale**2 * PACE["bullet"] / 3600
    if part == "gap":
        drives = len(GAP_WORLDS) * (len(HEADLINE) * GAP_SEEDS + len(HEADLINE_RULES)) * GAP_COUNT
        return drives * scale**2 * sum(PACE[side] for sides in SIDES for side in sides) / 3600
    if part == "ablations":
        trainings = {
            preset: STUDIES[preset].seeds
            * (1 + sum(len(f.variants) - 1 for f in STUDIES[preset].factors if f.name in more.get("only", (f.name,))))
            for preset, (_, more) in ABLATIONS.items()
        }
        return sum(scale * count * ABLATION_HOURS[preset] for preset, count in trainings.items())
    drives = {"barn": 300 * 2 * len(FOREIGN), "maps": 200 * len(FOREIGN), "learning": 5 * 10 * 5 * STAGES_COUNT}[part]
    return drives * scale * PACE["kinematic"] / 3600


def estimate(a: argparse.Namespace, trials: Sequence[Trial]) -> None:
    """Prints the CPU hours of each part from nothing, and what is there already."""
    needed = {method for part in a.only for method in NEEDED.get(part, ())}
    missing = [trial for trial in trials if trial.method in needed and not (trial.trained / POLICY).exists()]
    hours = {"trainings that are missing": sum(METHODS[trial.method].hours for trial in missing)}
    hours |= {part: estimated_hours(part, a.scale) for part in a.only}
    file = a.results / "hours.json"
    spent = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for name, its in {**hours, "together": sum(hours.values())}.items():
        print(f"{name:<28}{its:9.2f} CPU hours" + (f", {spent[name]:.2f} spent so far" if name in spent else ""))


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
    parser.add_argument("--estimate", action="store_true", help="say how many CPU hours it takes, and do nothing")
    parser.add_argument(
        "--hours", type=float, default=float("inf"), help="stop after so many hours, to be gone on with"
    )
    parser.add_argument("--scale", type=float, default=1.0, help="of the numbers of seeds and worlds")
    parser.add_argument("--older", action="store_true", help="take trainings that were made by other code")
    parser.add_argument("--barn", help="folder of the BARN worlds")
    parser.add_argument("--maps", help="folder of maps")
    parser.add_argument("--physics", default="fast", help="of the test")
    parser.add_argument("--executor", choices=get_args(ExecutorKind), default="processes", help="where it runs")
    parser.add_argument("--workers", type=int, default=2, help="trainings and drives at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/results"), help="where runs and drives are kept")
    parser.add_argument("--results", type=Path, default=Path("results"), help="where the report goes")
    a = parser.parse_args()
    counts = {name: max(1, round(method.seeds * a.scale)) for name, method in METHODS.items()}
    trials = [Trial(name, seed, a.out, a.results) for name, count in counts.items() for seed in range(count)]
    if a.estimate:
        estimate(a, trials)
        return
    for folder in (a.out, a.results):
        folder.mkdir(parents=True, exist_ok=True)
    results = Results(trials, a)
    try:
        for part in a.only:
            if part in FOLDERS and not getattr(a, part):
                print(f"{part}: left out; --{part} names the folder of its worlds")
            else:
                results.make(part)
    except UserError as error:
        parser.error(str(error))
    except TimeIsUp:
        print("\rthe time is up; the same command goes on")


if __name__ == "__main__":
    main()
