"""Writes the sim-to-sim gap between two simulators as text and draws its pictures."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from nnql_bullet import __version__
from nnql_bullet.colours import COLLISION, INK, NON_SAFE, SAFE, TIMEOUT
from nnql_bullet.evaluation.causes import CAUSES, DRIFT, GRAZE, NOTABLE, Explanation
from nnql_bullet.evaluation.gap import (
    FaultRow,
    Gap,
    Pair,
    differences,
    divergence,
    fault_rows,
    flip_file,
    outcome_matrix,
    success_p_value,
)
from nnql_bullet.evaluation.statistics import proportion
from nnql_bullet.geometry import Array
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import load_recording
from nnql_bullet.reports.document import Block, Commands, Picture, Report, Section, table
from nnql_bullet.reports.drawing import (
    OPEN,
    POWERS,
    draw_endings,
    draw_world,
    finish_axes,
    frame_world,
    legend_below,
    legend_entries,
    picture,
)
from nnql_bullet.reports.tables import csv_text, finite
from nnql_bullet.task import ENDINGS


def gap_report(gap: Gap) -> Report:
    """Returns the report as data: endings on both sides, causes of differences, and the effects of faults."""
    first, second = gap.first.name, gap.second.name
    matrix = outcome_matrix(gap.pairs)
    total, same = int(matrix.sum()), int(np.trace(matrix))
    goals = [proportion(int(sums[ENDINGS.index("goal")]), total) for sums in (matrix.sum(axis=1), matrix.sum(axis=0))]
    lead: list[Block] = [
        f"{', '.join(gap.runs)}; {gap.title}{', ' if gap.title else ''}seeds {gap.draws.seeds[0]} to "
        f"{gap.draws.seeds[-1]}: {total} pairs of drives. nnql-bullet {__version__}.",
        f"{same} of {total} pairs end alike. Success: {goals[0]} % in {first}, {goals[1]} % in {second} (Wilson 95 % "
        f"intervals over drives); McNemar's exact test p = {success_p_value(gap.pairs):.2g}.",
        Picture("gap.png", "the gap"),
        table(
            (f"{first} \\ {second}", *ENDINGS),
            [(name, *row) for name, row in zip(ENDINGS, matrix.tolist(), strict=True)],
        ),
        table(
            ("policy", first, second, "alike"),
            [_policy_row(run, [pair for pair in gap.pairs if pair.run == run]) for run in gap.runs],
        ),
    ]
    rows = differences(gap.pairs)
    if rows:
        lead.append(
            table(
                ("quantity", "mean", "10 % to 90 % of drives"),
                [(f"{r.quantity} [{r.unit}]", f"{r.mean:+.3f}", f"{r.low:+.3f} to {r.high:+.3f}") for r in rows],
                f"Drives that reach the target on both sides, {second} less {first}:",
            )
        )
    if not gap.flips:
        lead.append("No drive ended differently.")
    return Report(
        f"The gap: {first} against {second}",
        (
            Section("", tuple(lead)),
            *((_flip_section(gap),) if gap.flips else ()),
            *((_fault_section(gap),) if gap.trials else ()),
        ),
    )


def _fault_section(gap: Gap) -> Section:
    return Section(
        f"Success by fault, in {gap.second.name}",
        (
            "The policies are told of none of these, and were not trained with them.",
            Picture("faults.png", "success by fault"),
            table(
                (
                    "fault",
                    *(f"{ending} %" for ending in ENDINGS),
                    "McNemar p against none",
                    f"goal % in {gap.first.name}",
                ),
                [_fault_row(row) for row in fault_rows(gap)],
            ),
        ),
    )


def _flip_section(gap: Gap) -> Section:
    causes = Counter(pair.explanation.cause for pair in gap.flips if pair.explanation)
    counted = ", ".join(f"{cause} {causes[cause]}" for cause in CAUSES)
    return Section(
        f"The {len(gap.flips)} drives that ended differently",
        (
            f"By cause: {counted}. The cause is slip or lag, whichever adds up to more, if before the drives part one "
            f"of them exceeds {NOTABLE:.0%} of the way in a control period, or the drives are more than {DRIFT:g} m "
            f"apart by then; else a graze, if one missed by less than {GRAZE:g} m what the other touched. What is left "
            "hangs on a decision that was too close to call.",
            Picture("flips.png", "drives that ended differently"),
            table(
                (
                    *("policy", "seed", "endings", "cause", "parted at [s]", "apart then [mm]"),
                    *("slip", "lag", "decision", "miss [m]"),
                ),
                [_flip_row(pair, pair.explanation) for pair in gap.flips if pair.explanation],
            ),
            "Each is driven again, exactly, by:",
            Commands(tuple(gap.replay(pair, side) for pair in gap.flips for side in (gap.first, gap.second))),
        ),
    )


def gap_markdown(gap: Gap) -> str:
    """Returns the report as Markdown."""
    return gap_report(gap).markdown()


def gap_values(gap: Gap) -> dict[str, Any]:
    """Returns the gap as plain values, for JSON."""
    d = divergence(gap.pairs)
    return {
        "version": __version__,
        "made_by": made_by(),
        "command": gap.command,
        "runs": list(gap.runs),
        "policies": [{"path": run, "fingerprint": its} for run, its in zip(gap.runs, gap.fingerprints, strict=True)],
        "world": gap.world,
        "conditions": gap.setting.conditions and asdict(gap.setting.conditions),
        **{name: its for name, its in gap.setting.ends.items() if its},
        **({"plan": True} if gap.setting.plan else {}),
        "robots": sorted(set(gap.robots)),
        "shield": gap.setting.shield,
        "keys": dict(gap.setting.keys),
        "seeds": [gap.draws.seeds.start, gap.draws.seeds.stop],
        "first": gap.first.name,
        "second": gap.second.name,
        "endings": list(ENDINGS),
        "outcomes": outcome_matrix(gap.pairs).tolist(),
        "success_p_value": success_p_value(gap.pairs),
        "divergence": {name: values.tolist() for name, values in asdict(d).items()},
        "differences": [asdict(row) for row in differences(gap.pairs)],
        "flips": [
            {
                "run": pair.run,
                "world_seed": pair.world_seed,
                "first": pair.first.ending,
                "second": pair.second.ending,
                **finite(asdict(pair.explanation)),
                "replay": [gap.replay(pair, side) for side in (gap.first, gap.second)],
            }
            for pair in gap.flips
            if pair.explanation
        ],
        "faults": [
            {
                "fault": row.fault or "none",
                "p_value": row.p_value,
                **{name: list(share) for name, share in row.shares.items()},
                "goal_first": row.first_goal and list(row.first_goal),
            }
            for row in fault_rows(gap)
        ],
        "report": asdict(gap_report(gap)),
    }


def gap_csv(gap: Gap) -> str:
    """Returns CSV with a line for each drive, with and without faults."""
    return csv_text(gap_records(gap))


def gap_records(gap: Gap) -> list[dict[str, Any]]:
    """Returns a flat record for each drive, with and without faults."""
    drives = [(pair.run, gap.first.name, "", pair.first) for pair in gap.pairs]
    drives += [(pair.run, gap.second.name, "", pair.second) for pair in gap.pairs]
    drives += [(trial.run, trial.side.name, trial.fault, trial.summary) for trial in gap.trials]
    shown = ("world_seed", "ending", "steps", "duration", "path_length", "clearance")
    return [
        {"run": run, "simulator": simulator, "fault": fault, **{name: getattr(summary, name) for name in shown}}
        for run, simulator, fault, summary in drives
    ]


def gap_table(gap: Gap) -> str:
    """Writes a table of endings on both sides, then success by fault, as text."""
    title = f"; {gap.title}" if gap.title else ""
    lines = [f"rows {gap.first.name}, columns {gap.second.name}; {len(gap.pairs)} pairs of drives{title}"]
    lines.append(f"{'':<11}" + "".join(f"{ending:>11}" for ending in ENDINGS))
    for ending, row in zip(ENDINGS, outcome_matrix(gap.pairs).tolist(), strict=True):
        lines.append(f"{ending:<11}" + "".join(f"{count:>11}" for count in row))
    p_value = success_p_value(gap.pairs)
    lines.append(f"McNemar p = {p_value:.2g}; {len(gap.flips)} drives ended differently")
    if gap.trials:
        lines.append(f"{'fault':<24}{'goal %':>20}{'collision %':>20}{'p':>9}{f'goal % in {gap.first.name}':>28}")
        for one in fault_rows(gap):
            shares = f"{one.shares['goal']!s:>20}{one.shares['collision']!s:>20}"
            p_text = f"{one.p_value:.2g}" if one.fault else ""
            lines.append(f"{one.fault or 'none':<24}{shares}{p_text:>9}{one.first_goal or 'as none'!s:>28}")
    return "\n".join(lines)


def draw_gap(gap: Gap, path: Path) -> None:
    """Draws outcomes on both sides, distances between both vehicles, and differences if both reach the target."""
    with picture(path, 11.0, 8.2, POWERS) as figure:
        if gap.asked:
            figure.suptitle(gap.asked, fontsize=10, color=INK)
        (outcomes, apart), (times, clearances) = figure.subplots(2, 2)
        _draw_outcomes(outcomes, gap)
        _draw_divergence(apart, gap)
        both = [pair for pair in gap.pairs if pair.first.ending == pair.second.ending == "goal"]
        _draw_against(times, both, gap, "duration", "time to the target [s]")
        _draw_against(clearances, both, gap, "clearance", "smallest clearance [m]")


def draw_faults(gap: Gap, path: Path) -> None:
    """Draws the endings with each fault, with the Wilson interval of success; draws nothing without faults."""
    if not gap.trials:
        return
    rows = fault_rows(gap)
    with picture(path, 9.0, 0.42 * len(rows) + 1.6) as figure:
        axes = figure.add_subplot()
        shares = [row.shares for row in rows]
        draw_endings(axes, [row.fault or "none" for row in rows], shares, [one["goal"] for one in shares], digits=1)
        for place, row in enumerate(reversed(rows)):
            if row.first_goal:
                axes.plot(100 * row.first_goal.value, place, "D", mfc="white", mec=INK, ms=5.5, zorder=3)
        axes.set(
            xlim=(0, 108), xlabel=f"drives [%]; bar: 95 % interval of success; diamond: success in {gap.first.name}"
        )
        title = f"Success by fault in {gap.second.name}, {len(gap.pairs)} drives each"
        finish_axes(axes, title, 11, grid="none", hidden=OPEN)
        legend_below(figure, 3)


FLIPS_SHOWN = 6


def draw_flips(gap: Gap, folder: Path, path: Path) -> None:
    """Draws both paths of the first drives that ended differently, and the place of the first different decision.

    Moving boxes are drawn at the time of that decision.

    Args:
        gap: Measured gap.
        folder: Folder of the recordings.
        path: Path of the picture; nothing is drawn without such drives.
    """
    if not gap.flips:
        return
    drives = []
    for pair in gap.flips[:FLIPS_SHOWN]:
        files = [flip_file(folder, pair.run, pair.world_seed, side) for side in (gap.first, gap.second)]
        drives.append((pair, load_recording(files[0]), load_recording(files[1])))
    columns = min(3, len(drives))
    rows = -(-len(drives) // columns)
    with picture(path, 4.0 * columns, 4.3 * rows + 0.4) as figure:
        for axes, (pair, first, second) in zip(
            figure.subplots(rows, columns, squeeze=False).flat, drives, strict=False
        ):
            draw_world(axes, first.world, pair.explanation.time if pair.explanation else first.state_time[-1])
            for recording, colour, width in ((first, SAFE, 2.6), (second, NON_SAFE, 1.3)):
                axes.plot(*recording.sample_pose[:, :2].T, color=colour, lw=width, solid_capstyle="round", zorder=4)
                if recording.contact[-1]:
                    axes.plot(*recording.state_pose[-1, :2], "X", color=COLLISION, mec="white", ms=10, zorder=7)
            if pair.explanation:
                step = int(np.searchsorted(first.state_time, pair.explanation.time - 1e-9))
                axes.plot(*first.state_pose[step, :2], "o", mfc="none", mec=INK, ms=11, mew=1.6, zorder=8)
                cause = pair.explanation.cause
                ends = f"{pair.first.ending} | {pair.second.ending}"
                title = f"{Path(pair.run).name}, seed {pair.world_seed}: {ends} ({cause})"
                finish_axes(axes, title, 9, grid="none")
            frame_world(axes, first, 1.0)
            axes.set(xlabel="x [m]", ylabel="y [m]")
        for axes in figure.axes[len(drives) :]:
            axes.set_visible(False)
        handles = [
            Line2D([], [], color=SAFE, lw=2.6, label=gap.first.name),
            Line2D([], [], color=NON_SAFE, lw=1.6, label=gap.second.name),
            Line2D([], [], marker="o", ls="", mfc="none", mec=INK, ms=10, label="first different decision"),
            *legend_entries(collision="collision"),
        ]
        legend_below(figure, len(handles), handles)


def _draw_outcomes(axes: Axes, gap: Gap) -> None:
    matrix = outcome_matrix(gap.pairs)
    axes.imshow(matrix / matrix.sum(), cmap="Blues", vmin=0, vmax=1)
    for (row, column), count in np.ndenumerate(matrix):
        dark = count > 0.5 * matrix.sum()
        axes.text(column, row, str(count), ha="center", va="center", fontsize=14, color="white" if dark else INK)
    axes.set_xticks(range(len(ENDINGS)), ENDINGS)
    axes.set_yticks(range(len(ENDINGS)), ENDINGS)
    axes.set(xlabel=gap.second.name, ylabel=gap.first.name)
    finish_axes(axes, f"how {len(gap.pairs)} pairs ended; McNemar p = {success_p_value(gap.pairs):.2g}", grid="none")


def _draw_divergence(axes: Axes, gap: Gap) -> None:
    d = divergence(gap.pairs)
    floor = 1e-4
    axes.plot(d.time, np.maximum(d.median, floor), color=SAFE, lw=1.8, label="median")
    axes.plot(d.time, np.maximum(d.ninetieth, floor), color=NON_SAFE, lw=1.8, label="90 % are closer")
    axes.set(yscale="log", xlabel="time [s]", ylabel="distance between the two vehicles [m]", ylim=(floor, None))
    axes.set_xlim(0, max(float(d.time[-1]), 1.0))
    right = axes.twinx()
    right.plot(d.time, 100 * d.parted, color=TIMEOUT, lw=1.4, ls="--")
    right.set_ylabel("pairs that have decided differently [%]", color=TIMEOUT)
    right.set_ylim(0, 100)
    axes.legend(loc="upper left", frameon=False, fontsize=9)
    finish_axes(axes, "how far apart, while at least half of the pairs drive")


def _draw_against(axes: Axes, both: Sequence[Pair], gap: Gap, name: str, label: str) -> None:
    first: Array = np.array([getattr(pair.first, name) for pair in both])
    second: Array = np.array([getattr(pair.second, name) for pair in both])
    most = 1.05 * max(first.max(initial=0.0), second.max(initial=0.0), 1e-3)
    axes.plot([0, most], [0, most], color=TIMEOUT, lw=1.0)
    axes.plot(first, second, "o", color=SAFE, ms=4, alpha=0.5, mew=0)
    axes.set(xlim=(0, most), ylim=(0, most), aspect="equal")
    axes.set(xlabel=f"{gap.first.name}: {label}", ylabel=f"{gap.second.name}: {label}")
    finish_axes(axes, f"{len(both)} pairs that both reach the target")


def _policy_row(run: str, pairs: Sequence[Pair]) -> tuple[object, ...]:
    first = sum(pair.first.ending == "goal" for pair in pairs)
    second = sum(pair.second.ending == "goal" for pair in pairs)
    alike = sum(not pair.flipped for pair in pairs)
    return run, proportion(first, len(pairs)), proportion(second, len(pairs)), f"{alike} of {len(pairs)}"


def _fault_row(row: FaultRow) -> tuple[object, ...]:
    p_value = f"{row.p_value:.2g}" if row.fault else ""
    shares = (row.shares[ending] for ending in ENDINGS)
    return row.fault or "none", *shares, p_value, row.first_goal or "as none"


def _flip_row(pair: Pair, e: Explanation) -> tuple[object, ...]:
    numbers = f"{e.time:.1f}", f"{1000 * e.apart:.0f}", f"{e.slip:.2%}", f"{e.lag:.2%}"
    miss = f"{e.miss:.3f}" if isfinite(e.miss) else ""
    ends = f"{pair.first.ending}, {pair.second.ending}"
    return Path(pair.run).name, pair.world_seed, ends, e.cause, *numbers, _decision(pair, e), miss


def _decision(pair: Pair, explanation: Explanation) -> str:
    """Describes the first different decision."""
    margin = explanation.q_margin
    if not isfinite(pair.parted):
        return "none"
    return f"turn, Q apart by {margin:.3f}" if isfinite(margin) else "safe or not"
