"""Writes a sweep as tables and as TOML, and draws it as a picture."""

from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from nnql_bullet import __version__
from nnql_bullet.colours import BOX, COLLISION, GOAL, INK
from nnql_bullet.commands import preset_and_changes
from nnql_bullet.config import write_toml
from nnql_bullet.evaluation.space import Space, Trial, best_of
from nnql_bullet.evaluation.sweep import Sweep
from nnql_bullet.reports.drawing import OPEN, POWERS, finish_axes, picture
from nnql_bullet.run_config import RunConfig

COLUMNS = 3
"""Panels in a row of the picture."""


def sweep_records(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Returns a flat record for each trial."""
    return [
        {
            "trial": its.number,
            "state": its.state,
            "success": its.score,
            "evaluations": " ".join(f"{value:g}" for value in its.history),
            **its.values,
            "reason": its.reason,
        }
        for its in trials
    ]


def best_table(
    space: Space[RunConfig], trials: Sequence[Trial], most: int
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Returns header and rows of a table of the best trials."""
    left = list(trials)
    rows: list[tuple[str, ...]] = []
    while (best := best_of(left)) is not None and len(rows) < most:
        values = (best.values[name] for name in space.names)
        texts = (f"{value:.4g}" if isinstance(value, float) else str(value) for value in values)
        rows.append((str(best.number), f"{best.history[-1]:.1%}", *texts))
        left.remove(best)
    return ("trial", "success", *space.names), rows


def short_config(config: RunConfig) -> dict[str, Any]:
    """Returns the preset and the fewest values over it that give a configuration."""
    preset, changes = preset_and_changes(config)
    return {"preset": preset, **changes}


def best_toml(config: RunConfig, best: Trial) -> str:
    """Writes the configuration of the best trial as TOML that a training reads."""
    found = (
        f"Trial {best.number} of nnql-bullet sweep {__version__}: success {best.history[-1]:.1%} in its last evaluation"
    )
    return f"# {found}\n{write_toml(short_config(config))}"


def draw_sweep(sweep: Sweep, trials: Sequence[Trial], path: Path) -> None:
    """Draws the success of every trial in their order, and against each value that was searched."""
    space, shown = sweep.space, [its for its in trials if its.history]
    panels = 1 + len(space.names)
    columns = min(panels, COLUMNS)
    rows = ceil(panels / columns)
    success = np.array([100 * its.history[-1] for its in shown])
    colours = [GOAL if its.state == "trained" else BOX for its in shown]
    with picture(path, 1.0 + 3.6 * columns, 0.8 + 2.7 * rows, POWERS) as figure:
        axes = [figure.add_subplot(rows, columns, 1 + place) for place in range(panels)]
        trained = [(its.number, 100 * its.score) for its in shown if its.score is not None]
        if trained:
            numbers, scores = zip(*trained, strict=True)
            axes[0].step(numbers, np.maximum.accumulate(scores), where="post", color=INK, lw=1.2)
        axes[0].scatter([its.number for its in shown], success, c=colours, s=16, zorder=3)
        axes[0].set(xlabel="trial", ylabel="success [%]")
        for panel, name in zip(axes[1:], space.names, strict=True):
            values = [its.values[name] for its in shown]
            if name in space.choices:
                texts = space.choices[name]
                panel.scatter([texts.index(value) for value in values], success, c=colours, s=16, zorder=3)
                panel.set_xticks(range(len(texts)), texts, fontsize=8)
                panel.set_xlim(-0.5, len(texts) - 0.5)
            else:
                its_range = space.ranges[name]
                panel.scatter(values, success, c=colours, s=16, zorder=3)
                panel.set_xscale("log" if its_range.log else "linear")
                panel.set_xlim(its_range.low, its_range.high)
            panel.set_xlabel(name)
        best = best_of(trials)
        for panel, name in zip(axes, ("", *space.names), strict=True):
            if best is not None:
                value = best.values[name] if name else best.number
                place = space.choices[name].index(value) if name in space.choices else value
                panel.plot(place, 100 * best.history[-1], "o", mfc="none", mec=COLLISION, mew=1.6, ms=9)
            panel.set_ylim(-3, 103)
            finish_axes(panel, hidden=OPEN)
        pruned = sum(its.state == "pruned" for its in trials)
        failed = sum(its.state == "failed" for its in trials)
        title = f"{len(trials)} trials, {pruned} given up early (grey), {failed} failed; ringed: the best"
        figure.suptitle(title, fontsize=10, color=INK)
