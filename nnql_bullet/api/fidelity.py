"""`check_fidelity` and `envelope`: an engine against mechanics on paper, and the limits of a vehicle."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

from typing_extensions import Unpack

from nnql_bullet.arguments import checked
from nnql_bullet.executors import ExecutorArguments, executor_of
from nnql_bullet.experiment import refuse_speed
from nnql_bullet.fidelity.actions import watch_actions
from nnql_bullet.fidelity.envelope import Result, Slice, envelope_slices, envelope_tasks, measure_turn
from nnql_bullet.fidelity.probe import Bench
from nnql_bullet.fidelity.probes import probes_for, run_probes
from nnql_bullet.fidelity.stopping import Stop, measure_stop, stopping_tasks
from nnql_bullet.files import staged, write_text
from nnql_bullet.locks import locked
from nnql_bullet.reports import envelope as envelope_report
from nnql_bullet.reports import fidelity as report
from nnql_bullet.reports import stopping as stopping_report
from nnql_bullet.reports.fidelity import Fidelity
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.vehicle.controller import own_speed
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.work import OnProgress, Progress, run_all, silent

REFINEMENTS = (1, 2, 4)
"""Divisors of the time step, for the convergence of the five actions."""


@dataclass(frozen=True)
class FidelityResults:
    """Results of `check_fidelity`."""

    fidelity: Fidelity
    """Every measurement with its expectation."""

    @property
    def ok(self) -> bool:
        """Whether every quantity is within its tolerance."""
        return not self.fidelity.out

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A record for each quantity; `pandas.DataFrame(rows)` takes them."""
        return report.fidelity_records(self.fidelity)

    def table(self) -> str:
        """Every quantity: expected, measured, accepted."""
        return report.fidelity_table(self.fidelity)

    def save(self, folder: Path | str) -> None:
        """Writes fidelity.md, fidelity.json and pictures into a folder."""
        with staged(Path(folder), "fidelity.json") as out:
            write_text(out / "fidelity.md", report.fidelity_markdown(self.fidelity))
            write_text(out / "fidelity.json", json.dumps(report.fidelity_values(self.fidelity), indent=1) + "\n")
            report.draw_tolerances(self.fidelity, out / "tolerances.png")
            report.draw_actions(self.fidelity, out / "actions.png")
            report.draw_grip(self.fidelity, out / "grip.png")


@checked
def check_fidelity(
    vehicle: str | Path | VehicleSpec = "tricycle",
    *,
    speed: float | None = None,
    simulator: EngineName = "bullet",
    physics: PhysicsName = "reference",
    out: Path | str | None = None,
    on_progress: OnProgress | None = None,
) -> FidelityResults:
    """Compares the physics of an engine with mechanics on paper, for one vehicle.

    Every expectation follows from the vehicle's own files.

    Example:
        >>> import nnql_bullet as nb
        >>> results = nb.check_fidelity("tricycle", physics="fast")
        >>> results.ok
        True

    Args:
        vehicle: A shipped robot, a TOML file or a `Vehicle`.
        speed: Speed at which it drives [m/s]; by default its own.
        simulator: An engine of contact physics.
        physics: Its solver settings.
        out: Folder for the report; without it nothing is written.
        on_progress: Receives the progress.

    Raises:
        UserError: If the vehicle cannot be read, the engine is not installed, or another process writes to `out`.
    """
    spec, report_to = _at_speed(load_vehicle(vehicle), speed), on_progress or silent
    bench = Bench(spec, simulator, physics)
    with bench.open_engine() as engine:  # an engine that is not installed shows here
        time_step = engine.time_step
    folder = None if out is None else Path(out)
    with locked(folder):
        results = FidelityResults(_measured(bench, time_step, report_to))
        if folder:
            results.save(folder)
    return results


def _at_speed(vehicle: VehicleSpec, speed: float | None) -> VehicleSpec:
    """The vehicle with a speed of its own.

    Raises:
        UserError: If it does not reach it.
    """
    if speed is not None and not 0 < speed <= own_speed(vehicle):
        refuse_speed(vehicle, speed)
    return vehicle.driving_at(speed)


def _measured(bench: Bench, time_step: float, report_to: OnProgress) -> Fidelity:
    """Measures every probe at the time step and at half of it, and the five actions at each of `REFINEMENTS`."""
    total, done = 2 * len(probes_for(bench.vehicle)) + len(REFINEMENTS), count(1)
    measured, halved, actions = [], [], []
    report_to(Progress("probing", 0, total))
    for probe, found in run_probes(bench):
        measured.append((probe, found))
        report_to(Progress("probing", next(done), total, probe.title))
    for probe, found in run_probes(replace(bench, refinement=2)):
        halved.append(found)
        report_to(Progress("probing", next(done), total, f"{probe.title}, half the step"))
    for refinement in REFINEMENTS:
        actions.append((time_step / refinement, watch_actions(replace(bench, refinement=refinement))))
        report_to(Progress("probing", next(done), total, "the five actions"))
    return Fidelity(bench, [(*pair, half) for pair, half in zip(measured, halved, strict=True)], actions)


@dataclass(frozen=True)
class EnvelopeResults:
    """Results of `envelope`."""

    bench: Bench
    slices: Sequence[Slice]
    turns: Sequence[Result]
    """Measured turns."""
    stops: Sequence[Stop]
    """Measured stops."""

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A record for each turn; `pandas.DataFrame(rows)` takes them."""
        return [envelope_report.case_record(result) for result in self.turns]

    @property
    def stop_rows(self) -> list[dict[str, Any]]:
        """A record for each stop."""
        return [dict(stopping_report.stop_record(stop)) for stop in self.stops]

    def table(self) -> str:
        """The turns that were followed, and the largest speeds from which the vehicle stops in time."""
        return "\n".join(
            [
                envelope_report.envelope_sentence(self.slices[0].base, self.turns),
                *stopping_report.stopping_sentences(self.bench.vehicle, self.stops),
            ]
        )

    def save(self, folder: Path | str) -> None:
        """Writes envelope and stopping as .md, .csv, .json and .png into a folder."""
        bench, turns, stops = self.bench, self.turns, self.stops
        with staged(Path(folder), "envelope.json", ("stopping.json",)) as out:
            write_text(out / "envelope.md", envelope_report.envelope_markdown(bench, self.slices, turns))
            write_text(out / "envelope.csv", envelope_report.envelope_csv(turns))
            values = envelope_report.envelope_values(bench, turns)
            write_text(out / "envelope.json", json.dumps(values, indent=1) + "\n")
            envelope_report.draw_envelope(bench, self.slices, turns, out / "envelope.png")
            write_text(out / "stopping.md", stopping_report.stopping_markdown(bench, stops))
            write_text(out / "stopping.csv", stopping_report.stopping_csv(stops))
            values = stopping_report.stopping_values(bench, stops)
            write_text(out / "stopping.json", json.dumps(values, indent=1) + "\n")
            stopping_report.draw_stopping(bench, stops, out / "stopping.png")


@checked
def envelope(
    vehicle: str | Path | VehicleSpec = "tricycle",
    *,
    speed: float | None = None,
    simulator: EngineName = "bullet",
    physics: PhysicsName = "reference",
    out: Path | str | None = None,
    on_progress: OnProgress | None = None,
    **asked: Unpack[ExecutorArguments],
) -> EnvelopeResults:
    """Measures the turns that a vehicle can follow, and the distances in which it stops.

    Args:
        vehicle: A shipped robot, a TOML file or a `Vehicle`.
        speed: Speed at which it drives [m/s]; by default its own.
        simulator: An engine of contact physics.
        physics: Its solver settings.
        out: Folder for the report; without it nothing is written.
        on_progress: Receives the progress.
        **asked: Where measurements run.

    Raises:
        UserError: If the vehicle cannot be read, the engine is not installed, or another process writes to `out`.
        WorkFailed: If a measurement fails.
    """
    spec = _at_speed(load_vehicle(vehicle), speed)
    bench = Bench(spec, simulator, physics)
    with bench.open_engine():  # an engine that is not installed shows here
        pass
    where, slices = executor_of(asked), envelope_slices(spec)
    folder = None if out is None else Path(out)
    with locked(folder):
        turns = run_all(where, "turns", measure_turn, envelope_tasks(bench, slices), on_progress=on_progress)
        stops = run_all(where, "stops", measure_stop, stopping_tasks(bench), on_progress=on_progress)
        results = EnvelopeResults(bench, slices, turns, stops)
        if folder:
            results.save(folder)
    return results
