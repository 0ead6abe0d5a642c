"""Reports the stopping distances of a vehicle, measured and on paper: a picture, tables and numbers."""

from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from nnql_bullet.colours import DISTINCT, INK, TIMEOUT
from nnql_bullet.fidelity.probe import Bench
from nnql_bullet.fidelity.stopping import REACTION, SafeSpeed, Stop, StopConditions, safe_speeds, sight
from nnql_bullet.provenance import made_by
from nnql_bullet.reports.document import Report, Section, table
from nnql_bullet.reports.drawing import MARKS, OPEN, finish_axes, legend_below, picture
from nnql_bullet.reports.tables import NOT_A_CERTIFICATE, csv_text
from nnql_bullet.vehicle.spec import VehicleSpec


def draw_stopping(bench: Bench, stops: Sequence[Stop], path: Path) -> None:
    """Draws stopping distance with reaction over speed: a panel for each friction, a colour for each payload.

    Args:
        bench: Bench of the measurements.
        stops: Every measured stop.
        path: Path of the PNG file.
    """
    way, speeds = sight(bench.vehicle), safe_speeds(bench.vehicle, stops)
    frictions = sorted({stop.conditions.friction for stop in stops})
    payloads = sorted({stop.conditions.payload for stop in stops})
    fastest = max(stop.speed for stop in stops)
    with picture(path, 7.4, 3.5, {"font.size": 8.5, "axes.linewidth": 0.6}) as figure:
        panels = figure.subplots(1, len(frictions), sharey=True, squeeze=False)[0]
        for axes, friction in zip(panels, frictions, strict=True):
            axes.axhline(way, color=INK, lw=1.0, ls="--", zorder=1)
            for number, payload in enumerate(payloads):
                conditions, colour = StopConditions(payload, friction), DISTINCT[number]
                _draw_stops(axes, [each for each in stops if each.conditions == conditions], colour, MARKS[number])
                safe = next(each for each in speeds if each.conditions == conditions)
                _mark_safe_speed(axes, safe, way, colour, len(payloads) - number)
            axes.text(0.3, way + 0.3, f"sight {way:.2f} m", ha="left", va="bottom", color=INK)
            axes.set(xlim=(0, fastest), ylim=(0, 2.2 * way), xlabel="speed [m/s]")
            finish_axes(axes, f"friction {friction:g}", 9, hidden=OPEN)
            axes.xaxis.set_major_locator(MultipleLocator(2))
            axes.yaxis.set_major_locator(MultipleLocator(5))
        panels[0].set_ylabel(f"way until it stands, with\n{REACTION:g} s of reaction [m]")
        handles = [
            Line2D([], [], color=colour, marker=mark, ms=4, lw=1.2, label=f"{payload:g} kg payload")
            for payload, colour, mark in zip(payloads, DISTINCT, MARKS, strict=False)
        ]
        handles += [
            Line2D([], [], color=TIMEOUT, lw=1.2, label="line: on paper"),
            Line2D([], [], color=TIMEOUT, ls="", marker="o", ms=4, label="mark: measured"),
            Line2D([], [], color=TIMEOUT, lw=0.9, ls=":", label="largest safe speed: measured (paper) [m/s]"),
        ]
        legend_below(figure, 3, handles)


def _draw_stops(axes: Axes, stops: Sequence[Stop], colour: str, mark: str) -> None:
    speeds = np.linspace(0.0, max(stop.speed for stop in stops), 200)
    deceleration = stops[0].speed ** 2 / (2 * stops[0].distance_on_paper)
    axes.plot(speeds, speeds * REACTION + speeds**2 / (2 * deceleration), color=colour, lw=1.2)
    ways = [stop.speed * REACTION + stop.distance for stop in stops]
    axes.plot([stop.speed for stop in stops], ways, ls="", marker=mark, ms=4, color=colour, mec="white", mew=0.5)


def _mark_safe_speed(axes: Axes, safe: SafeSpeed, way: float, colour: str, line: int) -> None:
    """Draws a vertical line at the safe speed, and the speed as text on a line counted from below."""
    words = f"({safe.on_paper:.2f})"
    if safe.measured is not None:
        axes.plot([safe.measured] * 2, [0.0, way], color=colour, lw=0.9, ls=":")
        words = f"{safe.measured:.2f} {words}"
    above = (-2, 11 * line - 7)
    axes.annotate(words, (1.0, 0.0), above, "axes fraction", textcoords="offset points", ha="right", color=colour)


def stop_record(stop: Stop) -> dict[str, float]:
    """Returns a stop under flat names."""
    return {
        "friction": stop.conditions.friction,
        "payload_kg": stop.conditions.payload,
        "speed_m_s": stop.speed,
        "distance_m": stop.distance,
        "distance_on_paper_m": stop.distance_on_paper,
        "heading_drift_deg": degrees(stop.heading_drift),
        "friction_used": stop.friction_used,
        "least_load": stop.least_load,
        "least_load_on_paper": stop.least_load_on_paper,
    }


def safe_speed_record(safe: SafeSpeed) -> dict[str, float | None]:
    """Returns a largest safe speed under flat names."""
    return {
        "friction": safe.conditions.friction,
        "payload_kg": safe.conditions.payload,
        "measured_m_s": safe.measured,
        "on_paper_m_s": safe.on_paper,
        "by_grip_m_s2": safe.braking.by_grip,
        "by_torque_m_s2": safe.braking.by_torque,
    }


def stopping_sentences(vehicle: VehicleSpec, stops: Sequence[Stop]) -> list[str]:
    """Writes a line for each largest speed from which the vehicle stops within the range of its sensors."""
    lines = [f"stops within the {sight(vehicle):.2f} m that it sees ahead of its front edge, from at most:"]
    for safe in safe_speeds(vehicle, stops):
        measured = "more than was measured" if safe.measured is None else f"{safe.measured:.2f} m/s"
        conditions = f"friction {safe.conditions.friction:g}, payload {safe.conditions.payload:g} kg"
        lines.append(f"  {conditions}: {measured} (on paper {safe.on_paper:.2f})")
    return lines


def stopping_csv(stops: Sequence[Stop]) -> str:
    """Returns CSV of every stop in full precision."""
    return csv_text([stop_record(stop) for stop in stops])


def stopping_values(bench: Bench, stops: Sequence[Stop]) -> dict[str, Any]:
    """Returns all stops as plain values, for JSON."""
    return {
        "note": NOT_A_CERTIFICATE,
        "made_by": made_by(),
        "vehicle": bench.vehicle.name,
        "engine": bench.engine,
        "physics": bench.physics,
        "sight_m": sight(bench.vehicle),
        "reaction_s": REACTION,
        "stops": [stop_record(stop) for stop in stops],
        "largest_safe_speeds": [safe_speed_record(each) for each in safe_speeds(bench.vehicle, stops)],
    }


def stopping_markdown(bench: Bench, stops: Sequence[Stop]) -> str:
    """Returns the report as Markdown: all stops, and the speeds from which the vehicle stops within its sight."""
    vehicle = bench.vehicle
    safe_rows = [
        (
            f"{safe.conditions.friction:g}",
            f"{safe.conditions.payload:g}",
            f"{safe.braking.by_grip:.2f}",
            f"{safe.braking.by_torque:.2f}",
            f"{safe.on_paper:.2f}",
            f"over {max(stop.speed for stop in stops):g}" if safe.measured is None else f"{safe.measured:.2f}",
        )
        for safe in safe_speeds(vehicle, stops)
    ]
    stop_rows = [
        (
            f"{stop.conditions.friction:g}",
            f"{stop.conditions.payload:g}",
            f"{stop.speed:g}",
            f"{stop.distance_on_paper:.3f}",
            f"{stop.distance:.3f}",
            f"{100 * (stop.distance / stop.distance_on_paper - 1):+.1f}",
            f"{degrees(stop.heading_drift):.3f}",
            f"{100 * stop.friction_used:.0f}",
            f"{100 * stop.least_load_on_paper:.0f}",
            f"{100 * stop.least_load:.0f}",
        )
        for stop in stops
    ]
    safe_table = table(
        (
            *("friction", "payload [kg]", "braking by grip [m/s²]", "by torque [m/s²]"),
            *("largest safe speed, paper [m/s]", "measured [m/s]"),
        ),
        safe_rows,
        f"It sees {sight(vehicle):.2f} m ahead of its front edge. An obstacle may come into sight just after a "
        f"decision, so {REACTION:g} s pass before it brakes. Measured: interpolated between the measured speeds, where "
        "braking distance over speed is all but linear.",
    )
    stop_table = table(
        (
            *("friction", "payload [kg]", "speed [m/s]", "distance, paper [m]", "distance [m]", "difference [%]"),
            *("heading drift [°]", "friction used [%]", "least load, paper [%]", "least load [%]"),
        ),
        stop_rows,
        "Distances from the command to stop on.",
    )
    lead = (
        NOT_A_CERTIFICATE,
        f"Vehicle '{vehicle.name}' in {bench.engine} ({bench.physics}): the wheels are commanded to stand at once, and "
        "brake with what torque and grip they have.",
    )
    return Report(
        "How the vehicle stops",
        (Section("", lead), Section("Largest safe speed", (safe_table,)), Section("Every stop", (stop_table,))),
    ).markdown()
