"""`failures`: failed drives of an evaluation, driven again and sorted."""

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typing_extensions import Unpack

from nnql_bullet.api.evaluate import EvaluationResults
from nnql_bullet.arguments import checked
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.policies import executor_for
from nnql_bullet.evaluation.replays import (
    Failures,
    check_policies,
    check_replay,
    choose,
    finished,
    open_evaluation,
    replay,
)
from nnql_bullet.executors import ExecutorArguments
from nnql_bullet.files import staged, write_text
from nnql_bullet.locks import locked
from nnql_bullet.reports import failures as report
from nnql_bullet.reports.tables import text_table
from nnql_bullet.sources import changed_sources
from nnql_bullet.work import OnProgress, run_all

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FailureResults:
    """Results of `failures`."""

    failures: Failures
    """Every failure that was driven again, with its recording and group."""

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A record for each failure; `pandas.DataFrame(rows)` takes them."""
        return report.failure_records(self.failures)

    @property
    def sentence(self) -> str:
        """The number of failures, and how many of them were driven again."""
        return report.counted(self.failures)

    def table(self) -> str:
        """Number of failures of each method in each group; empty without failures."""
        return text_table(*report.count_table(self.failures)) if self.failures.replays else ""

    def save(self, folder: Path | str) -> None:
        """Writes recordings, failures.md, failures.json and a contact sheet of each group into a folder."""
        found = self.failures
        with staged(Path(folder), "failures.json", report.FILES) as out:
            for one in found.replays:
                one.recording.save(out / one.failed.film.name)
            for name, its in found.groups.items():
                shown = report.varied(its, [one.failed.place for one in its], report.SHOWN)
                drives = [(one.failed.title, one.recording, one.features) for one in shown]
                report.draw_sheet(drives, out / report.sheet(name))
            write_text(out / "failures.md", report.failures_markdown(found))
            write_text(out / "failures.json", json.dumps(report.failures_values(found), indent=1) + "\n")


@checked
def failures(
    results: EvaluationResults | Path | str,
    *,
    most: int = 5,
    out: Path | str | None = None,
    on_progress: OnProgress | None = None,
    **asked: Unpack[ExecutorArguments],
) -> FailureResults:
    """Drives the failures of an evaluation again, and sorts them by how they failed.

    Example:
        >>> import nnql_bullet as nb
        >>> results = nb.evaluate("straight", worlds=["cover_20"], n_worlds=3, simulator="kinematic")
        >>> [row["ending"] for row in nb.failures(results, most=1).rows]
        ['collision']

    Args:
        results: What `evaluate` returned, or the folder that it wrote.
        most: Most failures of each method in each kind of world.
        out: Folder for recordings and report; without it nothing is written.
        on_progress: Receives the progress.
        **asked: Where drives run.

    Raises:
        UserError: If an argument is wrong, or a policy, world or drive is not what it was.
        WorkFailed: If a drive fails.
    """
    if most < 1:
        raise UserError(f"most must be at least 1, not {most}")
    if isinstance(results, EvaluationResults):
        evaluation = finished(results.evaluation)
    else:
        evaluation = open_evaluation(Path(results))
        for name, difference in changed_sources(Path(results)).items():
            _log.warning(
                "%s has changed since the evaluation (%s); the drives are repeated with its own copy, as it was then; "
                "with what the file says now: %s",
                *(name, difference, evaluation.command),
            )
    chosen = choose(evaluation.failed, most)
    where = executor_for([one.film.policy for one in chosen], asked)
    check_policies(evaluation, chosen)
    replays = run_all(
        where,
        "failures",
        replay,
        chosen,
        keep=lambda _, replayed: check_replay(evaluation, replayed),
        on_progress=on_progress,
    )
    found = FailureResults(Failures(evaluation, replays, most))
    if out is not None:
        with locked(Path(out)):
            found.save(out)
    return found
