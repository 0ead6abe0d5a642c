"""Writes an evaluation as text and draws its pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from math import isfinite
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from matplotlib.ticker import FixedLocator

from nnql_bullet import __version__
from nnql_bullet.colours import INK, LINES
from nnql_bullet.evaluation.drives import FilmTask
from nnql_bullet.evaluation.metrics import EVERYWHERE, Comparison, Evaluation, Quarter, Row, by_bottleneck
from nnql_bullet.evaluation.statistics import Estimate
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import Recording
from nnql_bullet.reports.document import Commands, Picture, Report, Section, table
from nnql_bullet.reports.drawing import (
    MARKS,
    OPEN,
    draw_drive,
    draw_endings,
    finish_axes,
    legend_below,
    legend_entries,
    picture,
    without_ticks,
)
from nnql_bullet.reports.tables import csv_text, finite
from nnql_bullet.task import ENDINGS


def success(row: Row) -> Estimate:
    """Returns a method's success: over training seeds if there are several, else over drives."""
    return row.over_seeds or row.outcomes["goal"]


def titles(evaluation: Evaluation) -> dict[str, str]:
    """Returns the titles of tiers, and of all of them together, by name."""
    return {**{tier.name: tier.title for tier in evaluation.tiers}, EVERYWHERE: EVERYWHERE}


def success_table(evaluation: Evaluation, rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Returns header and rows of success [%] with its interval: a row for each method, a column for each tier."""
    shown = [name for name in titles(evaluation) if any(row.world == name for row in rows)]
    by_place = {(row.method, row.world): row for row in rows}
    header = ("method", "seeds", *(titles(evaluation)[name] for name in shown))
    body = [
        (
            method,
            str(by_place[method, shown[0]].policies),
            *(str(success(by_place[method, name])) for name in shown),
        )
        for method in evaluation.methods
    ]
    return header, body


QUALITY = (
    "method",
    *("worlds", *(f"{ending} %" for ending in ENDINGS), "SPL", "path ratio", "time [s]"),
    *("clearance [m]", "mean clearance [m]", "lateral acceleration [m/s2]", "non-safe steps %"),
)


def quality_row(row: Row, title: str) -> tuple[str, ...]:
    """Returns the cells under the header `QUALITY`."""
    return (
        row.method,
        title,
        *(str(row.outcomes[ending]) for ending in ENDINGS),
        *(quantity(row, "spl", ".3f"), quantity(row, "path_ratio", ".3f"), quantity(row, "time", ".1f")),
        *(quantity(row, "clearance", ".2f"), quantity(row, "mean_clearance", ".2f")),
        *(quantity(row, "lateral_acceleration", ".2f"), quantity(row, "non_safe", ".1f", 100)),
    )


def quantity(row: Row, name: str, form: str, times: float = 1.0) -> str:
    """Formats a quantity of a row with its interval, if there is one."""
    value, interval = times * getattr(row, name), [times * end for end in row.intervals[name]]
    if not isfinite(value):
        return "-"
    return f"{value:{form}} ({interval[0]:{form}}-{interval[1]:{form}})" if isfinite(interval[0]) else f"{value:{form}}"


def _shield_section(rows: Sequence[Row], named: Mapping[str, str]) -> Section:
    """Returns the section that compares methods with a shield to the same methods without it."""
    header = (
        *("method", "worlds", "goal %", "collision %", "overridden in a drive %", "of all decisions %"),
        *("stops %", "reversing %", "standing [s]", "time [s]"),
    )
    shares = ("overridden_by_drive", "overridden", "stops", "reverses")
    cells = [
        (
            *(row.method, named[row.world]),
            *(row.outcomes[ending] for ending in ("goal", "collision")),
            *(quantity(row, name, ".1f", 100) for name in shares),
            *(quantity(row, name, ".1f") for name in ("standing", "time")),
        )
        for row in rows
    ]
    caption = (
        "Decisions that it took in its agent's place: their share of a drive's decisions, mean over drives, and of all "
        "decisions together, of which a few long drives may make the most. Among all decisions those to brake, to "
        "stand or to turn on the spot, and those to reverse; time that a drive stands, mean over all, and to the "
        "target, mean over the drives that arrive. Intervals as in the section Quality."
    )
    return Section("The shield", (table(header, cells, caption),))


def _or_none(value: float, form: str) -> str:
    return f"{value:{form}}" if isfinite(value) else "-"


ABOUT_INTERVALS = (
    "Success in percent: with several training seeds the inter-quartile mean over them and the 95 % interval of a "
    "bootstrap that draws seeds and worlds anew, crossed; else the share of drives and its Wilson 95 % interval."
)


FAILURES = "Failures"
"""Title of the section that shows failures."""


def evaluation_report(
    evaluation: Evaluation, rows: Sequence[Row], comparisons: Sequence[Comparison], films: Sequence[FilmTask]
) -> Report:
    """Returns the report as data."""
    e = evaluation
    named = titles(e)
    cover = (Picture("cover.png", "success against cover"),) if len(_covers(e)) > 1 else ()
    lead = (
        f"{e.title}; {_worlds(e)}. nnql-bullet {__version__}.",
        table(*success_table(e, rows), ABOUT_INTERVALS),
        Picture("outcomes.png", "how drives ended"),
        *cover,
    )
    quality = table(
        QUALITY,
        [quality_row(row, named[row.world]) for row in rows],
        "Outcomes are over all drives, with Wilson intervals. SPL is success weighted by path length (arXiv "
        "1807.06757), against the shortest path of a disc as wide as the vehicle; path ratio, time and clearance are "
        "means over the drives that arrive, the rest over all; their 95 % intervals are of a bootstrap that draws "
        "training seeds and worlds anew, crossed.",
    )
    methods = table(
        ("method", "agent", "what it does", "seeds", "training episodes", "numbers learned"),
        [_method_row(e, method) for method in e.methods],
    )
    quarters = by_bottleneck(e)
    worlds = table(
        (
            "worlds",
            "seeds",
            "cover %",
            "bottleneck [m]",
            "shortest path [m]",
            "tortuosity",
            "closest obstacle [m]",
            "visibility [m]",
        ),
        [_difficulty_row(e, tier.name) for tier in e.tiers],
        note="Means; the last three along the shortest path. The bottleneck is the narrowest place of the widest path.",
    )
    refused = table(("file", "why nothing drove through it"), [(its.file, its.reason) for its in e.refused])
    return Report(
        "Methods through the same worlds",
        (
            Section("", lead),
            Section("Quality", (quality,)),
            *((_bottleneck_section(quarters, e.methods, named),) if quarters else ()),
            *((_shield_section(rows, named),) if e.shielded else ()),
            Section("The methods", (methods,)),
            Section("The worlds", (worlds,)),
            *((Section("Refused worlds", (refused,)),) if e.refused else ()),
            *((_comparison_section(e, comparisons, named),) if len(e.methods) > 1 else ()),
            *((_failure_section(films),) if films else ()),
        ),
    )


def _bottleneck_section(quarters: Sequence[Quarter], methods: Sequence[str], named: Mapping[str, str]) -> Section:
    """Returns the section that shows success where the narrowest passages are narrow and where they are wide."""
    cells = [
        (named[q.world], f"{q.narrowest:.2f} to {q.widest:.2f}", q.worlds, *(q.success[method] for method in methods))
        for q in quarters
    ]
    caption = (
        "Success in percent in quarters of the worlds, by the narrowest place of the widest path to the target; Wilson "
        "95 % intervals over drives."
    )
    return Section("By bottleneck", (table(("worlds", "bottleneck [m]", "number", *methods), cells, caption),))


def _comparison_section(e: Evaluation, comparisons: Sequence[Comparison], named: Mapping[str, str]) -> Section:
    first = e.methods[0]
    cells = [
        (
            *(named[c.world], c.second, _points(c.difference)),
            *(c.pairs, c.only_first, c.only_second, "-" if c.p_value is None else f"{c.p_value:.2g}"),
        )
        for c in comparisons
        if c.first == first
    ]
    caption = (
        f"How much more often a method arrives than {first}, in points, with the 95 % interval of a bootstrap that "
        f"draws training seeds and worlds anew, crossed; pairs of drives through the same world in which {first} alone "
        "arrived, or the other alone; and p of McNemar's exact test of two single policies. Drives of several policies "
        "through one world are not independent, so there is no such test of them."
    )
    header = ("worlds", "method", "difference, points", "pairs", f"only {first} arrives", "only it arrives", "p")
    return Section(f"Against {first}", (table(header, cells, caption),))


def _points(difference: Estimate) -> str:
    value, low, high = (f"{100 * number:+.1f}" for number in difference)
    return f"{value} ({low} to {high})" if isfinite(difference.low) else value


def _failure_section(films: Sequence[FilmTask]) -> Section:
    return Section(
        FAILURES,
        (
            "The first of each method in each kind of world.",
            Picture("failures.png", "failures"),
            "Each is driven again, exactly, by:",
            Commands(tuple(task.replay for task in films)),
        ),
    )


def evaluation_markdown(
    evaluation: Evaluation, rows: Sequence[Row], comparisons: Sequence[Comparison], films: Sequence[FilmTask]
) -> str:
    """Returns the report as Markdown."""
    return evaluation_report(evaluation, rows, comparisons, films).markdown()


def _worlds(e: Evaluation) -> str:
    known = [tier.title for tier in e.tiers if not tier.frozen]
    free = f" ({', '.join(known)}: not frozen)" if known else ""
    return f"{counted(e)} of {', '.join(tier.title for tier in e.tiers)}{free}"


def counted(e: Evaluation) -> str:
    """How many worlds of each kind there are, in words, and where drives count once as nothing is random."""
    most, each = max(len(tier.worlds) for tier in e.tiers), " each" * (len(e.tiers) > 1)
    drives = {(p.name, tier.title): len(e.counted(p, tier)) for tier in e.tiers for p in e.policies}
    fixed = [
        tier.title
        for tier in e.tiers
        if len(e.draws.seeds) > 1 and all(drives[policy.name, tier.title] == 1 for policy in e.policies)
    ]
    if len(fixed) == len(e.tiers):
        return f"1 drive{each} (nothing is random)"
    remarks = [f"1 drive of {', '.join(fixed)}: nothing is random"] if fixed else []
    remarks += [
        f"{number} of {policy.name} in {tier.title} count, the others are copies"
        for policy in e.policies
        for tier in e.tiers
        if (number := drives[policy.name, tier.title]) < len(tier.worlds) and tier.title not in fixed
    ]
    worlds = f"{most} world{'s' * (most > 1)}{each}"
    return f"{worlds} ({'; '.join(remarks)})" if remarks else worlds


def _method_row(e: Evaluation, method: str) -> tuple[object, ...]:
    policies = e.of_method(method)
    learned = sorted({policy.learned for policy in policies})
    numbers = str(learned[0]) if len(learned) == 1 else f"{learned[0]} to {learned[-1]}"
    one = policies[0]
    return method, f"`{one.kind}`", one.about, len(policies), one.episodes or "-", numbers


def _difficulty_row(e: Evaluation, name: str) -> tuple[object, ...]:
    (tier,) = [tier for tier in e.tiers if tier.name == name]
    worlds, files = e.difficulties[name], len({world.file for world in tier.worlds})
    return (
        tier.title,
        f"{tier.worlds[0].seed} to {tier.worlds[-1].seed}" + (f", {files} files" if files > 1 else ""),
        f"{100 * fmean(world.cover for world in worlds):.1f}",
        f"{fmean(world.bottleneck for world in worlds):.2f}",
        _or_none(fmean(world.shortest_path for world in worlds), ".1f"),
        _or_none(fmean(world.tortuosity for world in worlds), ".3f"),
        _or_none(fmean(world.closest_obstacle for world in worlds), ".2f"),
        _or_none(fmean(world.visibility for world in worlds), ".1f"),
    )


def evaluation_values(
    evaluation: Evaluation, rows: Sequence[Row], comparisons: Sequence[Comparison], films: Sequence[FilmTask]
) -> dict[str, Any]:
    """Returns the evaluation as plain values, for JSON."""
    e = evaluation
    return {
        "version": __version__,
        "made_by": made_by(),
        "command": e.command,
        "split": e.draws.split,
        "seeds": [e.draws.seeds.start, e.draws.seeds.stop],
        "simulator": e.setting.simulator,
        "physics": e.setting.physics,
        "conditions": e.setting.conditions and asdict(e.setting.conditions),
        "allow_impassable": e.setting.allow_impassable,
        **{name: its for name, its in e.setting.ends.items() if its},
        **({"plan": True} if e.setting.plan else {}),
        "robots": sorted({policy.robot for policy in e.policies}),
        "keys": dict(e.setting.keys),
        "endings": list(ENDINGS),
        "policies": [policy.values for policy in e.policies],
        "tiers": [
            {
                "file": tier.file,
                "name": tier.name,
                "title": tier.title,
                "cover": tier.cover,
                "frozen": tier.frozen,
                "worlds": [
                    asdict(world) | finite(asdict(its))
                    for world, its in zip(tier.worlds, e.difficulties[tier.name], strict=True)
                ],
            }
            for tier in e.tiers
        ],
        "refused": [asdict(its) for its in e.refused],
        "drives": {
            policy.name: {
                tier.name: "".join(summary.ending[0] for summary in e.drives[policy.name, tier.name])
                for tier in e.tiers
            }
            for policy in e.policies
        },
        "rows": [finite(asdict(row)) | {"intervals": finite(row.intervals)} for row in rows],
        "by_bottleneck": [asdict(quarter) for quarter in by_bottleneck(e)],
        "comparisons": [finite(asdict(comparison)) for comparison in comparisons],
        "report": asdict(evaluation_report(evaluation, rows, comparisons, films)),
        "failures": [
            {
                "policy": task.policy.name,
                "world": task.tier.name,
                "file": task.world.file,
                "seed": task.world.seed,
                "recording": f"failures/{task.name}",
                "replay": task.replay,
            }
            for task in films
        ],
    }


def results_csv(rows: Sequence[Row]) -> str:
    """Returns CSV with a line for each method in each kind of world."""
    return csv_text(method_records(rows))


def method_records(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Returns a flat record for each method in each kind of world."""
    return [_flat(row) for row in rows]


def _flat(row: Row) -> dict[str, Any]:
    plain = finite(asdict(row))
    outcomes, over_seeds, intervals = (plain.pop(name) for name in ("outcomes", "over_seeds", "intervals"))
    plain["by_seed"] = " ".join(map(str, row.by_seed))
    for name, interval in (*outcomes.items(), ("over_seeds", over_seeds)):
        for part, value in zip(("", "_low", "_high"), interval or (None,) * 3, strict=True):
            plain[name + part] = value
    for name, ends in finite(intervals).items():
        plain[f"{name}_low"], plain[f"{name}_high"] = ends
    return plain


def episodes_csv(evaluation: Evaluation) -> str:
    """Returns CSV with a line for each drive."""
    return csv_text(episode_records(evaluation))


def episode_records(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Returns a flat record for each drive."""
    e, records = evaluation, []
    for policy in e.policies:
        for tier in e.tiers:
            drives = zip(tier.worlds, e.drives[policy.name, tier.name], e.difficulties[tier.name], strict=True)
            for world, summary, difficulty in drives:
                values = asdict(summary)
                times = {"waypoint_times": " ".join(map(str, values.pop("waypoint_times")))}
                terms = {f"reward_{name}": value for name, value in values.pop("terms").items()}
                where = {"policy": policy.name, "method": policy.method, "seed": policy.seed, "world": tier.name}
                where |= {"file": world.file}
                its = {"bottleneck": difficulty.bottleneck, "shortest_path": difficulty.shortest_path}
                records.append({**where, **values, **times, **terms, **its})
    return records


def draw_outcomes(evaluation: Evaluation, rows: Sequence[Row], path: Path) -> None:
    """Draws how drives ended: a panel for each tier, a bar for each method, with the interval of success."""
    e = evaluation
    with picture(path, max(7.0, 1.6 + 2.5 * len(e.tiers)), 0.36 * len(e.methods) + 1.7) as figure:
        panels = figure.subplots(1, len(e.tiers), sharey=True, squeeze=False)[0]
        for axes, tier in zip(panels, e.tiers, strict=True):
            its = [row for row in rows if row.world == tier.name]
            draw_endings(axes, e.methods, [row.outcomes for row in its], [success(row) for row in its])
            axes.set(xlim=(0, 118), xlabel="drives [%]")
            axes.xaxis.set_major_locator(FixedLocator([0, 50, 100]))
            finish_axes(axes, tier.title, grid="none", hidden=OPEN)
        legend_below(figure, 3)
        figure.suptitle(f"{e.title}; bar and number: success, 95 % interval", fontsize=10, color=INK)


def _covers(e: Evaluation) -> list[tuple[float, str]]:
    """Returns covers in ascending order, with the names of their tiers."""
    return sorted((tier.cover, tier.name) for tier in e.tiers if tier.cover is not None)


def draw_cover(evaluation: Evaluation, rows: Sequence[Row], path: Path) -> None:
    """Draws success over cover with a line for each method; draws nothing for fewer than two covers."""
    e, covers = evaluation, _covers(evaluation)
    if len(covers) < 2:
        return
    with picture(path, 8.4, 5.2) as figure:
        axes = figure.add_subplot()
        by_place = {(row.method, row.world): success(row) for row in rows}
        last = covers[-1][1]
        ranked = sorted(e.methods, key=lambda method: -by_place[method, last].value)
        apart = 0.06 * min(b - a for (a, _), (b, _) in pairwise(covers))
        for number, method in enumerate(ranked):
            shares = [by_place[method, name] for _, name in covers]
            x = np.array(
                [100 * (cover + apart * (number - (len(ranked) - 1) / 2) / len(ranked)) for cover, _ in covers]
            )
            value, low, high = 100 * np.array(shares).T
            colour, mark = LINES[number % len(LINES)], MARKS[number % len(MARKS)]
            axes.plot(x, value, color=colour, lw=1.8, marker=mark, ms=5.5, mew=0, label=method)
            axes.vlines(x, low, high, color=colour, lw=1.1, alpha=0.6)
        axes.set(xlabel="arena under boxes [%]", ylabel="success [%]", ylim=(-2, 102))
        axes.set_xticks([100 * cover for cover, _ in covers])
        finish_axes(axes, f"{e.title}; lines: 95 % intervals", hidden=OPEN)
        figure.legend(loc="outside right center", frameon=False, fontsize=9)


def draw_failures(films: Sequence[tuple[FilmTask, Recording]], path: Path) -> None:
    """Draws paths of failed drives: a row for each method, a column for each kind of world; nothing without drives.

    Args:
        films: Drives, at most one of each method in each kind of world.
        path: Path of the picture.
    """
    if not films:
        return
    methods = list(dict.fromkeys(task.policy.method for task, _ in films))
    tiers = list(dict.fromkeys(task.tier.name for task, _ in films))
    with picture(path, 2.6 * len(tiers) + 0.4, 2.7 * len(methods) + 0.6) as figure:
        grid = figure.subplots(len(methods), len(tiers), squeeze=False)
        for axes in grid.flat:
            axes.set_visible(False)
        for task, recording in films:
            axes = grid[methods.index(task.policy.method)][tiers.index(task.tier.name)]
            axes.set_visible(True)
            without_ticks(axes)
            axes.spines[:].set_visible(False)
            draw_drive(axes, recording, 0.6, 1.0, f"{task.policy.name}\n{task.where}", 7.5)
        legend_below(figure, 3, legend_entries(safe="safe", non_safe="non-safe", collision="collision"))
