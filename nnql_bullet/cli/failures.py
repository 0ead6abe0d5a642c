"""`nnql-bullet failures`."""

import json
import os
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro

from nnql_bullet.cli.console import say, say_table
from nnql_bullet.cli.work import run_all
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.replays import (
    Failures,
    check_policies,
    check_replay,
    choose,
    open_evaluation,
    replay,
)
from nnql_bullet.executors import make_executor
from nnql_bullet.files import write_text
from nnql_bullet.recording import load_recording
from nnql_bullet.reports import failures as report


def failures(
    results: Annotated[Path, tyro.conf.arg(metavar="RESULTS")] = Path("runs/evaluate"),
    /,
    most: Annotated[int, tyro.conf.arg(metavar="N")] = 5,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W")] = None,
) -> int:
    """Drive the failures of an evaluation again, and sort them by how they failed.

    Collisions: struck by a moving box, dithering (left, right and left again), head-on, flank. Out of time: target
    circling, circling, trapped, wandering. Every failure is in one group, by rules over its recording that
    failures.md states. Prints how many of each method are in each group, and leaves in RESULTS/failures: recordings,
    failures.md with a contact sheet of each group and for each drive the command that replays it exactly, and
    failures.json. `nnql-bullet report` shows them on its page, to be played. The same inputs give the same bytes.

    For example:

        nnql-bullet evaluate runs/paper-0 hand_rule --sim kinematic
        nnql-bullet failures
        nnql-bullet failures runs/evaluate-test --most 20

    Args:
        results: What `evaluate` left; default runs/evaluate.
        most: Failures of each method in each kind of world that are driven again; default 5. What is left out is said.
        workers: Drives at a time; default one a core. The result does not depend on it.
    """
    if most < 1:
        raise UserError(f"--most must be at least 1, not {most}")
    executor = make_executor("processes", workers or os.cpu_count() or 1)
    evaluation = open_evaluation(results)
    chosen = choose(evaluation.failed, most)
    check_policies(evaluation, chosen)
    folder = results / "failures"
    folder.mkdir(exist_ok=True)
    with TemporaryDirectory(prefix=".replays-", dir=folder) as temporary:
        recordings = Path(temporary)
        replays = run_all(
            executor,
            "failures",
            partial(replay, folder=recordings),
            chosen,
            keep=lambda _, replayed: check_replay(evaluation, replayed),
        )
        found = Failures(evaluation, replays, most)
        _write(found, recordings, folder)
    say(report.counted(found))
    if replays:
        say_table(*report.count_table(found))
    say(f"report: {folder / 'failures.md'}")
    return 0


def clear(folder: Path) -> None:
    """Removes what an evaluation and this verb left in the folder of its failures."""
    for pattern in ("*.npz", "*.png", "failures.*"):
        for old in folder.glob(pattern):
            old.unlink()


def _write(found: Failures, recordings: Path, folder: Path) -> None:
    """Has the folder hold these recordings, and what is said and drawn of them."""
    clear(folder)
    for one in found.replays:
        (recordings / one.failed.film.name).replace(folder / one.failed.film.name)
    for name, its in found.groups.items():
        shown = report.varied(its, [one.failed.place for one in its], report.SHOWN)
        drives = [(one.failed.title, load_recording(folder / one.failed.film.name), one.features) for one in shown]
        report.draw_sheet(drives, folder / report.sheet(name))
    write_text(folder / "failures.md", report.failures_markdown(found))
    write_text(folder / "failures.json", json.dumps(report.failures_values(found), indent=1) + "\n")
