"""`nnql-bullet evaluate`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import evaluate as api
from nnql_bullet.cli.console import complain, items, progress, say, seed_range
from nnql_bullet.cli.shared import ExecutorFlags, PlaceFlags, tell_warnings
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.splits import SplitName
from nnql_bullet.reports import evaluation as report

COVERS = {"2.5": "cover_2.5", "5": "paper", "7.5": "cover_7.5", "10": "cover_10", "15": "cover_15", "20": "cover_20"}
"""Percent of the arena under boxes, and the shipped world."""


def evaluate(
    policies: Annotated[list[Path], tyro.conf.arg(metavar="POLICY ...")],
    /,
    split: SplitName | None = None,
    worlds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    seeds: Annotated[str | None, tyro.conf.arg(metavar="FROM:TO")] = None,
    cover: Annotated[str | None, tyro.conf.arg(metavar="P,P,...")] = None,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE|DIR,...")] = None,
    clips: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/evaluate"),
    json: bool = False,
    *,
    drives: PlaceFlags,
    pieces: ExecutorFlags,
) -> int:
    """Drive policies through the same worlds; say how good each is and how sure that is.

    Policies that differ by their training seed alone are one method. Prints success with 95 % intervals, and leaves
    evaluation.md, results.json, results.csv, episodes.csv (a line for each drive) and pictures. On one machine
    the same inputs and code give the same bytes. Finished pieces are kept in DIR/parts: after an interrupt the same
    command goes on.

    For example:

        nnql-bullet evaluate runs/paper-0 runs/paper-1 hand_rule --cover 5,10 --sim kinematic
        nnql-bullet evaluate runs/paper-0 straight --world traps,aisles,moving --worlds 50 --split test
        nnql-bullet evaluate double_dqn --shield --conditions.wheel-friction 0.5

    Args:
        policies: Run folders, policy files, shipped policies, rules, or TOML files that configure a rule.
        split: Worlds to choose with (validation, the default), or those for the final table.
        worlds: Number of worlds of each kind; default 100.
        seeds: Worlds of these seeds in place of --split and --worlds; TO is left out.
        cover: Percentages under boxes: 2.5, 5, 7.5, 10, 15, 20; default 5,10,15 without --world.
        world: Shipped worlds (traps, aisles, moving, ...), TOML files, ROS maps, other files that `nnql-bullet worlds`
            reads, or folders of such files, each counted as one kind.
        clips: Most videos of failures, in DIR/clips.
        out: Folder of the report.
        json: Print results.json instead of the table.
        drives: How policies drive.
        pieces: Where pieces of work run.
    """
    files = _files(cover, world)
    tell_warnings(files, drives.start, drives.end)
    try:
        with progress() as show:
            results = api.evaluate(
                policies,
                worlds=files,
                split=split,
                n_worlds=worlds,
                seeds=seed_range(seeds),
                **drives.asked,
                **pieces.asked,
                out=out,
                clips=clips,
                on_progress=show,
            )
    except KeyboardInterrupt:
        complain(f"interrupted; what is driven so far is kept in {out / 'parts'}: the same command goes on")
        return 130
    if json:
        say((out / "results.json").read_text(encoding="utf-8").rstrip())
        return 0
    e = results.evaluation
    say(f"success in %, {e.title}, {report.counted(e)} (95 % intervals)")
    say(results.table())
    for its in e.refused:
        say(f"refused: {its.file}: {its.reason}")
    say(f"report: {out / 'evaluation.md'}")
    return 0


def _files(cover: str | None, world: str | None) -> list[str]:
    """The worlds that are asked for.

    Raises:
        UserError: If there is no such cover.
    """
    covers = items(cover) if cover is not None else [] if world else ["5", "10", "15"]
    unknown = [one for one in covers if one not in COVERS]
    if unknown:
        raise UserError(f"--cover: there are worlds with {', '.join(COVERS)} percent, not '{unknown[0]}'")
    return [*(COVERS[one] for one in covers), *items(world)]
