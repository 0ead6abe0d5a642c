"""Writes results in the worlds of the BARN challenge as text and draws their pictures."""

from collections.abc import Sequence
from dataclasses import asdict
from math import ceil, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from nnql_bullet import __version__
from nnql_bullet.colours import INK, LINES
from nnql_bullet.evaluation.barn import CLIPPINGS, SPEED, TIME, Barn, BarnRow
from nnql_bullet.evaluation.drives import FilmTask
from nnql_bullet.evaluation.statistics import Estimate
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import Recording
from nnql_bullet.reports.document import Picture, Report, Section, table
from nnql_bullet.reports.drawing import (
    MARKS,
    OPEN,
    draw_drive,
    finish_axes,
    legend_below,
    legend_entries,
    picture,
    without_ticks,
)
from nnql_bullet.reports.tables import csv_text, finite
from nnql_bullet.task import ENDINGS

COLUMNS = 6
"""Number of drives in a row of the picture of failures."""
HEADER = ("method", "bottleneck [m]", "worlds", *(f"{its} %" for its in ENDINGS), "time [s]")
PAPER = "Perille, Truong, Xiao and Stone, Benchmarking Metric Ground Navigation (SSRR 2020)"


def barn_table(rows: Sequence[BarnRow]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Returns header and cells of rows; percentages and scores have their 95 % intervals."""
    header = (*HEADER, *(f"score, {its.name}" for its in CLIPPINGS))
    cells = [
        (
            row.method,
            f"{row.narrowest:.2f} to {row.widest:.2f}",
            str(row.worlds),
            *(str(row.outcomes[ending]) for ending in ENDINGS),
            f"{row.time:.1f}" if isfinite(row.time) else "-",
            *(_score(row.scores[its.name]) for its in CLIPPINGS),
        )
        for row in rows
    ]
    return header, cells


def _score(score: Estimate) -> str:
    return f"{score.value:.3f} ({score.low:.3f}-{score.high:.3f})"


def protocol(barn: Barn) -> str:
    """States what was driven and how it is scored, in sentences."""
    own = sum(not its.given for its in barn.references.values())
    lengths = "of the data set's reference path" if not own else "of the reference path"
    missing = (
        f" {own} of {len(barn.references)} worlds have no path_N.npy: theirs is the shortest path of a disc as wide as "
        "the vehicle, which is shorter than the data set's."
    )
    return (
        f"{len(barn.tier.worlds)} worlds of the BARN challenge ({PAPER}), {barn.title}. "
        f"From the challenge's start, a drive has {TIME:g} s to come within 1 m of the target with the middle of its "
        "drive axle; a collision ends it, and so does standing about one place (`stuck`). It begins at "
        f"rest. OT is the time {lengths} at {SPEED:g} m/s.{missing if own else ''}"
    )


def clippings() -> str:
    """States the scores and where they are in use, in sentences."""
    uses = "; ".join(f"{its.name}: {its.source}" for its in CLIPPINGS)
    return (
        "Score: 0 if the target is not reached, else OT / clip(time, a OT, b OT), so at most 1/a. Scores of different "
        f"bounds do not compare. {uses}."
    )


ABOUT_INTERVALS = "Intervals are 95 %: Wilson's of percentages, the bootstrap's over worlds of mean scores."


def barn_markdown(barn: Barn, films: Sequence[FilmTask]) -> str:
    """Returns the report as Markdown."""
    quarters, failed = barn.rows(by_bottleneck=True), failures(barn)
    by_bottleneck = table(*barn_table(quarters), "Quarters of the worlds, by the narrowest place of the widest path.")
    refused = table(("file", "why nothing drove through it"), [(r.file, r.reason) for r in barn.evaluation.refused])
    listed = table(
        ("method", "ending", "worlds"),
        [(method, ending, ", ".join(map(str, numbers))) for (method, ending), numbers in failed.items()],
    )
    tracks = (Picture("failures.png", "tracks of failed drives"),) if films else ()
    sections = (
        Section("", (protocol(barn), clippings(), table(*barn_table(barn.rows()), note=ABOUT_INTERVALS))),
        *((Section("By bottleneck", (by_bottleneck, Picture("bottleneck.png", "success"))),) if quarters else ()),
        *((Section("Failures", (listed, *tracks)),) if failed else ()),
        *((Section("Refused worlds", (refused,)),) if barn.evaluation.refused else ()),
        Section("Again", (f"`{barn.command}`; nnql-bullet {__version__}.",)),
    )
    return Report("BARN", sections).markdown()


def failures(barn: Barn) -> dict[tuple[str, str], list[int]]:
    """Lists the numbers of the worlds in which drives of each method failed, by method and ending."""
    found: dict[tuple[str, str], list[int]] = {}
    for method in barn.evaluation.methods:
        for ending in ENDINGS:
            numbers = [
                reference.number
                for policy in barn.evaluation.of_method(method)
                for _, reference, summary in barn.drives(policy)
                if summary.ending == ending != "goal"
            ]
            if numbers:
                found[method, ending] = numbers
    return found


def barn_values(barn: Barn, films: Sequence[FilmTask]) -> dict[str, Any]:
    """Returns everything as plain values, for JSON."""
    e, tier = barn.evaluation, barn.tier
    surveyed = zip(tier.worlds, e.difficulties[tier.name], strict=True)
    return {
        "version": __version__,
        "made_by": made_by(),
        "command": barn.command,
        "protocol": {"text": protocol(barn), "time": TIME, "speed": SPEED, "source": PAPER},
        "clippings": [{"name": its.name, **asdict(its)} for its in CLIPPINGS],
        "simulator": e.setting.simulator,
        "physics": e.setting.physics,
        "policies": [policy.values for policy in e.policies],
        "rows": [_plain(row) for row in barn.rows()],
        "by_bottleneck": [_plain(row) for row in barn.rows(by_bottleneck=True)],
        "worlds": [
            {"number": barn.references[world.file].number, "file": world.file, "digest": world.digest}
            | {"reference_path": barn.references[world.file].length, "given": barn.references[world.file].given}
            | finite(asdict(its))
            for world, its in surveyed
        ],
        "drives": drive_records(barn),
        "failures": [
            {"policy": task.policy.name, "file": task.world.file, "recording": f"failures/{task.name}"}
            | {"replay": task.replay}
            for task in films
        ],
        "refused": [asdict(its) for its in e.refused],
    }


def _plain(row: BarnRow) -> dict[str, Any]:
    return finite(asdict(row))


def drive_records(barn: Barn) -> list[dict[str, Any]]:
    """Returns a flat record for each drive."""
    return [
        {
            "policy": policy.name,
            "method": policy.method,
            "world": reference.number,
            "ending": summary.ending,
            "time": summary.duration,
            "path_length": summary.path_length,
            "optimal_time": reference.optimal_time,
            **{f"score {its.name}": its.score_of(reference, summary) for its in CLIPPINGS},
            "clearance": summary.clearance,
            "decisions": summary.steps,
            "overridden": summary.overridden_steps,
        }
        for policy in barn.evaluation.policies
        for _, reference, summary in barn.drives(policy)
    ]


def drives_csv(barn: Barn) -> str:
    """Returns CSV with a line for each drive."""
    return csv_text(drive_records(barn))


def draw_bottlenecks(barn: Barn, path: Path) -> None:
    """Draws success over the bottleneck with a line for each method; draws nothing without quarters of the worlds."""
    rows = barn.rows(by_bottleneck=True)
    if not rows:
        return
    with picture(path, 8.4, 5.2) as figure:
        axes = figure.add_subplot()
        methods = barn.evaluation.methods
        for number, method in enumerate(methods):
            its = [row for row in rows if row.method == method]
            shift = 0.004 * (number - (len(methods) - 1) / 2)
            x = np.array([row.middle + shift for row in its])
            value, low, high = 100 * np.array([row.outcomes["goal"] for row in its]).T
            colour, mark = LINES[number % len(LINES)], MARKS[number % len(MARKS)]
            axes.plot(x, value, color=colour, lw=1.8, marker=mark, ms=5.5, mew=0, label=method)
            axes.vlines(x, low, high, color=colour, lw=1.1, alpha=0.6)
        axes.set(xlabel="median bottleneck of a quarter of the worlds [m]", ylabel="success [%]", ylim=(-2, 102))
        finish_axes(axes, f"BARN, {barn.title}; lines: 95 % intervals", hidden=OPEN)
        figure.legend(loc="outside right center", frameon=False, fontsize=9)


def draw_failures(barn: Barn, films: Sequence[tuple[FilmTask, Recording]], path: Path) -> None:
    """Draws tracks of failed drives, each in its world; draws nothing without drives."""
    if not films:
        return
    lines = ceil(len(films) / COLUMNS)
    with picture(path, 1.9 * min(COLUMNS, len(films)) + 0.4, 3.7 * lines + 0.6) as figure:
        grid = figure.subplots(lines, min(COLUMNS, len(films)), squeeze=False)
        for axes in grid.flat:
            axes.set_visible(False)
        for axes, (task, recording) in zip(grid.flat, films, strict=False):
            axes.set_visible(True)
            without_ticks(axes)
            axes.spines[:].set_visible(False)
            number = barn.references[task.world.file].number
            title = f"{task.policy.name}\nworld {number}: {recording.about['ending']}"
            draw_drive(axes, recording, 1.6, 0.3, title, 7.5)
        legend_below(figure, 3, legend_entries(safe="safe", non_safe="non-safe", collision="collision"))
        figure.suptitle(f"Failed drives, {barn.title}", fontsize=10, color=INK)
