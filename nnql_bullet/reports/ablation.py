"""Writes an ablation as text and draws it as a picture."""

from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from nnql_bullet import __version__
from nnql_bullet.colours import BOX, COLLISION, GOAL, INK, SAFE, SHADE, TIMEOUT
from nnql_bullet.config import dotted, merged
from nnql_bullet.evaluation.ablation import Budget, Entry
from nnql_bullet.evaluation.studies import Factor, Study
from nnql_bullet.reports.document import Picture, Report, Section, table
from nnql_bullet.reports.drawing import OPEN, finish_axes, legend_below, picture
from nnql_bullet.reports.tables import csv_text

COLOURS = {"default": INK, "better": GOAL, "worse": COLLISION, "undecided": TIMEOUT}


def ablation_markdown(study: Study, entries: Sequence[Entry], budget: Budget) -> str:
    """Returns the report as Markdown."""
    variants = table(
        ("factor", "section", "variant", *study.tiers.values(), "difference, points", "evidence"),
        [_row(study, entry) for entry in entries],
    )
    lead = (
        f"{about(study, budget)} nnql-bullet {__version__}.",
        "Success is the inter-quartile mean over training seeds with its bootstrap 95 % interval. The difference is "
        "that of success over all kinds of worlds, paired by seed, from the default's; a variant is better or worse "
        "where its 95 % interval leaves zero out. With so many variants, one or two will do so by chance.",
        Picture("ablation.png", "the ablation"),
        variants,
    )
    decisions = "\n".join(f"- {factor.question}: {decision(factor, entries)}" for factor in study.factors)
    not_varied = (f"Not varied: {study.not_varied}.",) if study.not_varied else ()
    return Report(study.title, (Section("", lead), Section("What it decides", (decisions, *not_varied)))).markdown()


def about(study: Study, budget: Budget) -> str:
    """Describes the trainings and drives of a study."""
    asked = f" All of them: {study.asked}." if study.asked else ""
    where = "the kinematic model" if budget.simulator == "kinematic" else f"{budget.simulator} contact physics"
    return (
        f"Each variant departs from the preset `{study.preset}` in one thing: {budget.seeds} trainings of "
        f"{budget.episodes} episodes with {budget.vehicles} vehicles in {where}, each then driven greedily through "
        f"{budget.worlds} validation worlds of each kind.{asked}"
    )


def decision(factor: Factor, entries: Sequence[Entry]) -> str:
    """States in words whether the evidence supports a factor's default."""
    its = [entry for entry in entries if entry.factor is factor]
    (default,) = [entry.variant.label for entry in its if entry.verdict == "default"]
    better = [entry for entry in its if entry.verdict == "better"]
    undecided = [entry.variant.label for entry in its if entry.verdict == "undecided"]
    stated = " (stated by the paper, so it stays)" if factor.stated else ""
    if better:
        best = max(better, key=lambda entry: entry.difference.value)
        return f"{best.variant.label} is better than {default} by {_points(best)} points{stated}"
    if undecided:
        return f"{default}; nothing is better, and the evidence does not tell it from {_listed(undecided)}{stated}"
    return f"{default}, and every variant is worse"


def _listed(labels: Sequence[str]) -> str:
    return " or ".join(labels) if len(labels) < 3 else f"{', '.join(labels[:-1])} or {labels[-1]}"


def _points(entry: Entry) -> str:
    return " to ".join(f"{100 * number:+.1f}" for number in entry.difference[1:])


def _row(study: Study, entry: Entry) -> tuple[object, ...]:
    stated = ", stated" if entry.factor.stated else ""
    return (
        entry.factor.question,
        f"{entry.factor.section}{stated}",
        entry.variant.label,
        *(shown(entry, world) for world in study.tiers),
        "" if entry.verdict == "default" else f"{100 * entry.difference.value:+.1f} ({_points(entry)})",
        entry.verdict,
    )


def shown(entry: Entry, world: str) -> str:
    """Formats success in a tier [%]."""
    interval = entry.success[world]
    return str(interval) if interval else f"{100 * entry.by_seed[world][0]:.1f}"


def ablation_values(study: Study, entries: Sequence[Entry], budget: Budget) -> dict[str, Any]:
    """Returns the ablation as plain values, for JSON."""
    return {
        "version": __version__,
        **asdict(budget),
        "preset": study.preset,
        "tiers": dict(study.tiers),
        "shared": dotted(merged({}, study.base)),
        "entries": [
            {
                "factor": entry.factor.name,
                "question": entry.factor.question,
                "section": entry.factor.section,
                "stated": entry.factor.stated,
                "variant": entry.variant.label,
                "changes": entry.variant.changes,
                "success": {world: interval and list(interval) for world, interval in entry.success.items()},
                "by_seed": entry.by_seed,
                "difference": list(entry.difference),
                "verdict": entry.verdict,
            }
            for entry in entries
        ],
    }


def ablation_csv(entries: Sequence[Entry]) -> str:
    """Returns CSV with a line for each variant, tier and training seed."""
    return csv_text(ablation_records(entries))


def ablation_records(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Returns a flat record for each variant, tier and training seed."""
    return [
        {
            "factor": entry.factor.name,
            "variant": entry.variant.label,
            "verdict": entry.verdict,
            "world": world,
            "seed": seed,
            "success": success,
        }
        for entry in entries
        for world, successes in entry.by_seed.items()
        for seed, success in enumerate(successes)
    ]


def draw_ablation(study: Study, entries: Sequence[Entry], budget: Budget, path: Path) -> None:
    """Draws success of every variant with its interval, factor by factor; dots are training seeds."""
    gaps = np.cumsum([0.0] + [1.6 * (a.factor is not b.factor) for a, b in pairwise(entries)])
    places = -(np.arange(len(entries)) + gaps)
    size = 3.0 + max(2.0 * len(study.tiers), 8.0), 0.23 * float(-places[-1]) + 1.9
    with picture(path, *size) as figure:
        panels = figure.subplots(1, len(study.tiers), sharey=True, squeeze=False)[0]
        for axes, (world, title) in zip(panels, study.tiers.items(), strict=True):
            for place, entry in zip(places.tolist(), entries, strict=True):
                colour = COLOURS[entry.verdict]
                seeds = 100 * np.array(entry.by_seed[world])
                axes.plot(seeds, np.full(len(seeds), place), "o", color=BOX, ms=3.0, mew=0, zorder=2)
                interval = entry.success[world]
                if interval:
                    axes.plot([100 * interval.low, 100 * interval.high], [place] * 2, color=colour, lw=1.8, zorder=3)
                    axes.plot(100 * interval.value, place, "D", color=colour, ms=5, mew=0, zorder=4)
                if entry.verdict == "default":
                    axes.axhspan(place - 0.42, place + 0.42, color=SHADE, lw=0, zorder=0)
            axes.set(xlim=(-2, 102), ylim=(places[-1] - 0.8, 1.6), xlabel="success [%]")
            finish_axes(axes, title, grid="x", hidden=(*OPEN, "left"))
            axes.tick_params(axis="y", length=0)
        panels[0].set_yticks(places, [entry.variant.label for entry in entries], fontsize=8)
        for factor in study.factors:
            first = next(k for k, entry in enumerate(entries) if entry.factor is factor)
            title, x = f"{factor.question}{' *' if factor.stated else ''}", panels[0].get_yaxis_transform()
            panels[0].text(
                -0.02, places[first] + 1.0, title, transform=x, fontsize=9, va="center", ha="right", color=SAFE
            )
        handles = [
            Line2D([], [], color=colour, marker="D", ms=5, lw=1.8, label=verdict) for verdict, colour in COLOURS.items()
        ]
        handles.append(Line2D([], [], color=BOX, marker="o", ls="", ms=4, label="one training seed"))
        legend_below(figure, 5, handles)
        asked = f"; {study.asked}" if study.asked else ""
        title = f"trainings of each: {budget.seeds}; inter-quartile mean, 95 % interval; * the paper states it{asked}"
        figure.suptitle(title, fontsize=10, color=INK)
