"""`nnql-bullet gap`."""

from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import tyro

from nnql_bullet.api import gap as api
from nnql_bullet.cli.console import progress, say, seed_range
from nnql_bullet.cli.flags import DriveKeys, Place, asked_for
from nnql_bullet.cli.worlds import tell_warnings
from nnql_bullet.evaluation.splits import SplitName
from nnql_bullet.run_config import SimulatorName
from nnql_bullet.sim.engines import EngineName, PhysicsName


def gap(
    runs: Annotated[list[Path], tyro.conf.arg(metavar="RUN ...")],
    /,
    against: SimulatorName = "kinematic",
    sim: EngineName = "bullet",
    physics: PhysicsName = "reference",
    shield: bool = False,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    start: Annotated[Place, tyro.conf.arg(metavar="X,Y[,YAW]")] = None,
    target: Annotated[Place, tyro.conf.arg(metavar="X,Y")] = None,
    worlds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    split: SplitName | None = None,
    seeds: Annotated[str | None, tyro.conf.arg(metavar="FROM:TO")] = None,
    faults: bool = True,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    check: bool = True,
    keys: DriveKeys = MappingProxyType({}),
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
        sim: Second simulator, an engine of contact physics.
        physics: Solver settings of contact physics.
        shield: Drive each policy in a shield.
        world: Shipped world (paper, cover_10, ...), TOML file, ROS map, or other file that `nnql-bullet worlds` reads;
            default that of the training.
        start: Start, at rest, in the frame of the world's map [m, radians], in place of its own.
        target: Target in that frame, in place of its own.
        worlds: Number of worlds; default 100.
        split: Worlds to choose with (validation, the default), or those for the final table.
        seeds: Worlds of these seeds in place of --split and --worlds; TO is left out.
        faults: Leave out the drives with faults, which take some twelve times as long as the rest.
        workers: Processes; default one a core. They do not change the result.
        out: Folder of the report; default runs/gap.
        check: Leave out the check of a robot of your own when it is first driven in contact physics.
        keys: Values in place of each policy's own.
    """
    tell_warnings([world], start, target)
    folder = out or Path("runs") / "gap"
    with progress() as show:
        results = api.gap(
            runs,
            against=against,
            simulator=sim,
            physics=physics,
            world=world,
            start=start,
            target=target,
            split=split,
            n_worlds=worlds,
            seeds=seed_range(seeds),
            shield=shield,
            **asked_for(keys),
            faults=faults,
            executor="processes",
            workers=workers,
            out=folder,
            check=check,
            on_progress=show,
        )
    say(results.table())
    say(f"report: {folder / 'gap.md'}")
    return 0
