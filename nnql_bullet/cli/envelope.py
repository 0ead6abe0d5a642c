"""`nnql-bullet envelope`."""

import json
import os
from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import say
from nnql_bullet.cli.work import run_all
from nnql_bullet.executors import make_executor
from nnql_bullet.fidelity.envelope import Case, Result, envelope_slices, envelope_tasks, measure_turn
from nnql_bullet.fidelity.probe import Bench
from nnql_bullet.fidelity.stopping import measure_stop, safe_speeds, sight, stopping_tasks
from nnql_bullet.files import write_text
from nnql_bullet.reports import envelope as report
from nnql_bullet.reports import stopping
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.vehicle.urdf import load_vehicle


def envelope(
    robot: Annotated[str, tyro.conf.arg(metavar="NAME|FILE", help_behavior_hint="")] = "tricycle",
    sim: Annotated[EngineName, tyro.conf.arg(help_behavior_hint="")] = "bullet",
    physics: Annotated[PhysicsName, tyro.conf.arg(help_behavior_hint="")] = "reference",
    workers: Annotated[int | None, tyro.conf.arg(metavar="W", help_behavior_hint="")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
) -> int:
    """Measure what a vehicle can follow, and how far it runs until it stands.

    Turns over speed, control period, heading change, friction and payload: heading error, slip, least wheel load and
    friction used, with the limits on paper drawn over the measured ones. Stops over speed, friction and payload: the
    largest speed from which the vehicle stops within what its sensors see. Evidence for an engineer, never a
    certificate; the standard that asks this question is ISO 3691-4.

    Leaves envelope.md and stopping.md, and each of them as a picture, CSV and JSON.

    For example:

        nnql-bullet envelope
        nnql-bullet envelope --robot my/robot.toml --out runs/mine

    Args:
        robot: Shipped robot or TOML file; default tricycle.
        sim: Engine of contact physics: bullet, the default, or mujoco.
        physics: Its settings; default reference.
        workers: Processes; default one a core. The result does not depend on it.
        out: Where the report goes; default runs/envelope/ROBOT-ENGINE-PHYSICS.
    """
    vehicle = load_vehicle(robot)
    bench = Bench(vehicle, sim, physics)
    with bench.open_engine():  # an engine that is not there shows here
        pass
    executor = make_executor("processes", workers or os.cpu_count() or 1)
    slices = envelope_slices(vehicle)
    results = run_all(executor, "turns", measure_turn, envelope_tasks(bench, slices))
    stops = run_all(executor, "stops", measure_stop, stopping_tasks(bench))
    folder = out or Path("runs") / "envelope" / f"{vehicle.name}-{sim}-{physics}"
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "envelope.md", report.envelope_markdown(bench, slices, results))
    write_text(folder / "envelope.csv", report.envelope_csv(results))
    write_text(folder / "envelope.json", json.dumps(report.envelope_values(bench, results), indent=1) + "\n")
    report.draw_envelope(bench, slices, results, folder / "envelope.png")
    write_text(folder / "stopping.md", stopping.stopping_markdown(bench, stops))
    write_text(folder / "stopping.csv", stopping.stopping_csv(stops))
    write_text(folder / "stopping.json", json.dumps(stopping.stopping_values(bench, stops), indent=1) + "\n")
    stopping.draw_stopping(bench, stops, folder / "stopping.png")
    base = slices[0].base
    followed = sum(result.measured.follows for result in results)
    agreed = sum(result.measured.follows == result.allowed for result in results)
    say(
        f"turns: {followed} of {len(results)} followed, {agreed} as on paper; the quickest of {base.speed:g} m/s and "
        f"{degrees(base.heading_change):.0f} degrees that is followed takes {_quickest(results, base)}"
    )
    say(f"stops within the {sight(vehicle):.2f} m that it sees ahead of its front edge, from at most:")
    for safe in safe_speeds(vehicle, stops):
        measured = "more than was measured" if safe.measured is None else f"{safe.measured:.2f} m/s"
        conditions = f"friction {safe.conditions.friction:g}, payload {safe.conditions.payload:g} kg"
        say(f"  {conditions}: {measured} (on paper {safe.on_paper:.2f})")
    say(f"reports: {folder / 'envelope.md'}, {folder / 'stopping.md'}")
    return 0


def _quickest(results: Sequence[Result], base: Case) -> str:
    periods = [
        result.case.period
        for result in results
        if result.measured.follows
        and (result.case.speed, result.case.heading_change) == (base.speed, base.heading_change)
        and (result.case.friction, result.case.payload) == (base.friction, base.payload)
    ]
    return f"{min(periods):.1f} s" if periods else "longer than was tried"
