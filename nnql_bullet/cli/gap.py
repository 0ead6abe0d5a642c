"""`nnql-bullet gap`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import gap as api
from nnql_bullet.cli.console import progress, say, seed_range
from nnql_bullet.cli.shared import ExecutorFlags, PlaceFlags, tell_warnings
from nnql_bullet.evaluation.splits import SplitName
from nnql_bullet.run_config import SimulatorName


def gap(
    runs: Annotated[list[Path], tyro.conf.arg(metavar="RUN ...")],
    /,
    against: SimulatorName = "kinematic",
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    worlds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    split: SplitName | None = None,
    seeds: Annotated[str | None, tyro.conf.arg(metavar="FROM:TO")] = None,
    faults: bool = True,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    *,
    drives: PlaceFlags,
    pieces: ExecutorFlags,
) -> int:
    """Measure what physics costs a policy: the same policy, worlds and seeds in two simulators.

    Prints how drives ended on both sides, and leaves gap.md, gap.json, episodes.csv and pictures: outcomes, how drives
    come apart, and success by fault (friction, payload, sensor noise, a dead sector). Each drive that ended differently
    has its cause and the command that replays it.

    For example:

        nnql-bullet gap runs/paper-0 runs/paper-1 --world cover_10 --split test
        nnql-bullet gap runs/paper-0 --against mujoco --no-faults --conditions.payload 80

    Args:
        runs: What `evaluate` takes: run folders, policy files, shipped policies, rules.
        against: First simulator.
        world: Shipped world (paper, cover_10, ...), TOML file, ROS map, or other file that `nnql-bullet worlds` reads;
            default that of the training.
        worlds: Number of worlds; default 100.
        split: Worlds to choose with (validation, the default), or those for the final table.
        seeds: Worlds of these seeds in place of --split and --worlds; TO is left out.
        faults: Leave out the drives with faults, which take some twelve times as long as the rest.
        out: Folder of the report; default runs/gap.
        drives: How policies drive.
        pieces: Where pieces of work run.
    """
    tell_warnings([world], drives.start, drives.end)
    folder = out or Path("runs") / "gap"
    with progress() as show:
        results = api.gap(
            runs,
            against=against,
            world=world,
            split=split,
            n_worlds=worlds,
            seeds=seed_range(seeds),
            faults=faults,
            **drives.asked,
            **pieces.asked,
            out=folder,
            on_progress=show,
        )
    say(results.table())
    say(f"report: {folder / 'gap.md'}")
    return 0
