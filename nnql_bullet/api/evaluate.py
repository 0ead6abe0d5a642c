"""`evaluate`: policies through the same worlds, with intervals."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from typing_extensions import Unpack

from nnql_bullet.arguments import checked
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.drives import (
    FilmTask,
    Tier,
    WorldFiles,
    check_setting,
    draw_tiers,
    drive,
    drive_tasks,
    film,
    has_chance,
    survey,
    survey_tasks,
)
from nnql_bullet.evaluation.metrics import Comparison, Evaluation, Row, comparisons, rows
from nnql_bullet.evaluation.parts import Parts, run_kept
from nnql_bullet.evaluation.policies import Policy, executor_for, open_policies
from nnql_bullet.evaluation.splits import Draws, SplitName, choose_draws
from nnql_bullet.executors import Executor, ExecutorArguments, InlineExecutor
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.files import staged, write_text
from nnql_bullet.locks import locked
from nnql_bullet.recording import Recording
from nnql_bullet.render.filming import render_ending
from nnql_bullet.render.video import check_encoder
from nnql_bullet.reports import evaluation as report
from nnql_bullet.reports.failures import FILES
from nnql_bullet.reports.tables import text_table
from nnql_bullet.rollout import EpisodeSummary
from nnql_bullet.runs import PolicyLike
from nnql_bullet.setting import PlaceArguments, Setting
from nnql_bullet.sources import SOURCES, keep_files
from nnql_bullet.work import OnProgress, run_all
from nnql_bullet.worlds.paths import Difficulty
from nnql_bullet.worlds.source import World

WORLDS = ("paper", "cover_10", "cover_15")
"""Worlds that policies are evaluated in by default."""
CLIP = 12.0
"""Length of a clip of a failure [s]."""
CLIP_SIZE = (960, 540)
"""Size of a clip [pixels]."""
_OLD = (SOURCES, "cover.png", "failures.png", "clips/*.mp4", *(f"failures/{pattern}" for pattern in FILES))
"""Files of an older report that a new one may be without."""


@dataclass(frozen=True)
class EvaluationResults:
    """Results of `evaluate`."""

    evaluation: Evaluation
    """Policies, worlds and every drive."""

    @cached_property
    def methods(self) -> list[Row]:
        """Each method in each kind of world and, if there are several kinds, in all of them."""
        return rows(self.evaluation)

    @cached_property
    def comparisons(self) -> list[Comparison]:
        """Each pair of methods, compared over the same worlds."""
        return comparisons(self.evaluation)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A flat record for each method in each kind of world; `pandas.DataFrame(rows)` takes them."""
        return report.method_records(self.methods)

    @property
    def episodes(self) -> list[dict[str, Any]]:
        """A flat record for each drive."""
        return report.episode_records(self.evaluation)

    def table(self) -> str:
        """Success in percent with 95 % intervals, methods down and kinds of worlds across."""
        return text_table(*report.success_table(self.evaluation, self.methods))

    def save(
        self,
        folder: Path | str,
        clips: int = 0,
        executor: Executor | None = None,
        on_progress: OnProgress | None = None,
    ) -> dict[str, Any]:
        """Writes the report, tables, pictures and recordings of failures into a folder.

        Args:
            folder: The folder; it is made if it is not there.
            clips: Most videos of the last seconds of failures.
            executor: Records the failures; by default this process does.
            on_progress: Receives the progress.

        Returns:
            The values of results.json.
        """
        e = self.evaluation
        films = _filmed(executor or InlineExecutor(), e, on_progress)
        tasks = [task for task, _ in films]
        values = report.evaluation_values(e, self.methods, self.comparisons, tasks)
        with staged(Path(folder), "results.json", _OLD) as out:
            failures = out / "failures"
            failures.mkdir()
            for task, recording in films:
                recording.save(failures / task.name)
            report.draw_outcomes(e, self.methods, out / "outcomes.png")
            report.draw_cover(e, self.methods, out / "cover.png")
            report.draw_failures(films, out / "failures.png")
            write_text(out / "results.csv", report.results_csv(self.methods))
            write_text(out / "episodes.csv", report.episodes_csv(e))
            write_text(out / "evaluation.md", report.evaluation_markdown(e, self.methods, self.comparisons, tasks))
            for task in tasks[:clips]:
                (out / "clips").mkdir(exist_ok=True)
                render_ending(failures / task.name, out / "clips" / f"{Path(task.name).stem}.mp4", CLIP, CLIP_SIZE)
            files = [world.file for tier in e.tiers for world in tier.worlds if not tier.given]
            keep_files(files, e.setting.robot, out)
            write_text(out / "results.json", json.dumps(values, indent=1) + "\n")
        return values


class EvaluationArguments(PlaceArguments, ExecutorArguments, total=False):
    """How policies drive, and where pieces of work run."""


@checked
def evaluate(
    policies: PolicyLike | Sequence[PolicyLike],
    *,
    worlds: Sequence[str | Path | World] = WORLDS,
    split: SplitName | None = None,
    n_worlds: int | None = None,
    seeds: range | None = None,
    out: Path | str | None = None,
    clips: int = 0,
    on_progress: OnProgress | None = None,
    **asked: Unpack[EvaluationArguments],
) -> EvaluationResults:
    """Drives policies through the same worlds, and says how good each is with intervals.

    Policies that differ in their training seed alone are one method. Worlds of a folder are counted together. A file
    that cannot be read or drawn does not end the evaluation if another one can: it is listed in `evaluation.refused`.
    Drives in which nothing is random count once.

    Example:
        >>> import nnql_bullet as nb
        >>> results = nb.evaluate(["straight", "vfh"], worlds=["cover_10"], n_worlds=4, simulator="kinematic")
        >>> [(row["method"], row["drives"]) for row in results.rows]
        [('straight', 4), ('vfh', 4)]

    Args:
        policies: Run folders, policy files, shipped policies and rules by name, or your own objects (see `drive`).
        worlds: Shipped worlds, TOML files, maps and worlds of other programs, folders of such files, or `World`
            objects.
        split: "validation", the default, has worlds to choose with, "test" those for a final table.
        n_worlds: Worlds of each file, by default 100; a world in which nothing is random counts once.
        seeds: Seeds of the worlds of each file, in place of `split` and `n_worlds`.
        out: Folder for the report (see `EvaluationResults.save`); finished pieces are kept there, so that the same call
            continues after an interrupt. Without it nothing is written.
        clips: Most videos of failures in `out`.
        on_progress: Receives the progress.
        **asked: How policies drive, and where pieces of work run.

    Raises:
        UserError: If an argument is wrong, a policy or world cannot be read, or another process writes to `out`.
        WorkFailed: If a piece of work fails.
    """
    draws = choose_draws(split, n_worlds, seeds)
    if clips < 0:
        raise UserError(f"clips must not be negative, not {clips}")
    if out is not None and clips:
        check_encoder()
    setting = Setting.of(asked)
    opened = open_policies(policies, setting.shield, setting.robot)
    where = executor_for(opened, asked)
    if not worlds:
        raise UserError("give a world")
    names = [one.name if isinstance(one, World) else str(one) for one in worlds]

    def save(evaluation: Evaluation, folder: Path) -> None:
        EvaluationResults(evaluation).save(folder, clips, where, on_progress)

    check = asked.get("check", True)
    evaluation = run_evaluation(opened, worlds, names, draws, setting, where, out, save, on_progress, check)
    return EvaluationResults(evaluation)


def run_evaluation(
    policies: Sequence[Policy],
    worlds: Sequence[str | Path | World | WorldFiles],
    asked: Sequence[str],
    draws: Draws,
    setting: Setting,
    executor: Executor,
    out: Path | str | None,
    save: Callable[[Evaluation, Path], object],
    on_progress: OnProgress | None,
    check: bool,
) -> Evaluation:
    """Drives policies through worlds, and saves what comes of it into a folder that no other process writes to.

    Args:
        policies: The policies.
        worlds: The worlds.
        asked: What the worlds are called on a command line.
        draws: Which worlds of each kind.
        setting: The setting.
        executor: Where pieces run.
        out: The folder, where finished pieces are kept too; without it nothing is kept or saved.
        save: Writes the report into the folder.
        on_progress: Receives the progress.
        check: Whether a robot that is not shipped is checked when it is first driven in contact physics.

    Raises:
        UserError: See `evaluate`.
        WorkFailed: If a piece of work fails.
    """
    if out is not None and Path(out).exists() and not Path(out).is_dir():
        raise UserError(f"{out}: is a file; give a folder")
    robots = [check_setting(policy, setting) for policy in policies]
    tiers, refused = draw_tiers(worlds, draws, setting, policies)
    folder = None if out is None else Path(out)
    with locked(folder):
        for its in dict.fromkeys(robots if check else ()):
            check_at_first_use(its, setting.simulator, setting.physics, on_progress)
        parts = Parts(folder / "parts" if folder else None)
        difficulties, drives = _driven(executor, policies, tiers, setting, parts, on_progress)
        random = frozenset(p.name for p in policies if p.custom is None and has_chance(p, p.own(setting).changes))
        evaluation = Evaluation(asked, draws, setting, policies, tiers, difficulties, drives, refused, random)
        if folder:
            save(evaluation, folder)
    return evaluation


def _driven(
    executor: Executor,
    policies: Sequence[Policy],
    tiers: Sequence[Tier],
    setting: Setting,
    parts: Parts,
    on_progress: OnProgress | None,
) -> tuple[dict[str, list[Difficulty]], dict[tuple[str, str], list[EpisodeSummary]]]:
    """Surveys the worlds and drives every policy through them, except for pieces that are kept."""
    difficulties: dict[str, list[Difficulty]] = {tier.name: [] for tier in tiers}
    surveys = survey_tasks(policies[0], tiers, setting)
    surveyed = run_kept(executor, "worlds", survey, surveys, parts, Difficulty, on_progress)
    for task, found in zip(surveys, surveyed, strict=True):
        difficulties[task.tier.name] += found
    drives: dict[tuple[str, str], list[EpisodeSummary]] = {}
    tasks = drive_tasks(policies, tiers, setting)
    driven = run_kept(executor, "driving", drive, tasks, parts, EpisodeSummary, on_progress)
    for one, summaries in zip(tasks, driven, strict=True):
        drives.setdefault((one.policy.name, one.tier.name), []).extend(summaries)
    return difficulties, drives


def _filmed(executor: Executor, e: Evaluation, on_progress: OnProgress | None) -> list[tuple[FilmTask, Recording]]:
    """Records the first failed drive of each method in each kind of world."""
    tasks: dict[tuple[str, str], FilmTask] = {}
    for policy in e.policies:
        for tier in e.tiers:
            for world, summary in zip(tier.worlds, e.drives[policy.name, tier.name], strict=True):
                if summary.ending != "goal":
                    task = FilmTask(policy, tier, e.setting, world)
                    tasks.setdefault((policy.method, tier.name), task)
    chosen = list(tasks.values())
    return list(zip(chosen, run_all(executor, "failures", film, chosen, on_progress=on_progress), strict=True))
