"""`nnql-bullet barn`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import barn as api
from nnql_bullet.cli.console import complain, progress, say
from nnql_bullet.cli.shared import ExecutorFlags, SimulationFlags
from nnql_bullet.reports import barn as report


def barn(
    folder: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    policies: Annotated[list[Path], tyro.conf.arg(metavar="POLICY ...")],
    /,
    worlds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/barn"),
    json: bool = False,
    *,
    drives: SimulationFlags,
    pieces: ExecutorFlags,
) -> int:
    """Drive policies through the worlds of the BARN challenge by its protocol, and score them as it does.

    Each drive has 100 s from the challenge's start to within 1 m of its target; a collision ends it. Its score is
    OT / clip(time, 2 OT, 8 OT), or 4 OT and 8 OT as in 2022, where OT is the reference path's length over 2 m/s. The
    robot is jackal_tricycle unless --robot names another one. Prints results in all worlds and by bottleneck, with 95 %
    intervals, and leaves barn.md, results.json, drives.csv (a line for each drive) and pictures. On one machine the
    same inputs and code give the same bytes. Finished pieces are kept in DIR/parts: after an interrupt the same command
    goes on.

    For example:

        nnql-bullet barn BARN double_dqn vfh --shield --sim kinematic
        nnql-bullet barn BARN runs/mine --worlds 50 --speed 1

    Args:
        folder: Folder with world_N.world, in itself or in worlds, world_files or BARN in it, and path_N.npy beside them
            or in path_files.
        policies: Run folders, policy files, shipped policies, rules, or TOML files that configure a rule.
        worlds: How many of the worlds, evenly spread over their numbers; default all.
        out: Folder of the report.
        json: Print results.json instead of the table.
        drives: How policies drive.
        pieces: Where pieces of work run.
    """
    try:
        with progress() as show:
            results = api.barn(
                folder,
                policies,
                n_worlds=worlds,
                **drives.asked,
                **pieces.asked,
                out=out,
                on_progress=show,
            )
    except KeyboardInterrupt:
        complain(f"interrupted; what is driven so far is kept in {out / 'parts'}: the same command goes on")
        return 130
    if json:
        say((out / "results.json").read_text(encoding="utf-8").rstrip())
        return 0
    say(report.protocol(results.barn))
    say(results.table())
    for its in results.barn.evaluation.refused:
        say(f"refused: {its.file}: {its.reason}")
    say(f"report: {out / 'barn.md'}")
    return 0
