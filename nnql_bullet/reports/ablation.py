"""Writes an ablation as text and draws it as a picture."""

from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from math import isfinite, isnan
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from nnql_bullet import __version__
from nnql_bullet.colours import BOX, COLLISION, GOAL, INK, SAFE, SHADE, TIMEOUT
from nnql_bullet.config import dotted, merged
from nnql_bullet.evaluation.ablation import Budget, Entry
from nnql_bullet.evaluation.statistics import Estimate, least_seeds
from nnql_bullet.evaluation.studies import Factor, Study
from nnql_bullet.provenance import made_by
from nnql_bullet.reports.document import Picture, Report, Section, table
from nnql_bullet.reports.drawing import OPEN, finish_axes, legend_below, picture
from nnql_bullet.reports.tables import csv_text, finite

COLOURS = {"default": INK, "better": GOAL, "worse": COLLISION, "undecided": TIMEOUT, "exploratory": TIMEOUT}


def ablation_markdown(study: Study, entries: Sequence[Entry], budget: Budget) -> str:
    """Returns the report as Markdown."""
    variants = table(
        ("factor", "section", "variant", *study.tiers.values(), *EVIDENCE),
        [_row(study, entry) for entry in entries],
    )
    lead = (
        f"{about(study, budget)} nnql-bullet {__version__}.",
        how_judged(entries, budget.seeds),
        Picture("ablation.png", "the ablation"),
        variants,
    )
    decisions = "\n".join(f"- {factor.question}: {decision(factor, entries)}" for factor in study.factors)
    not_varied = (f"Not varied: {study.not_varied}.",) if study.not_varied else ()
    return Report(study.title, (Section("", lead), Section("What it decides", (decisions, *not_varied)))).markdown()


TESTED = ("difference", "p_value", "corrected", "detectable")
"""Fields of an entry that are numbers, null in JSON where there is none."""
EVIDENCE = ("difference, points", "p", "p, corrected", "detectable, points", "evidence")
"""What is said of a variant beside its success."""


def how_judged(entries: Sequence[Entry], seeds: int) -> str:
    """Describes the test of a study, and what it could have found."""
    comparisons = sum(entry.verdict != "default" for entry in entries)
    least = least_seeds(comparisons)
    text = (
        "Success is the inter-quartile mean over training seeds. The difference is that of mean success over all kinds "
        "of worlds from the default's, paired by seed; its p is that of the exact sign-flip test over seeds, corrected "
        f"by Holm's method for the {comparisons} comparisons of the study. Intervals are exact 95 % intervals over "
        f"seeds, which need {least_seeds()} of them (Hartigan 1969). "
    )
    if seeds < least:
        return text + (
            f"This study is exploratory: where all {seeds} pairs of trainings agree, p is {2 ** (1 - seeds):.2g}, so "
            f"{comparisons} comparisons need {least} seeds for a verdict. It says neither better nor worse."
        )
    return text + (
        "A variant is better or worse where the corrected p is at most 0.05. Detectable is the true difference that "
        "such a study finds in 80 % of repetitions, given the spread of these differences: a smaller one may well be "
        "there and stay undecided."
    )


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
    if any(entry.verdict == "exploratory" for entry in its):
        return f"{default}; too few seeds for a verdict{stated}"
    if better:
        best = max(better, key=lambda entry: entry.difference.value)
        return f"{best.variant.label} is better than {default} by {_points(best.difference)} points{stated}"
    if undecided:
        return f"{default}; nothing is better, and the evidence does not tell it from {_listed(undecided)}{stated}"
    return f"{default}, and every variant is worse"


def _listed(labels: Sequence[str]) -> str:
    return " or ".join(labels) if len(labels) < 3 else f"{', '.join(labels[:-1])} or {labels[-1]}"


def _points(difference: Estimate) -> str:
    """A difference in points, with its interval if there is one."""
    value, low, high = (f"{100 * number:+.1f}" for number in difference)
    return value if isnan(difference.low) else f"{value} ({low} to {high})"


def _row(study: Study, entry: Entry) -> tuple[object, ...]:
    stated = ", stated" if entry.factor.stated else ""
    tested = (
        _points(entry.difference),
        f"{entry.p_value:.2g}",
        f"{entry.corrected:.2g}",
        f"{100 * entry.detectable:.1f}" if isfinite(entry.detectable) else "none",
    )
    return (
        entry.factor.question,
        f"{entry.factor.section}{stated}",
        entry.variant.label,
        *(entry.success[world] for world in study.tiers),
        *(("",) * len(tested) if entry.verdict == "default" else tested),
        entry.verdict,
    )


def ablation_values(study: Study, entries: Sequence[Entry], budget: Budget) -> dict[str, Any]:
    """Returns the ablation as plain values, for JSON."""
    return {
        "version": __version__,
        "made_by": made_by(),
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
                "success": finite(entry.success),
                "by_seed": entry.by_seed,
                **finite({name: getattr(entry, name) for name in TESTED}),
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
                if not isnan(interval.low):
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
            Line2D([], [], color=colour, marker="D", ms=5, lw=1.8, label=verdict)
            for verdict, colour in COLOURS.items()
            if any(entry.verdict == verdict for entry in entries)
        ]
        handles.append(Line2D([], [], color=BOX, marker="o", ls="", ms=4, label="one training seed"))
        legend_below(figure, 5, handles)
        asked = f"; {study.asked}" if study.asked else ""
        ends = ", 95 % interval" if budget.seeds >= least_seeds() else ""
        title = f"trainings of each: {budget.seeds}; inter-quartile mean{ends}; * the paper states it{asked}"
        figure.suptitle(title, fontsize=10, color=INK)
