"""`nnql-bullet failures`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import failures as api
from nnql_bullet.cli.console import progress, say
from nnql_bullet.cli.shared import ExecutorFlags


def failures(
    results: Annotated[Path, tyro.conf.arg(metavar="RESULTS")] = Path("runs/evaluate"),
    /,
    most: Annotated[int, tyro.conf.arg(metavar="N")] = 5,
    *,
    pieces: ExecutorFlags,
) -> int:
    """Drive the failures of an evaluation again, and sort them by how they failed.

    Collisions: struck by a moving box, dithering (left, right and left again), head-on, flank. Out of time: target
    circling, circling, trapped, wandering. Every failure is in one group, by rules over its recording that
    failures.md states. Leaves in RESULTS/failures: recordings, failures.json, and failures.md with a contact sheet of
    each group and the command that replays each drive. `nnql-bullet report` plays them on its page. On one machine the
    same inputs and code give the same bytes.

    For example:

        nnql-bullet evaluate runs/paper-0 hand_rule --sim kinematic
        nnql-bullet failures
        nnql-bullet failures runs/evaluate-test --most 20

    Args:
        results: Folder that `evaluate` left.
        most: Failures of each method in each kind of world that are driven again. The rest is counted.
        pieces: Where pieces of work run.
    """
    folder = results / "failures"
    with progress() as show:
        found = api.failures(results, most=most, out=folder, on_progress=show, **pieces.asked)
    say(found.sentence)
    if found.rows:
        say(found.table())
    say(f"report: {folder / 'failures.md'}")
    return 0
