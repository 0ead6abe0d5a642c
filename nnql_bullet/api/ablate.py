"""`ablate`: the evidence for every factor of a preset."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from typing_extensions import Unpack

from nnql_bullet.arguments import checked
from nnql_bullet.config import dotted, merged
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.ablation import Budget, Counts, Entry, entries, task_of, train_and_test
from nnql_bullet.evaluation.parts import Parts, run_kept
from nnql_bullet.evaluation.splits import split_seeds
from nnql_bullet.evaluation.studies import STUDIES, Study
from nnql_bullet.executors import ExecutorArguments, executor_of
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.files import staged, write_text
from nnql_bullet.locks import locked
from nnql_bullet.reports import ablation as report
from nnql_bullet.reports.tables import text_table
from nnql_bullet.run_config import Conditions, SimulatorName, asked_title, frozen_keys
from nnql_bullet.setting import DrivingArguments, asked_tables
from nnql_bullet.work import OnProgress
from nnql_bullet.worlds.source import World

MOST_SEEDS = 1000
"""Most trainings of each variant."""


@dataclass(frozen=True)
class AblationResults:
    """Results of `ablate`."""

    study: Study
    budget: Budget
    entries: list[Entry]
    """A variant each, with its evidence."""

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A flat record for each variant, kind of world and training seed; `pandas.DataFrame(rows)` takes them."""
        return report.ablation_records(self.entries)

    @property
    def decisions(self) -> dict[str, str]:
        """The decision that the evidence supports, by the question of each factor."""
        return {factor.question: report.decision(factor, self.entries) for factor in self.study.factors}

    def table(self) -> str:
        """The decision about each factor."""
        return text_table(("factor", "evidence"), list(self.decisions.items()))

    def save(self, folder: Path | str) -> None:
        """Writes ablation.md, ablation.csv, ablation.json and ablation.png into a folder."""
        with staged(Path(folder), "ablation.json") as out:
            write_text(out / "ablation.md", report.ablation_markdown(self.study, self.entries, self.budget))
            write_text(out / "ablation.csv", report.ablation_csv(self.entries))
            report.draw_ablation(self.study, self.entries, self.budget, out / "ablation.png")
            values = report.ablation_values(self.study, self.entries, self.budget)
            write_text(out / "ablation.json", json.dumps(values, indent=1) + "\n")


class AblationArguments(DrivingArguments, ExecutorArguments, total=False):
    """How policies drive, and where pieces of work run."""


@checked
def ablate(
    preset: str = "paper",
    *,
    only: Sequence[str] | None = None,
    seeds: int | None = None,
    simulator: SimulatorName = "kinematic",
    worlds: Sequence[str | Path] | None = None,
    episodes: int | None = None,
    vehicles: int = 64,
    n_worlds: int = 300,
    out: Path | str | None = None,
    on_progress: OnProgress | None = None,
    **asked: Unpack[AblationArguments],
) -> AblationResults:
    """Trains every variant of every factor of a preset from several seeds, and tests them on validation worlds.

    Example:
        >>> import nnql_bullet as nb
        >>> results = nb.ablate("paper", only=["hysteresis"], seeds=1, episodes=4, vehicles=4, n_worlds=2)
        >>> sorted({row["variant"] for row in results.rows})
        ['0 m', '1 m']

    Args:
        preset: "paper", "tuned" or "double_dqn".
        only: Names of some factors; all of them if it is not given.
        seeds: Trainings of each variant; by default as the study says.
        simulator: Where policies are trained and tested.
        worlds: Shipped worlds or files in place of the study's, to train and to test in.
        episodes: Episodes of each training; by default as the study says.
        vehicles: Vehicles that each training learns from at once.
        n_worlds: Validation worlds of each kind.
        out: Folder for the report; finished trainings are kept there, so that the same call continues after an
            interrupt. Without it nothing is written.
        on_progress: Receives the progress.
        **asked: How policies drive, and where pieces of work run.

    Raises:
        UserError: If an argument is wrong, or another process writes to `out`.
        WorkFailed: If a training fails.
    """
    split_seeds("validation", n_worlds)
    if seeds is not None and not 1 <= seeds <= MOST_SEEDS:
        raise UserError(f"seeds must be from 1 to {MOST_SEEDS}, not {seeds}")
    tables = asked_tables(asked)
    study = _with_asked(_study(preset, only), tables, asked.get("conditions"), worlds)
    budget = Budget(
        simulator=simulator,
        seeds=seeds or study.seeds,
        episodes=study.episodes if episodes is None else episodes,
        vehicles=vehicles,
        worlds=n_worlds,
    )
    where = executor_of(asked)
    if asked.get("check", True) and "robot" in tables:
        check_at_first_use(tables["robot"], simulator, "reference", on_progress)
    trials = [
        (factor.name, variant.label, task_of(study, variant, seed, budget))
        for seed in range(budget.seeds)
        for factor in study.factors
        for variant in factor.variants
    ]
    folder, tasks = None if out is None else Path(out), [task for *_, task in trials]
    with locked(folder):
        parts = Parts(folder / "parts" if folder else None)
        tested = run_kept(where, "trainings", train_and_test, tasks, parts, Counts, on_progress)
        found: dict[tuple[str, str], list[list[Counts]]] = {}
        for (name, label, _), its in zip(trials, tested, strict=True):
            found.setdefault((name, label), []).append(its)
        results = AblationResults(study, budget, entries(study, found))
        if folder:
            results.save(folder)
    return results


def _with_asked(
    study: Study, asked: Mapping[str, Any], conditions: Conditions | None, worlds: Sequence[str | Path] | None
) -> Study:
    """The study with what is asked for in all of its trainings.

    Raises:
        UserError: If a value is asked for that a factor varies, or there is no such world.
    """
    words = filter(None, ("in a shield" if "shield" in asked else "", asked_title(conditions, frozen_keys(asked))))
    base = {**asked, "conditions": conditions}
    if worlds:
        names = [str(world) for world in worlds]
        study = replace(study, tiers={name: World.load(name).name for name in names})
        base |= {"world": names[0], "training": {"worlds": names if len(names) > 1 else []}}
    for factor in study.factors:
        varied = {key for variant in factor.variants for key in dotted(variant.changes)}
        both = sorted(varied & dotted(base).keys())
        if both:
            raise UserError(f"'{both[0]}' is what the factor '{factor.name}' varies; leave that out, or name others")
    return replace(study, base=merged(study.base, base), asked=", ".join(words))


def _study(preset: str, only: Sequence[str] | None) -> Study:
    """The study of a preset, with the named factors.

    Raises:
        UserError: If there is no such preset or factor.
    """
    if preset not in STUDIES:
        raise UserError(f"there is no ablation of '{preset}'; presets: {', '.join(STUDIES)}")
    study = STUDIES[preset]
    if only is None:
        return study
    factors = {factor.name: factor for factor in study.factors}
    unknown = [name for name in only if name not in factors]
    if unknown or not only:
        raise UserError(f"only: there is no factor '{(unknown or [''])[0]}'; factors: {', '.join(factors)}")
    return replace(study, factors=tuple(factors[name] for name in only))
