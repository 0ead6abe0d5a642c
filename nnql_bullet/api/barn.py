"""`barn`: policies through the worlds of the BARN challenge, by its protocol."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, isfinite
from pathlib import Path
from typing import Any

from typing_extensions import Unpack

from nnql_bullet.api.evaluate import run_evaluation
from nnql_bullet.arguments import checked
from nnql_bullet.config import nested
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.barn import STEPS, TIME, Barn, BarnRow, Reference, most_steps
from nnql_bullet.evaluation.drives import FilmTask, WorldFiles, film
from nnql_bullet.evaluation.metrics import Evaluation
from nnql_bullet.evaluation.policies import Policy, executor_for, open_policies
from nnql_bullet.evaluation.splits import Draws
from nnql_bullet.executors import Executor, ExecutorArguments, InlineExecutor
from nnql_bullet.files import staged, write_text
from nnql_bullet.recording import RECORDINGS, Recording
from nnql_bullet.reports import barn as report
from nnql_bullet.reports.failures import varied
from nnql_bullet.reports.tables import text_table
from nnql_bullet.run_config import frozen_keys
from nnql_bullet.runs import PolicyLike, load_policy
from nnql_bullet.setting import Setting, SimulationArguments, asked_tables
from nnql_bullet.sources import SOURCES, keep_files
from nnql_bullet.work import OnProgress, run_all
from nnql_bullet.worlds.importers.barn import START, TARGET, number_of, path_file, reference_length, world_files

ROBOT = "jackal_tricycle"
"""The shipped robot that drives by default: of the size of the one that the worlds are made for."""
TRACKS = 12
"""Most failed drives in the picture."""
_OLD = (SOURCES, "bottleneck.png", "failures.png", *(f"failures/{pattern}" for pattern in RECORDINGS))
"""Files of an older report that a new one may be without."""


@dataclass(frozen=True)
class BarnResults:
    """Results of `barn`."""

    barn: Barn
    """Policies, worlds, reference paths and every drive."""

    @property
    def rows(self) -> list[BarnRow]:
        """Each method in all worlds."""
        return self.barn.rows()

    @property
    def by_bottleneck(self) -> list[BarnRow]:
        """Each method in each quarter of the worlds, from the narrowest bottlenecks to the widest."""
        return self.barn.rows(by_bottleneck=True)

    @property
    def drives(self) -> list[dict[str, Any]]:
        """A flat record for each drive, with its scores; `pandas.DataFrame(drives)` takes them."""
        return report.drive_records(self.barn)

    def table(self) -> str:
        """Outcomes, times and scores with 95 % intervals: each method in all worlds, then by bottleneck."""
        return text_table(*report.barn_table([*self.rows, *self.by_bottleneck]))

    def save(
        self, folder: Path | str, executor: Executor | None = None, on_progress: OnProgress | None = None
    ) -> dict[str, Any]:
        """Writes the report, tables, pictures and recordings of failures into a folder.

        Args:
            folder: The folder; it is made if it is not there.
            executor: Records the failures; by default this process does.
            on_progress: Receives the progress.

        Returns:
            The values of results.json.
        """
        films = _filmed(executor or InlineExecutor(), self.barn, on_progress)
        tasks = [task for task, _ in films]
        values = report.barn_values(self.barn, tasks)
        with staged(Path(folder), "results.json", _OLD) as out:
            (out / "failures").mkdir()
            for task, recording in films:
                recording.save(out / "failures" / task.name)
            report.draw_bottlenecks(self.barn, out / "bottleneck.png")
            report.draw_failures(self.barn, films, out / "failures.png")
            write_text(out / "drives.csv", report.drives_csv(self.barn))
            write_text(out / "barn.md", report.barn_markdown(self.barn, tasks))
            keep_files([], self.barn.evaluation.setting.robot, out)
            write_text(out / "results.json", json.dumps(values, indent=1) + "\n")
        return values


class BarnArguments(SimulationArguments, ExecutorArguments, total=False):
    """How policies drive, and where pieces of work run."""


@checked
def barn(
    folder: str | Path,
    policies: PolicyLike | Sequence[PolicyLike],
    *,
    n_worlds: int | None = None,
    out: Path | str | None = None,
    on_progress: OnProgress | None = None,
    **asked: Unpack[BarnArguments],
) -> BarnResults:
    """Drives policies through the worlds of the BARN challenge by its protocol, and scores them as it does.

    Every drive has 100 s from the challenge's start to within 1 m of its target; a collision ends it. All worlds are
    driven, also those whose passages are too narrow for the vehicle. See `evaluation.barn` for the scores.

    Example:
        >>> import nnql_bullet as nb
        >>> results = nb.barn("BARN", ["double_dqn", "vfh"], simulator="kinematic", shield=True)  # doctest: +SKIP
        >>> print(results.table())  # doctest: +SKIP

    Args:
        folder: A folder with world_N.world, in itself or in worlds, world_files or BARN in it, and path_N.npy beside
            them or in path_files. OT of a world without a path is that of the vehicle's shortest path.
        policies: Run folders, policy files, shipped policies and rules by name, or your own objects (see `drive`).
        n_worlds: How many of the worlds, evenly spread over their numbers; by default all.
        out: Folder for the report (see `BarnResults.save`); finished pieces are kept there, so that the same call
            continues after an interrupt. Without it nothing is written.
        on_progress: Receives the progress.
        **asked: How policies drive, and where pieces of work run.

    Raises:
        UserError: If an argument is wrong, a policy, world or path cannot be read, or another process writes to `out`.
        WorkFailed: If a piece of work fails.
    """
    if "max_steps" in asked.get("changes", {}).get("task", {}):
        raise UserError(f"{STEPS}: the challenge gives each drive {TIME:g} s; leave it out")
    files = _spread(world_files(Path(folder)), n_worlds, folder)
    lengths = {str(file): reference_length(path) for file in files if (path := path_file(file)) is not None}
    if "robot" not in asked_tables(asked):
        asked["robot"] = ROBOT
    setting = replace(Setting.of(asked), allow_impassable=True)
    opened = open_policies(policies, setting.shield, setting.robot)
    limit = {STEPS: _most_steps(opened, setting)}
    setting = replace(setting, keys=frozen_keys(nested(dict(setting.keys) | limit)))
    where = executor_for(opened, asked)
    given = WorldFiles("BARN", tuple(map(str, files)))

    def results(evaluation: Evaluation) -> BarnResults:
        return BarnResults(Barn(str(folder), n_worlds, evaluation, _references(evaluation, lengths)))

    def save(evaluation: Evaluation, folder: Path) -> None:
        results(evaluation).save(folder, where, on_progress)

    draws, check = Draws(range(1), None), asked.get("check", True)
    return results(run_evaluation(opened, [given], [str(folder)], draws, setting, where, out, save, on_progress, check))


def _spread(files: Mapping[int, Path], number: int | None, folder: str | Path) -> list[Path]:
    """Chooses as many files as are asked for, evenly spread.

    Raises:
        UserError: If there are fewer.
    """
    found = list(files.values())
    if number is None:
        return found
    if not 1 <= number <= len(found):
        raise UserError(f"worlds: {folder} has {len(found)} worlds; give a number from 1 to that, not {number}")
    return [found[place * len(found) // number] for place in range(number)]


def _most_steps(policies: Sequence[Policy], setting: Setting) -> int:
    """Computes how many decisions a drive has.

    Raises:
        UserError: If policies decide at different times.
    """
    configs = [load_policy(its.source, its.own(setting).changes).experiment.config for its in policies]
    periods = {config.drive.decision_period for config in configs}
    if len(periods) > 1:
        every = " and ".join(f"{period:g}" for period in sorted(periods))
        raise UserError(f"the policies decide every {every} s; drive them apart, or give drive.decision_period")
    return most_steps(periods.pop())


def _references(evaluation: Evaluation, lengths: Mapping[str, float]) -> dict[str, Reference]:
    """Returns the reference path of each world; where the data set has none, the vehicle's shortest path.

    Where not even that is found, it is the straight line.
    """
    (tier,) = evaluation.tiers
    straight = hypot(TARGET[0] - START.x, TARGET[1] - START.y)
    found = {}
    for world, its in zip(tier.worlds, evaluation.difficulties[tier.name], strict=True):
        own = its.tortuosity * straight if isfinite(its.tortuosity) else straight
        number = number_of(Path(world.file))
        found[world.file] = Reference(number or 0, lengths.get(world.file, own), world.file in lengths)
    return found


def _filmed(executor: Executor, barn: Barn, on_progress: OnProgress | None) -> list[tuple[FilmTask, Recording]]:
    """Records some failed drives, of as many methods and endings as possible."""
    e, tier = barn.evaluation, barn.tier
    failed = [
        (FilmTask(policy, tier, e.setting, world), (policy.method, summary.ending))
        for policy in e.policies
        for world, _, summary in barn.drives(policy)
        if summary.ending != "goal"
    ]
    chosen = varied([task for task, _ in failed], [place for _, place in failed], TRACKS)
    return list(zip(chosen, run_all(executor, "failures", film, chosen, on_progress=on_progress), strict=True))
