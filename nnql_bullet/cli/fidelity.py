"""`nnql-bullet fidelity`."""

import json
from itertools import count
from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import progress, say
from nnql_bullet.fidelity.actions import watch_actions
from nnql_bullet.fidelity.probe import Bench
from nnql_bullet.fidelity.probes import PROBES, run_probes
from nnql_bullet.files import write_text
from nnql_bullet.reports import fidelity as report
from nnql_bullet.reports.fidelity import Fidelity
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.vehicle.urdf import load_vehicle

REFINEMENTS = (1, 2, 4)
"""Of the time step, for the convergence of the five actions."""


def fidelity(
    robot: Annotated[str, tyro.conf.arg(metavar="NAME|FILE", help_behavior_hint="")] = "tricycle",
    sim: Annotated[EngineName, tyro.conf.arg(help_behavior_hint="")] = "bullet",
    physics: Annotated[PhysicsName, tyro.conf.arg(help_behavior_hint="")] = "reference",
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
) -> int:
    """Hold an engine's physics against mechanics on paper. Exits 1 if a quantity is out of tolerance.

    Every expectation follows from the vehicle's own URDF and TOML, so it works on yours too. Prints a table, and leaves
    fidelity.md, fidelity.json and pictures: how much of each tolerance is used, at the time step and at half of it; the
    five actions, ideal against contact; grip used, and the load on each wheel through the tightest turn.

    For example:

        nnql-bullet fidelity
        nnql-bullet fidelity --physics fast
        nnql-bullet fidelity --robot my/robot.toml --sim mujoco

    Args:
        robot: Shipped robot or TOML file; default tricycle.
        sim: Engine of contact physics: bullet, the default, or mujoco.
        physics: Its settings; default reference.
        out: Where the report goes; default runs/fidelity/ROBOT-ENGINE-PHYSICS.
    """
    vehicle = load_vehicle(robot)
    bench = Bench(vehicle, sim, physics)
    with bench.open_engine() as engine:  # an engine that is not there shows here
        time_step = engine.time_step
    measured, halved, actions = [], [], []
    done = count(1)
    with progress("probing", 2 * len(PROBES) + len(REFINEMENTS)) as show:
        for probe, found in run_probes(bench):
            measured.append((probe, found))
            show(next(done), probe.title)
        for probe, found in run_probes(Bench(vehicle, sim, physics, 2)):
            halved.append(found)
            show(next(done), f"{probe.title}, half the step")
        for refinement in REFINEMENTS:
            actions.append((time_step / refinement, watch_actions(Bench(vehicle, sim, physics, refinement))))
            show(next(done), "the five actions")
    result = Fidelity(bench, [(*pair, half) for pair, half in zip(measured, halved, strict=True)], actions)
    folder = out or Path("runs") / "fidelity" / f"{vehicle.name}-{sim}-{physics}"
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "fidelity.md", report.fidelity_markdown(result))
    write_text(folder / "fidelity.json", json.dumps(report.fidelity_values(result), indent=1) + "\n")
    report.draw_tolerances(result, folder / "tolerances.png")
    report.draw_actions(result, folder / "actions.png")
    report.draw_grip(result, folder / "grip.png")
    _print(result)
    say(f"report: {folder / 'fidelity.md'}")
    return 1 if result.out else 0


def _print(result: Fidelity) -> None:
    rows = [("quantity", "unit", "expected", "measured", "accepted", "")]
    for probe, measured, _ in result.probes:
        rows.append((probe.title, "", "", "", "", ""))
        for m in measured:
            expected, found = report.number(m.expected, m), report.number(m.measured, m)
            rows.append((f"  {m.quantity}", m.unit, expected, found, report.tolerance(m), "ok" if m.ok else "OUT"))
    widths = [max(len(row[column]) for row in rows if row[1] or row[2]) for column in range(6)]
    for row in rows:
        quantity, unit, expected, found, accepted, verdict = row
        say(
            f"{quantity:<{widths[0]}}  {unit:<{widths[1]}}  {expected:>{widths[2]}}  {found:>{widths[3]}}  "
            f"{accepted:<{widths[4]}}  {verdict}".rstrip()
        )
    count = len(result.measurements)
    say(f"{result.title}: {count - len(result.out)} of {count} quantities within tolerance")
