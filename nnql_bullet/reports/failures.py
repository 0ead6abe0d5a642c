"""Writes groups of failures as text and draws their pictures."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from math import degrees
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from nnql_bullet import __version__
from nnql_bullet.colours import COLLISION, INK
from nnql_bullet.evaluation.failures import (
    GROUPS,
    HEAD_ON,
    HESITATION,
    LAST_PART,
    NEAR_TARGET,
    RETURN_AFTER,
    REVERSALS,
    REVISITED,
    ROUNDS,
    SAME_PLACE,
    SMALLEST_TURN,
    STRUCK,
    Contact,
    Features,
    Group,
)
from nnql_bullet.evaluation.replays import Failures, Replay, earlier_alike
from nnql_bullet.geometry import Array
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import RECORDINGS, Recording
from nnql_bullet.reports.document import Block, Commands, Picture, Report, Section, Table, table
from nnql_bullet.reports.drawing import (
    draw_drive,
    draw_path,
    draw_world,
    legend_below,
    legend_entries,
    picture,
    without_ticks,
)
from nnql_bullet.sim.contact import OVERTURNED

T = TypeVar("T")

FILES = (*RECORDINGS, "*.png", "failures.*")
"""Patterns of the recordings, films, pictures and reports of failures."""
SHOWN = 12
"""Largest number of drives on a contact sheet."""
COLUMNS = 6
"""Number of drives in a row of a sheet."""
CLOSE = 4.0
"""Smallest half side of an enlarged part [m]."""
ARENA_MARGIN = 1.0
"""Width of the frame around the arena [m]."""

RULES: dict[Group, str] = {
    "struck": f"A moving box was touched, and at least {STRUCK:.0%} of the speed at which they met was its own.",
    "flank": f"From the heading to the way straight through what was touched it is more than {degrees(HEAD_ON):.0f} "
    "degrees.",
    "dithering": f"In the last {HESITATION:g} s, turns of at least {degrees(SMALLEST_TURN):.0f} degrees changed sides "
    f"at least {REVERSALS} times.",
    "head-on": "Every other collision.",
    "overturned": f"It tilted by more than {degrees(OVERTURNED):.0f} degrees, in contact physics.",
    "stuck": "It ended as stuck: see the options `task.stuck_after` and `task.stuck_radius`.",
    "target circling": f"In the last {LAST_PART:g} s it was never more than {NEAR_TARGET:g} m from the target.",
    "circling": f"In the last {LAST_PART:g} s it made at least {ROUNDS:g} full turns more to one side than to the "
    "other.",
    "trapped": f"At least {REVISITED:.0%} of the last {LAST_PART:g} s it was less than {SAME_PLACE:g} m from where it "
    f"had been {RETURN_AFTER:g} s before or earlier.",
    "wandering": "Every other drive that ran out of time.",
}
"""Rules of `evaluation.failures` in words."""


def sheet(group: Group) -> str:
    """Returns the file name of a group's contact sheet."""
    return f"{group.replace(' ', '-')}.png"


def varied(drives: Sequence[T], places: Sequence[tuple[str, str]], most: int) -> list[T]:
    """Chooses drives of as many methods and worlds as possible, and keeps their order.

    Args:
        drives: Drives to choose from.
        places: Method and world of each.
        most: Largest number of drives to choose.
    """
    ranks = earlier_alike(places)
    by_world = sorted(range(len(drives)), key=lambda number: (ranks[number], number))
    turns = earlier_alike(places[number][0] for number in by_world)
    first = sorted(zip(turns, by_world, strict=True))[:most]
    return [drives[number] for number in sorted(number for _, number in first)]


def counted(found: Failures) -> str:
    """States the number of failures and of repeated drives."""
    total, driven = len(found.evaluation.failed), len(found.replays)
    if not total:
        return "no drive of this evaluation failed"
    if driven == total:
        return f"all {total} failures"
    return f"{driven} of {total} failures: of each method in each kind of world at most {found.most}"


def count_table(found: Failures) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Returns header and rows: the number of failures of each method in each group."""
    counts = Counter((one.failed.place[0], one.group) for one in found.replays)
    methods = dict.fromkeys(method for method, _ in found.places)
    rows = [(method, *(str(counts[method, name] or "-") for name in found.groups)) for method in methods]
    return ("method", *found.groups), rows


def failures_markdown(found: Failures) -> str:
    """Returns the report as Markdown: counts, and for each group a description, its contact sheet and its drives."""
    lead: tuple[Block, ...] = (
        f"{counted(found).capitalize()}. `{found.evaluation.command}`; nnql-bullet {__version__}.",
    )
    if found.replays:
        lead += (
            "Each was driven again and is in one group: the first whose rule fits. Groups describe what is seen; they "
            "are not causes.",
            _counts(found),
            table(("group", "ending", "rule"), [(name, _ending(name), RULES[name]) for name in GROUPS]),
        )
    groups = [_group_section(name, its) for name, its in found.groups.items()]
    return Report("How drives failed", (Section("", lead), *groups)).markdown()


def _group_section(name: Group, its: Sequence[Replay]) -> Section:
    few = f" The sheet shows {SHOWN} of them." if len(its) > SHOWN else ""
    rows = [{"drive": one.failed.title, **_cells(one.features)} for one in its]
    return Section(
        f"{name.capitalize()}: {len(its)}",
        (
            f"{GROUPS[name]}{few}",
            Picture(sheet(name), name),
            table(tuple(rows[0]), [row.values() for row in rows]),
            "They are driven again, exactly, by:",
            Commands(tuple(one.failed.film.replay for one in its)),
        ),
    )


def _counts(found: Failures) -> Table:
    """Counts failures of each method in each kind of world: all, the repeated ones, and those of each group."""
    everything = Counter(one.place for one in found.evaluation.failed)
    driven = Counter(one.failed.place for one in found.replays)
    counts = Counter((one.failed.place, one.group) for one in found.replays)
    titles = {one.failed.place: one.failed.film.tier.title for one in found.replays}
    rows = [
        (
            *(place[0], titles[place], everything[place], driven[place]),
            *(counts[place, name] or "" for name in found.groups),
        )
        for place in found.places
    ]
    return table(("method", "worlds", "failures", "driven again", *found.groups), rows)


def _ending(group: Group) -> str:
    if group in ("struck", "flank", "dithering", "head-on"):
        return "collision"
    return group if group in ("overturned", "stuck") else "timeout"


def _cells(features: Features) -> dict[str, str]:
    """Returns features under the names of a table."""
    time, end = {"time [s]": f"{features.time:.1f}"}, features.end
    if isinstance(end, Contact):
        return time | {
            "touched": end.touched,
            "angle of impact [degrees]": f"{degrees(end.angle):.0f}",
            "touched at [degrees]": f"{degrees(end.bearing):+.0f}",
            "turns changed sides": str(end.reversals),
        }
    return time | {
        "stayed within [m]": f"{end.extent:.0f}",
        "rounds": f"{end.rounds:+.1f}",
        "where it had been [%]": f"{100 * end.revisited:.0f}",
        "target at the end [m]": f"{features.target_distance:.0f}",
        "nearest ever [m]": f"{features.least_target_distance:.0f}",
    }


def failure_records(found: Failures) -> list[dict[str, Any]]:
    """Returns a flat record for each failure."""
    return [
        {
            "policy": one.failed.film.policy.name,
            "method": one.failed.film.policy.method,
            "world": one.failed.film.tier.name,
            "world_seed": one.failed.seed,
            "ending": one.ending,
            "steps": one.steps,
            "group": one.group,
            "time": one.features.time,
            "target_distance": one.features.target_distance,
        }
        for one in found.replays
    ]


def failures_values(found: Failures) -> dict[str, Any]:
    """Returns the failures as plain values, for JSON."""
    return {
        "version": __version__,
        "made_by": made_by(),
        "evaluation": found.evaluation.command,
        "most": found.most,
        "failures": len(found.evaluation.failed),
        "replayed": len(found.replays),
        "groups": [
            {
                "name": name,
                "about": GROUPS[name],
                "rule": RULES[name],
                "sheet": f"failures/{sheet(name)}",
                "failures": [
                    {
                        "policy": one.failed.film.policy.name,
                        "world": one.failed.film.tier.name,
                        "title": one.failed.title,
                        "seed": one.failed.seed,
                        "ending": one.ending,
                        "recording": f"failures/{one.failed.film.name}",
                        "replay": one.failed.film.replay,
                        "features": asdict(one.features),
                    }
                    for one in its
                ],
            }
            for name, its in found.groups.items()
        ],
    }


def draw_sheet(drives: Sequence[tuple[str, Recording, Features]], path: Path) -> None:
    """Draws a contact sheet: the whole arena of each drive, and below it the enlarged end.

    Args:
        drives: Titles, recordings and features; at least one.
        path: Path of the picture.
    """
    columns = min(COLUMNS, len(drives))
    rows = -(-len(drives) // columns)
    with picture(path, max(2.25 * columns, 5.0), 4.85 * rows + 0.6) as figure:
        grid = figure.subplots(2 * rows, columns, squeeze=False)
        for axes in grid.flat:
            axes.set_axis_off()
        for number, (title, recording, features) in enumerate(drives):
            row, column = divmod(number, columns)
            whole, end = grid[2 * row][column], grid[2 * row + 1][column]
            middle, half = _frame(recording, features)
            draw_drive(whole, recording, 0.6, ARENA_MARGIN, title, 7.5)
            left, low = middle - half
            whole.add_patch(Rectangle((left, low), 2 * half, 2 * half, fc="none", ec=INK, lw=0.8, alpha=0.8, zorder=8))
            _draw_end(end, recording, features)
            end.set(xlim=middle[0] + (-half, half), ylim=middle[1] + (-half, half), aspect="equal")
            end.set_title(_what(features), fontsize=7, color=INK, pad=3)
            about_size = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
            end.text(
                0.03,
                0.03,
                f"{2 * half:.0f} m",
                transform=end.transAxes,
                fontsize=7,
                color=INK,
                zorder=9,
                bbox=about_size,
            )
        handles = _legend([recording for _, recording, _ in drives])
        legend_below(figure, min(len(handles), columns + 1), handles)


def _frame(recording: Recording, features: Features) -> tuple[Array, float]:
    """Returns middle (2,) and half side of the enlarged part [m]: the contact, or the path of the last minute."""
    world = recording.world
    if isinstance(features.end, Contact):
        return np.array(features.end.place), CLOSE
    late = recording.sample_pose[recording.sample_time >= recording.sample_time[-1] - LAST_PART, :2]
    half = max(float(np.ptp(late, axis=0).max()) / 2 + ARENA_MARGIN, CLOSE)
    least, most = half - ARENA_MARGIN, np.array([world.width, world.depth]) - half + ARENA_MARGIN
    return np.clip((late.min(axis=0) + late.max(axis=0)) / 2, least, np.maximum(most, least)), half


def _draw_end(axes: Axes, recording: Recording, features: Features) -> None:
    draw_world(axes, recording.world, recording.state_time[-1])
    draw_path(axes, recording, 1.5 if isinstance(features.end, Contact) else 1.0, cross=False)
    if isinstance(features.end, Contact):
        axes.plot(*features.end.place, "o", mfc=COLLISION, mec="white", ms=6, zorder=8)
    axes.set_axis_on()
    without_ticks(axes)
    axes.spines[:].set(color=INK, lw=0.8, alpha=0.8)


def _what(features: Features) -> str:
    if isinstance(features.end, Contact):
        return f"{features.end.touched}, {degrees(features.end.angle):.0f} degrees, at {features.time:.1f} s"
    return f"the last minute of {features.time:.0f} s" if features.time > LAST_PART else f"all {features.time:.0f} s"


def _legend(recordings: Sequence[Recording]) -> list[Line2D | Patch]:
    moves = any(recording.patrols for recording in recordings)
    collides = any(recording.about["ending"] == "collision" for recording in recordings)
    return legend_entries(
        safe="in a safe state",
        non_safe="in a non-safe state",
        vehicle="vehicle at the end",
        target="target",
        obstacle="box",
        **({"moving": "moving box, at the end"} if moves else {}),
        **({"touched": "touched here"} if collides else {}),
    )
