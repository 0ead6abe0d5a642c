"""Reports the fidelity of an engine: expected and measured quantities, and the paper's five actions."""

from dataclasses import asdict, dataclass
from math import degrees, isfinite
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from nnql_bullet import __version__
from nnql_bullet.colours import ACTIONS, COLLISION, GOAL, INK, NON_SAFE, REFERENCE, SAFE, TIMEOUT
from nnql_bullet.fidelity.actions import WatchedTurn, tightest
from nnql_bullet.fidelity.probe import Bench, Measurement, Probe
from nnql_bullet.geometry import Array
from nnql_bullet.provenance import made_by
from nnql_bullet.reports.document import Picture, Report, Section, table
from nnql_bullet.reports.drawing import OPEN, POWERS, finish_axes, picture
from nnql_bullet.reports.tables import finite
from nnql_bullet.vehicle.controller import COMMAND_RATE
from nnql_bullet.vehicle.limits import Demand, quasi_steady
from nnql_bullet.vehicle.profiles import sample_turn
from nnql_bullet.vehicle.spec import VehicleSpec


@dataclass(frozen=True)
class Fidelity:
    """Measurements of a vehicle in an engine."""

    bench: Bench
    probes: list[tuple[Probe, list[Measurement], list[Measurement]]]
    """Probes with their measurements at the time step and at half of it."""
    actions: list[tuple[float, list[WatchedTurn]]]
    """The five actions for each time step [s]; the bench's own step is the first."""

    @property
    def time_step(self) -> float:
        """Time step of the bench [s]."""
        return self.actions[0][0]

    @property
    def measurements(self) -> list[Measurement]:
        """Measurements of all probes."""
        return [measurement for _, measured, _ in self.probes for measurement in measured]

    @property
    def out(self) -> list[Measurement]:
        """Measurements out of tolerance."""
        return [measurement for measurement in self.measurements if not measurement.ok]

    @property
    def limits(self) -> list[float]:
        """Gaps of the five actions for a time step of zero, if their error is proportional to the step [m]."""
        (_, coarse), (_, fine) = self.actions[-2:]
        return [2 * after.gap - before.gap for before, after in zip(coarse, fine, strict=True)]

    @property
    def title(self) -> str:
        """Vehicle, engine and settings."""
        return f"{self.bench.vehicle.name} in {self.bench.engine}, {self.bench.physics}"


def number(value: float, measurement: Measurement) -> str:
    """Formats a value with the digits that its tolerance resolves."""
    if not isfinite(value):
        return str(value)
    room = measurement.high - measurement.low
    digits = 2 - int(np.floor(np.log10(room))) if isfinite(room) and room > 0 else 4
    text = f"{value:.{max(0, min(digits, 9))}f}"
    return text if float(text) or not value else f"{value:.1e}"


def tolerance(measurement: Measurement) -> str:
    """Returns the tolerance of a measurement in words."""
    m = measurement
    if m.low == 0.0 and m.expected > 0:
        return f"at most {number(m.high, m)}"
    return f"±{(m.high - m.low) / 2:.2g}"


def fidelity_markdown(fidelity: Fidelity) -> str:
    """Returns the report as Markdown."""
    f, count, turns = fidelity, len(fidelity.measurements), fidelity.actions[0][1]
    verdict = "all within tolerance" if not f.out else f"{len(f.out)} out of tolerance"
    limits = ("in the limit", *(f"{1e3 * gap:.2f} mm" for gap in f.limits))
    lead = (
        f"{count} quantities of {len(f.probes)} probes, {verdict}. The time step is 1/{1 / f.time_step:.0f} s; the "
        "last column is what comes out at half of it. What is expected follows from the vehicle's files alone. "
        f"nnql-bullet {__version__}.",
        Picture("tolerances.png", "how much of each tolerance is used"),
        table(
            ("probe", "quantity", "expected", "measured", "accepted", "verdict", "at half the step"),
            [row for probe in f.probes for row in _measured_rows(*probe)],
        ),
    )
    sources = table(
        ("probe", "closed form", "source"),
        [(probe.title, probe.closed_form, probe.source) for probe, _, _ in f.probes],
    )
    actions = (
        "Against the unicycle that follows the same yaw-rate profile without slip or lag. What an engine adds by its "
        "time step halves with the step; what is left in the limit is slip: the wheel controllers take each of the "
        f"{COMMAND_RATE:.0f} commands a second at a stroke, and a wheel that is asked for more than its grip slides.",
        Picture("actions.png", "paths, and distance from the ideal"),
        table(
            ("time step [s]", *map(_name, turns)),
            [*((f"1/{1 / step:.0f}", *(f"{1e3 * t.gap:.2f} mm" for t in ts)) for step, ts in f.actions), limits],
            note="Distance: root mean square over the turn. The limit is Richardson's, from the last two steps.",
        ),
    )
    grip = (
        Picture("grip.png", "grip used, and load on each wheel through the tightest turn"),
        table(
            ("action", "most grip used by a drive wheel", "most by both together", "least load on a drive wheel [N]"),
            [_grip_row(turn, f.bench.vehicle) for turn in turns],
        ),
    )
    return Report(
        f"Fidelity: {f.title}",
        (
            Section("", lead),
            Section("Where the expectations come from", (sources,)),
            Section("The five actions", actions),
            Section("Grip used and wheel loads", grip),
        ),
    ).markdown()


def _measured_rows(probe: Probe, measured: list[Measurement], halved: list[Measurement]) -> list[tuple[str, ...]]:
    finer = {m.quantity: m for m in halved}
    return [
        (
            probe.title,
            f"{m.quantity} [{m.unit}]" if m.unit else m.quantity,
            number(m.expected, m),
            number(m.measured, m),
            tolerance(m),
            "ok" if m.ok else "**out**",
            number(finer[m.quantity].measured, m) if m.quantity in finer else "",
        )
        for m in measured
    ]


def fidelity_records(fidelity: Fidelity) -> list[dict[str, Any]]:
    """Returns a flat record for each quantity."""
    return [{"probe": probe.name, **_plain(m)} for probe, measured, _ in fidelity.probes for m in measured]


def fidelity_table(fidelity: Fidelity) -> str:
    """Writes a table of every quantity: expected, measured, accepted; probe by probe."""
    rows = [("quantity", "unit", "expected", "measured", "accepted", "")]
    for probe, measured, _ in fidelity.probes:
        rows.append((probe.title, "", "", "", "", ""))
        for m in measured:
            expected, found = number(m.expected, m), number(m.measured, m)
            rows.append((f"  {m.quantity}", m.unit, expected, found, tolerance(m), "ok" if m.ok else "OUT"))
    widths = [max(len(row[column]) for row in rows if row[1] or row[2]) for column in range(6)]
    lines = [
        f"{quantity:<{widths[0]}}  {unit:<{widths[1]}}  {expected:>{widths[2]}}  {found:>{widths[3]}}  "
        f"{accepted:<{widths[4]}}  {verdict}".rstrip()
        for quantity, unit, expected, found, accepted, verdict in rows
    ]
    count = len(fidelity.measurements)
    return "\n".join([*lines, f"{fidelity.title}: {count - len(fidelity.out)} of {count} quantities within tolerance"])


def fidelity_values(fidelity: Fidelity) -> dict[str, Any]:
    """Returns the report as plain values, for JSON."""
    f = fidelity
    return {
        "version": __version__,
        "made_by": made_by(),
        "vehicle": f.bench.vehicle.name,
        "engine": f.bench.engine,
        "physics": f.bench.physics,
        "time_step": f.time_step,
        "ok": not f.out,
        "probes": [
            {
                "name": probe.name,
                "title": probe.title,
                "closed_form": probe.closed_form,
                "source": probe.source,
                "measurements": [_plain(m) for m in measured],
                "at_half_the_step": [_plain(m) for m in halved],
            }
            for probe, measured, halved in f.probes
        ],
        "actions": [
            {
                "time_step": step,
                "turns": [{"heading_change_degrees": degrees(t.heading_change), "gap": t.gap} for t in turns],
            }
            for step, turns in f.actions
        ],
    }


def draw_tolerances(fidelity: Fidelity, path: Path) -> None:
    """Draws the share of tolerance that the worst quantity of each probe uses, at the time step and at half of it."""
    rows = fidelity.probes
    with picture(path, 9.0, 0.3 * len(rows) + 1.3, POWERS) as figure:
        axes = figure.add_subplot()
        floor, labels = 1e-4, []
        for place, (probe, measured, halved) in enumerate(rows):
            worst = max(measured, key=share_used)
            half = {m.quantity: m for m in halved}.get(worst.quantity)
            used = max(share_used(worst), floor)
            axes.plot([floor, used], [place, place], color=REFERENCE, lw=1.4, zorder=1)
            axes.plot(used, place, "o", color=GOAL if worst.ok else COLLISION, ms=6, zorder=3, clip_on=False)
            if half:
                axes.plot(max(share_used(half), floor), place, "o", mfc="white", mec=INK, ms=5, zorder=4, clip_on=False)
            labels.append(f"{probe.name}: {worst.quantity}")
        axes.axvline(1.0, color=COLLISION, lw=1.2)
        axes.set_yticks(range(len(rows)), labels, fontsize=9)
        axes.set(xscale="log", xlim=(floor, None), ylim=(len(rows) - 0.4, -0.6))
        axes.set_xlabel("share of the tolerance used (full: at the time step; open: at half of it)")
        finish_axes(axes, f"{fidelity.title}: the worst quantity of each probe", 11, grid="x", hidden=OPEN)


def draw_actions(fidelity: Fidelity, path: Path) -> None:
    """Draws ideal and measured paths of the five actions, their distance, and the effect of the time step on it."""
    with picture(path, 11.0, 4.2) as figure:
        paths, gaps, steps = figure.subplots(1, 3, width_ratios=(1.0, 1.15, 0.9))
        step, turns = fidelity.actions[0]
        for turn, colour in zip(turns, ACTIONS, strict=True):
            label = _name(turn)
            paths.plot(*turn.ideal.T, color=REFERENCE, lw=5.0, solid_capstyle="round", zorder=1)
            paths.plot(*turn.path.T, color=colour, lw=1.4, label=label, zorder=2)
            gaps.plot(turn.times, 1e3 * np.hypot(*(turn.path - turn.ideal).T), color=colour, lw=1.4, label=label)
        paths.set(xlabel="ahead [m]", ylabel="to the left [m]", aspect="equal")
        finish_axes(paths, "paths; grey: ideal")
        paths.legend(frameon=False, fontsize=8, loc="upper left")
        gaps.set(xlabel="time [s]", ylabel="distance from the ideal [mm]", xlim=(0, None), ylim=(0, None))
        finish_axes(gaps, f"distance from the ideal, step 1/{1 / step:.0f} s")
        sizes = np.array([s for s, _ in fidelity.actions])
        for i, colour in enumerate(ACTIONS):
            distances = [1e3 * watched[i].gap for _, watched in fidelity.actions]
            steps.plot(1e3 * sizes, distances, "o-", color=colour, lw=1.2, ms=4)
        steps.set(xlabel="time step [ms]", ylabel="RMS distance from the ideal [mm]", xlim=(0, None), ylim=(0, None))
        finish_axes(steps, "what the time step does to that")


def draw_grip(fidelity: Fidelity, path: Path) -> None:
    """Draws the share of the friction circle that the drive wheels use, and the wheel loads in the tightest turn."""
    with picture(path, 11.0, 4.2) as figure:
        used, loads = figure.subplots(1, 2)
        vehicle, turns = fidelity.bench.vehicle, fidelity.actions[0][1]
        for turn, colour in zip(turns, ACTIONS, strict=True):
            times, label = turn.forces.times, _name(turn)
            used.plot(times, 100 * turn.forces.used_by_axle(vehicle), color=colour, lw=1.6, label=label)
            used.plot(times, 100 * turn.forces.used(vehicle).max(axis=1), color=colour, lw=0.8, ls=":")
        most = tightest(turns)
        needed = 100 * _on_paper(most, vehicle).friction / vehicle.contact.wheel_friction
        used.plot(most.forces.times, needed, color=TIMEOUT, lw=1.4, ls="--", label=f"{_name(most)}, on paper")
        used.axhline(100, color=COLLISION, lw=1.2)
        used.text(0.01, 101, "slides", color=COLLISION, fontsize=8, va="bottom")
        used.set(xlabel="time [s]", ylabel="friction circle used [%]", xlim=(0, None), ylim=(0, 112))
        finish_axes(used, "both drive wheels together; dotted: the one that uses more")
        used.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.02, 0.03))
        _draw_loads(loads, most, vehicle)


def _draw_loads(axes: Axes, turn: WatchedTurn, vehicle: VehicleSpec) -> None:
    times, paper = turn.forces.times, _on_paper(turn, vehicle).loads
    for wheel, (name, colour) in enumerate((("left", SAFE), ("right", NON_SAFE), ("caster", GOAL))):
        axes.plot(times, turn.forces.normal[:, wheel], color=colour, lw=1.5, label=name)
        axes.plot(times, paper[:, wheel], color=colour, lw=1.2, ls=":")
    axes.set(xlabel="time [s]", ylabel="load [N]", xlim=(0, times[-1]), ylim=(0, None))
    finish_axes(axes, f"wheel loads, {_name(turn)}; dotted: on paper")
    axes.legend(frameon=False, fontsize=8, ncols=3)


def _on_paper(turn: WatchedTurn, vehicle: VehicleSpec) -> Demand:
    """Computes the demand of a turn on paper, at the end of each wheel command."""
    times, shape = turn.forces.times, turn.turn
    speed = float(np.hypot(*turn.ideal[0]) / turn.times[0])
    rates, _ = sample_turn(shape, times)
    ends = np.cumsum([shape.rise, shape.hold, shape.fall])
    slopes = np.array([shape.peak / shape.rise, 0.0, -shape.peak / shape.fall, 0.0])
    accelerations: Array = slopes[np.searchsorted(ends, times - 1e-9)]
    return quasi_steady(vehicle, speed, rates, accelerations)


def _name(turn: WatchedTurn) -> str:
    return f"{degrees(turn.heading_change):+.0f} degrees" if turn.heading_change else "straight"


def _grip_row(turn: WatchedTurn, vehicle: VehicleSpec) -> tuple[str, ...]:
    forces = turn.forces
    wheel, axle = float(forces.used(vehicle).max()), float(forces.used_by_axle(vehicle).max())
    return _name(turn), f"{wheel:.0%}", f"{axle:.0%}", f"{float(forces.normal[:, :2].min()):.0f}"


def share_used(m: Measurement) -> float:
    """Computes the share of its tolerance that a measurement uses; 1 is the limit."""
    if not isfinite(m.measured):
        return 1e3
    off = m.measured - m.expected
    if m.low == 0.0 and m.expected > 0:  # a range from 0 to a limit
        return m.measured / m.high
    room = m.high - m.expected if off >= 0 else m.expected - m.low
    return abs(off) / room if room > 0 else (0.0 if off == 0 else 1e3)


def _plain(m: Measurement) -> dict[str, Any]:
    return {**finite(asdict(m)), "ok": m.ok}
