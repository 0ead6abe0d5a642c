"""`nnql-bullet gap`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import gap as api
from nnql_bullet.cli.console import progress, say
from nnql_bullet.evaluation.splits import SplitName
from nnql_bullet.run_config import SimulatorName
from nnql_bullet.sim.engines import EngineName, PhysicsName


def gap(
    runs: Annotated[list[Path], tyro.conf.arg(metavar="RUN ...")],
    /,
    against: SimulatorName = "kinematic",
    sim: EngineName = "bullet",
    physics: PhysicsName = "reference",
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    worlds: Annotated[int, tyro.conf.arg(metavar="N")] = 100,
    split: SplitName = "validation",
    faults: bool = True,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Measure what physics costs a policy: the same policy, worlds and seeds in two simulators.

    Prints how drives ended on both sides, and leaves gap.md, gap.json, episodes.csv and pictures: outcomes against each
    other, how the drives come apart, the drives that ended differently with a cause each and the command that replays
    it, and success by fault (friction, payload, sensor noise, a dead sector).

    For example:

        nnql-bullet gap runs/paper-0
        nnql-bullet gap runs/paper-0 runs/paper-1 --world cover_10 --split test
        nnql-bullet gap runs/paper-0 --against mujoco --no-faults

    Args:
        runs: Run folders, or policy files.
        against: What contact physics is held against: the kinematic model (kinematic, the default), or the other
            engine.
        sim: Engine of contact physics; default bullet.
        physics: Settings of contact physics; default reference, the more exact.
        world: Shipped world (paper, cover_10, ...) or TOML file; default that of the training.
        worlds: How many worlds; default 100.
        split: Worlds to choose with (validation, the default), or those for the final table (test).
        faults: Whether to drive with faults too, which takes some twelve times as long.
        workers: Processes; default one a core. The result does not depend on it.
        out: Where the report goes; default runs/gap.
    """
    folder = out or Path("runs") / "gap"
    with progress() as show:
        results = api.gap(
            runs,
            against=against,
            simulator=sim,
            physics=physics,
            world=world,
            split=split,
            n_worlds=worlds,
            conditions=faults,
            executor="processes",
            workers=workers,
            out=folder,
            on_progress=show,
        )
    say(results.table())
    say(f"report: {folder / 'gap.md'}")
    return 0
