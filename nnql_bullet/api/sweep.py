"""`sweep`: a search for the values of a run's keys."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typing_extensions import Unpack

from nnql_bullet.arguments import checked
from nnql_bullet.errors import UserError, WorkFailed, missing_library
from nnql_bullet.evaluation.space import Trial, bars, best_of
from nnql_bullet.evaluation.sweep import Sweep, TrialTask, identity, read_sweep, train_trial
from nnql_bullet.executors import Executor, ExecutorArguments, executor_of
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.files import staged, write_text
from nnql_bullet.locks import locked
from nnql_bullet.provenance import made_by
from nnql_bullet.reports import sweep as report
from nnql_bullet.reports.tables import csv_text, text_table
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sources import files_digest
from nnql_bullet.work import OnProgress, Progress, run_all, silent

if TYPE_CHECKING:
    from nnql_bullet.evaluation.search import Search

STUDY, TRIALS = "study.db", "trials"
"""What is kept of the trials: Optuna's file, and the folder of the run folders."""


@dataclass(frozen=True)
class SweepResults:
    """Results of `sweep`."""

    sweep: Sweep
    trials: list[Trial]
    """In the order in which they were drawn."""

    @property
    def best(self) -> Trial:
        """The trial with the most targets reached in its last evaluation.

        Raises:
            WorkFailed: If none was trained to its end.
        """
        best = best_of(self.trials)
        if best is None:
            reason = next((its.reason for its in self.trials if its.reason), "each was pruned")
            raise WorkFailed(f"none of {len(self.trials)} trials was trained to its end; the first: {reason}")
        return best

    @property
    def config(self) -> RunConfig:
        """The configuration of the best trial."""
        return self.sweep.space.options(self.best.values)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A flat record for each trial; `pandas.DataFrame(rows)` takes them."""
        return report.sweep_records(self.trials)

    def table(self, most: int = 10) -> str:
        """The best trials, one a line."""
        return text_table(*report.best_table(self.sweep.space, self.trials, most))

    def save(self, folder: Path | str) -> None:
        """Writes sweep.csv, sweep.png and, if a trial was trained to its end, best.toml and sweep.json."""
        with staged(Path(folder), "sweep.csv") as out:
            report.draw_sweep(self.sweep, self.trials, out / "sweep.png")
            if best_of(self.trials):
                write_text(out / "best.toml", report.best_toml(self.config, self.best))
                values = {
                    "made_by": made_by(),
                    "best": self.best.number,
                    "config": report.short_config(self.config),
                    "trials": self.rows,
                }
                write_text(out / "sweep.json", json.dumps(values, indent=1) + "\n")
            write_text(out / "sweep.csv", csv_text(self.rows))


@checked
def sweep(
    file: Path | str,
    *,
    trials: int | None = None,
    out: Path | str | None = None,
    check: bool = True,
    on_progress: OnProgress | None = None,
    **asked: Unpack[ExecutorArguments],
) -> SweepResults:
    """Searches for the values of a run's keys with which an agent learns best, by Optuna.

    Each trial is a training; what is compared is its last evaluation in validation worlds (see the key
    `training.evaluate_every`), and by the earlier ones a trial without prospects is given up. With the same version of
    Optuna the result is a function of the file, whatever the number of workers and however often it was interrupted.

    Example:
        >>> import nnql_bullet as nb
        >>> from pathlib import Path
        >>> _ = Path("small.toml").write_text('''
        ... simulator = "kinematic"
        ... vehicles = 4
        ... episodes = 4
        ... training = { evaluate_every = 4, evaluate_count = 2 }
        ... sweep = { trials = 2, space = { "agent.discount" = { low = 0.1, high = 0.9 } } }
        ... ''')
        >>> results = nb.sweep("small.toml", out="runs/small")
        >>> [row["state"] for row in results.rows], sorted(results.best.values)
        (['trained', 'trained'], ['agent.discount'])

    Args:
        file: A configuration as `train` takes it, with a table `sweep` (see `evaluation.sweep.SweepOptions`).
        trials: Number of trials in place of the file's; a finished sweep goes on with more.
        out: Folder of the study, of the trials' run folders and of the report; by default runs/sweep-FILE. The same
            call continues there after an interrupt. The machines of a Ray cluster have to share it.
        check: Whether a robot of your own is checked when it is first driven in contact physics (see `RobotWarning`).
        on_progress: Receives the progress.
        **asked: Where trials run, of those that are drawn together.

    Raises:
        UserError: If the file is wrong, Optuna is not installed, the folder holds another sweep, or another process
            writes to it.
        WorkFailed: If no trial can be trained to its end.
    """
    try:
        from nnql_bullet.evaluation.search import Search
    except ImportError:
        raise missing_library("Optuna", "sweep") from None
    read = read_sweep(Path(file))
    options, space = read.options, read.space
    total = options.trials if trials is None else trials
    if not 1 <= total <= 1000:
        raise UserError(f"trials must be from 1 to 1000, not {total}")
    where = executor_of(asked)
    if check:
        check_at_first_use(space.base.robot, space.base.simulator, space.base.physics, on_progress)
    folder = Path("runs") / f"sweep-{read.name}" if out is None else Path(out)
    with locked(folder):
        search = Search(folder / STUDY, space, identity(read, files_digest(space.base)), options.seed, options.random)
        try:
            while len(search.trials) < total:
                _train_round(read, search, total, where, folder / TRIALS, on_progress or silent)
        finally:  # after an interrupt too
            results = SweepResults(read, search.trials)
            results.save(folder)
    results.best  # noqa: B018 (raises if there is none)
    return results


def _train_round(
    sweep: Sweep, search: "Search", total: int, executor: Executor, folder: Path, on_progress: OnProgress
) -> None:
    """Trains what is left of a round of trials, and keeps them."""
    options, done = sweep.options, search.trials
    known = len(done) // options.together * options.together  # the trials of the rounds before
    least = bars(done[:known], sweep.evaluations) if options.prune else ()
    best = best_of(done)
    note = f"best {best.score:.0%} (trial {best.number})" if best else ""
    ended, tasks = [], []
    for number in range(len(done), min(known + options.together, total)):
        values = search.draw(number, known)
        try:
            config = sweep.space.options(values)
        except UserError as error:  # values that do not go together
            ended.append(Trial(number, values, (), "failed", str(error)))
        else:
            tasks.append(TrialTask(number, values, config, folder / f"{number:04}", least))

    def of_all(now: Progress) -> None:
        on_progress(Progress("trials", len(done) + now.done, total, note))

    ended += run_all(executor, "trials", train_trial, tasks, on_progress=of_all)
    search.add(sorted(ended, key=lambda its: its.number))
