"""Reports the turns that a vehicle can follow, measured and on paper: a picture, tables and numbers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter

from nnql_bullet.colours import DISTINCT, HATCH_DARK, HATCH_LIGHT, INK
from nnql_bullet.fidelity.envelope import (
    HEADING_TOLERANCE,
    HEADINGS,
    SLIP_TOLERANCE,
    Case,
    Followed,
    Quantity,
    Result,
    Slice,
    base_case,
    on_paper,
)
from nnql_bullet.fidelity.probe import Bench
from nnql_bullet.geometry import Array
from nnql_bullet.provenance import made_by
from nnql_bullet.reports.document import Report, Section, Table, table
from nnql_bullet.reports.drawing import legend_below, picture
from nnql_bullet.reports.tables import NOT_A_CERTIFICATE, csv_text
from nnql_bullet.vehicle.limits import (
    braking,
    grip_acceleration,
    static_rear_load,
    tip_acceleration,
    tip_angle,
    turn_demand,
)
from nnql_bullet.vehicle.profiles import plan_turn
from nnql_bullet.vehicle.spec import VehicleSpec

OWN_LIMITS = DISTINCT[-1]
PAPER_GRID = 40
"""Number of points along each axis at which the limits on paper are computed."""


@dataclass(frozen=True, slots=True)
class _Axis:
    """Name, unit and scale of a quantity."""

    name: str
    unit: str
    shown: Callable[[float], float] = float

    @property
    def label(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


_AXES: dict[Quantity, _Axis] = {
    "speed": _Axis("speed", "m/s"),
    "heading_change": _Axis("heading change", "°", degrees),
    "friction": _Axis("friction coefficient", ""),
    "payload": _Axis("payload", "kg"),
}


@dataclass(frozen=True, slots=True)
class _Measure:
    """Colours of a measure; worse values are brighter."""

    label: str
    value: Callable[[Followed], float]
    norm: Normalize
    colours: str
    ticks: tuple[float, ...]


def _measures() -> tuple[_Measure, ...]:
    percent, ticks = Normalize(0.0, 100.0, clip=True), (0.0, 50.0, 100.0)
    return (
        _Measure(
            "heading error [°]",
            lambda m: max(abs(degrees(m.heading_error)), 0.01),
            LogNorm(0.01, 30.0, clip=True),
            "viridis",
            (0.01, 0.1, 1.0, 10.0),
        ),
        _Measure(
            "slip [% of speed]", lambda m: 100 * m.slip, LogNorm(0.2, 50.0, clip=True), "viridis", (0.2, 1.0, 5.0, 50.0)
        ),
        _Measure("rear load [% of rest]", lambda m: 100 * m.least_load, percent, "viridis_r", ticks),
        _Measure("tip margin [%]", lambda m: 100 * m.tip_margin, percent, "viridis_r", ticks),
        _Measure("friction used [%]", lambda m: 100 * m.friction_used, percent, "viridis", ticks),
    )


_STYLES = {"friction": "-", "torque": "--", "lift": ":"}


def draw_envelope(bench: Bench, slices: Sequence[Slice], results: Sequence[Result], path: Path) -> None:
    """Draws a heat map for each slice (rows) and each measure (columns), with the limits on paper over it.

    Args:
        bench: Bench of the measurements.
        slices: Slices through the cases.
        results: Results of every case of the slices.
        path: Path of the PNG file.
    """
    vehicle, found, measures = bench.vehicle, {result.case: result for result in results}, _measures()
    with picture(
        path, 8.6, 2.15 * len(slices) + 1.5, {"font.size": 8.5, "hatch.linewidth": 0.5, "axes.linewidth": 0.6}
    ) as figure:
        panels = figure.subplots(len(slices), len(measures), squeeze=False, sharex="col")
        for row, part in zip(panels, slices, strict=True):
            limits = _paper_limits(vehicle, part)
            meshes = [_draw_map(axes, part, found, measure) for axes, measure in zip(row, measures, strict=True)]
            for axes in row:
                _draw_paper_limits(axes, limits)
                _mark_own_turn(axes, vehicle, part)
                axes.tick_params(labelleft=bool(axes is row[0]))
            row[0].set_ylabel(_AXES[part.quantity].label)
            if part is slices[0]:
                for axes, mesh, measure in zip(row, meshes, measures, strict=True):
                    _add_colour_bar(figure, axes, mesh, measure)
        for axes in panels[-1]:
            axes.set_xlabel("control period [s]")
        legend_below(figure, 2, _envelope_legend())
        figure.suptitle(_described(bench, slices[0].base), fontsize=9, color=INK)


def _add_colour_bar(figure: Figure, axes: Axes, mesh: QuadMesh, measure: _Measure) -> None:
    bar = figure.colorbar(mesh, ax=axes, location="top", ticks=measure.ticks, pad=0.03, aspect=14)
    bar.set_label(measure.label)
    bar.ax.minorticks_off()
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))


def _draw_map(axes: Axes, part: Slice, found: Mapping[Case, Result], measure: _Measure) -> QuadMesh:
    shown = _AXES[part.quantity].shown
    across, up = _edges(part.periods), _edges([shown(value) for value in part.values])
    rows = [[found[part.case(value, period)].measured for period in part.periods] for value in part.values]
    colours = np.array([[measure.value(measured) for measured in row] for row in rows])
    mesh = axes.pcolormesh(across, up, colours, norm=measure.norm, cmap=measure.colours)
    for i, row in enumerate(rows):
        for j, measured in enumerate(row):
            if not measured.follows:
                size = across[j + 1] - across[j], up[i + 1] - up[i]
                ink = HATCH_DARK if np.mean(mesh.to_rgba(colours[i, j])[:3]) > 0.40 else HATCH_LIGHT
                axes.add_patch(Rectangle((across[j], up[i]), *size, fill=False, hatch="/////", ec=ink, lw=0.0))
    axes.set_xticks([period for period in part.periods if round(10 * period) % 3 == 0])
    return mesh


def _paper_limits(vehicle: VehicleSpec, part: Slice) -> tuple[Array, Array, dict[str, Array]]:
    """Computes periods, values, and the share of each limit that is used on paper; 1 is the limit."""
    ends = _edges(part.periods)
    periods = np.linspace(ends[0], ends[-1], PAPER_GRID)
    shown = _AXES[part.quantity].shown
    ends = _edges(part.values)
    values = np.linspace(max(ends[0], 0.0), ends[-1], PAPER_GRID)
    used: dict[str, list[list[float]]] = {name: [] for name in _STYLES}
    for value in values:
        cases = [part.case(float(value), float(period)) for period in periods]
        asked = [on_paper(vehicle, case) for case in cases]
        used["friction"].append([each.friction / case.friction for each, case in zip(asked, cases, strict=True)])
        used["torque"].append([each.torque / vehicle.wheel_torque for each in asked])
        used["lift"].append([1 - each.least_load for each in asked])
    return periods, np.array([shown(float(value)) for value in values]), {k: np.array(v) for k, v in used.items()}


def _draw_paper_limits(axes: Axes, limits: tuple[Array, Array, dict[str, Array]]) -> None:
    periods, values, used = limits
    for name, grid in used.items():
        if grid.min() < 1 < grid.max():
            lines = axes.contour(
                periods, values, grid, levels=[1.0], colors="white", linestyles=_STYLES[name], linewidths=1.6
            )
            lines.set_path_effects([withStroke(linewidth=3.2, foreground="black")])


def _mark_own_turn(axes: Axes, vehicle: VehicleSpec, part: Slice) -> None:
    """Marks the turn of the base case within the vehicle's own limits."""
    value = _AXES[part.quantity].shown(getattr(part.base, part.quantity))
    own = plan_turn(0.0, part.base.heading_change, vehicle.limits).duration
    axes.plot(own, value, "*", ms=10, mfc=OWN_LIMITS, mec="black", mew=0.8, zorder=5)


def _envelope_legend() -> list[Any]:
    halo = [withStroke(linewidth=3.2, foreground="black")]
    names = {"friction": "needs all friction", "torque": "needs all torque", "lift": "inner wheel lifts"}
    lines = [
        Line2D([], [], color="white", ls=_STYLES[name], lw=1.6, path_effects=halo, label=f"{text}, on paper")
        for name, text in names.items()
    ]
    missed = f"off by over {degrees(HEADING_TOLERANCE):g}°, slips over {SLIP_TOLERANCE:.0%}, or lifts a wheel"
    return [
        *lines,
        Line2D([], [], ls="", marker="*", ms=10, mfc=OWN_LIMITS, mec="black", label="the vehicle's own limits"),
        Patch(fc="white", ec=HATCH_DARK, hatch="/////", lw=0.5, label=f"not followed: {missed}"),
    ]


def case_record(result: Result) -> dict[str, float | bool]:
    """Returns a case under flat names, with angles in degrees."""
    case, measured, paper = result.case, result.measured, result.on_paper
    return {
        "speed_m_s": case.speed,
        "period_s": case.period,
        "heading_change_deg": degrees(case.heading_change),
        "friction": case.friction,
        "payload_kg": case.payload,
        "follows": measured.follows,
        "allowed_on_paper": result.allowed,
        "heading_error_deg": degrees(measured.heading_error),
        "slip": measured.slip,
        "least_load": measured.least_load,
        "tip_margin": measured.tip_margin,
        "least_load_on_paper": paper.least_load,
        "friction_used": measured.friction_used,
        "wheel_friction_used": measured.wheel_friction_used,
        "friction_asked_on_paper": paper.friction / case.friction,
        "torque_on_paper_n_m": paper.torque,
        "torque_limit_n_m": result.torque_limit,
        "lateral_on_paper_m_s2": paper.lateral,
        "roll_deg": degrees(measured.roll),
        "fell_over": measured.fell_over,
    }


def envelope_sentence(base: Case, results: Sequence[Result]) -> str:
    """States the number of turns that the vehicle followed, and the quickest one of the base case."""
    followed = sum(result.measured.follows for result in results)
    agreed = sum(result.measured.follows == result.allowed for result in results)
    periods = [
        result.case.period
        for result in results
        if result.measured.follows
        and (result.case.speed, result.case.heading_change) == (base.speed, base.heading_change)
        and (result.case.friction, result.case.payload) == (base.friction, base.payload)
    ]
    quickest = f"{min(periods):.1f} s" if periods else "longer than was tried"
    return (
        f"turns: {followed} of {len(results)} followed, {agreed} as on paper; the quickest of {base.speed:g} m/s and "
        f"{degrees(base.heading_change):.0f} degrees that is followed takes {quickest}"
    )


def envelope_csv(results: Sequence[Result]) -> str:
    """Returns CSV of every case in full precision."""
    return csv_text([case_record(result) for result in results])


def envelope_values(bench: Bench, results: Sequence[Result]) -> dict[str, Any]:
    """Returns all cases as plain values, for JSON."""
    return {
        "note": NOT_A_CERTIFICATE,
        "made_by": made_by(),
        "vehicle": bench.vehicle.name,
        "engine": bench.engine,
        "physics": bench.physics,
        "cases": [case_record(result) for result in results],
    }


def envelope_markdown(bench: Bench, slices: Sequence[Slice], results: Sequence[Result]) -> str:
    """Returns the report as Markdown: limits on paper, shortest periods, and every case.

    Args:
        bench: Bench of the measurements.
        slices: Slices through the cases.
        results: Results of every case of the slices.
    """
    found = {result.case: result for result in results}
    lead = (
        NOT_A_CERTIFICATE,
        f"{_described(bench, slices[0].base)} "
        "Each turn goes from straight to straight in one control period: its yaw rate rises for a third of it, holds "
        "for a third and falls for a third. Each turns left from headings of "
        f"{', '.join(f'{degrees(heading):.0f}°' for heading in HEADINGS)}, since friction that has fixed axes grips "
        "differently from heading to heading; the worst is what counts.",
        f"A turn is followed if the heading ends within {degrees(HEADING_TOLERANCE):g}° of the command, no drive "
        f"wheel's contact point moves over the ground at more than {SLIP_TOLERANCE:.0%} of the speed, and no rear "
        "wheel lifts.",
        _vehicle_table(bench.vehicle),
    )
    about_cases = (
        "Friction and torque on paper are over what there is; loads are over the load at rest. The tip margin is 1 "
        "less the load transfer ratio of the drive wheels: at 0 one lifts. Friction used is of both drive wheels "
        "together. Forces are means over a look of the controller, 1/30 s. A rigid axle leaves open "
        "how its wheels share the side force, and an engine may have them push against each other: friction used is "
        "then more than paper asks for."
    )
    compared = (_agreement_table(results), *(_shortest_table(part, found) for part in slices))
    return Report(
        "What the vehicle can follow",
        (
            Section("", lead),
            Section("Measured against paper", compared),
            Section("Every case", (about_cases,)),
            *(_cases_section(part, found) for part in slices),
        ),
    ).markdown()


def _vehicle_table(vehicle: VehicleSpec) -> Table:
    base = base_case(vehicle)
    turn = plan_turn(0.0, base.heading_change, vehicle.limits)
    asked, brakes = turn_demand(vehicle, base.speed, turn), braking(vehicle)
    rows = [
        ("load at rest on each drive wheel", f"{static_rear_load(vehicle):.0f} N"),
        ("lateral acceleration at which the inner wheel lifts", f"{tip_acceleration(vehicle):.2f} m/s²"),
        ("side slope on which a wheel lifts", f"{degrees(tip_angle(vehicle)):.1f}°"),
        ("lateral acceleration of a steady turn that uses all grip", f"{grip_acceleration(vehicle):.2f} m/s²"),
        ("braking by grip / by torque", f"{brakes.by_grip:.2f} / {brakes.by_torque:.2f} m/s²"),
        (
            f"its own {degrees(base.heading_change):.0f}° turn at {base.speed:g} m/s lasts {turn.duration:.2f} s",
            f"friction {asked.friction:.2f} of {base.friction:g}, torque {asked.torque:.1f} of "
            f"{vehicle.wheel_torque:g} N m, least rear load {asked.least_load:.0%}",
        ),
    ]
    return table(("on paper", "value"), rows)


def _agreement_table(results: Sequence[Result]) -> Table:
    counted = {
        (followed, allowed): sum(r.measured.follows == followed and r.allowed == allowed for r in results)
        for followed in (True, False)
        for allowed in (True, False)
    }
    return table(
        ("cases", "allowed on paper", "not allowed on paper"),
        [
            ("follows", counted[True, True], counted[True, False]),
            ("does not follow", counted[False, True], counted[False, False]),
        ],
    )


def _shortest_table(part: Slice, found: Mapping[Case, Result]) -> Table:
    """Finds for each value the shortest period for which the vehicle follows the turn, also in all longer ones."""
    axis = _AXES[part.quantity]

    def shortest(value: float, good: Callable[[Result], bool]) -> str:
        kept = None
        for period in sorted(part.periods, reverse=True):
            if not good(found[part.case(value, period)]):
                break
            kept = period
        return f"over {max(part.periods):g}" if kept is None else f"{kept:g}"

    header = (axis.label, *(f"{axis.shown(value):.4g}" for value in part.values))
    measured = ("shortest period followed [s]", *(shortest(v, lambda r: r.measured.follows) for v in part.values))
    paper = ("on paper [s]", *(shortest(v, lambda r: r.allowed) for v in part.values))
    return table(header, [measured, paper])


def _cases_section(part: Slice, found: Mapping[Case, Result]) -> Section:
    axis = _AXES[part.quantity]
    header = (
        *(axis.label, "period [s]", "friction asked, paper [%]", "friction used [%]", "torque asked, paper [%]"),
        *("least load, paper [%]", "least load [%]", "tip margin [%]", "heading error [°]", "slip [%]", "roll [°]"),
        "follows",
    )
    rows = []
    for case in part.cases:
        result = found[case]
        measured, paper = result.measured, result.on_paper
        rows.append(
            (
                f"{axis.shown(getattr(case, part.quantity)):.4g}",
                f"{case.period:g}",
                f"{100 * paper.friction / case.friction:.0f}",
                f"{100 * measured.friction_used:.0f}",
                f"{100 * paper.torque / result.torque_limit:.0f}",
                f"{100 * paper.least_load:.0f}",
                f"{100 * measured.least_load:.0f}",
                f"{100 * measured.tip_margin:.0f}",
                f"{degrees(measured.heading_error):.3f}",
                f"{100 * measured.slip:.2f}",
                f"{degrees(measured.roll):.2f}",
                "fell over" if measured.fell_over else "yes" if measured.follows else "no",
            )
        )
    return Section(axis.name.capitalize(), (table(header, rows),), level=3)


def _described(bench: Bench, base: Case) -> str:
    return (
        f"Vehicle '{bench.vehicle.name}' in {bench.engine} ({bench.physics}). Unless an axis says otherwise: "
        f"{base.speed:g} m/s, {degrees(base.heading_change):.0f}°, friction {base.friction:g}, "
        f"{base.payload:g} kg payload."
    )


def _edges(middles: Sequence[float]) -> Array:
    """Computes the edges of cells from their middles."""
    centres = np.asarray(middles, dtype=float)
    between = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[2 * centres[0] - between[0]], between, [2 * centres[-1] - between[-1]]])
