"""`nnql-bullet ledger`."""

import json
import os
from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import complain, say
from nnql_bullet.cli.work import run_kept
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.ledger import CHOICES, Budget, Choice, Counts, entries, task_of, train_and_test
from nnql_bullet.evaluation.parts import Parts
from nnql_bullet.evaluation.splits import split_seeds
from nnql_bullet.executors import ExecutorKind, make_executor
from nnql_bullet.experiment import SimulatorName
from nnql_bullet.files import write_text
from nnql_bullet.reports import ledger as report


def ledger(
    seeds: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 10,
    sim: Annotated[SimulatorName, tyro.conf.arg(help_behavior_hint="")] = "twin",
    only: Annotated[str | None, tyro.conf.arg(metavar="CHOICE,...", help_behavior_hint="")] = None,
    episodes: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 1000,
    vehicles: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 64,
    worlds: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 300,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W", help_behavior_hint="")] = None,
    executor: Annotated[ExecutorKind, tyro.conf.arg(help_behavior_hint="")] = "processes",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = Path("runs/ledger"),
) -> int:
    """Regenerate the evidence for every choice that the paper leaves open.

    Every alternative is trained from several seeds and tested on validation worlds, one departure from the preset
    `paper` at a time. Prints what the evidence decides, and leaves ledger.md, ledger.json, ledger.csv and ledger.png.
    Trainings that are done are kept in DIR/parts: after an interrupt the same command goes on.

    For example:

        nnql-bullet ledger
        nnql-bullet ledger --only period,encoding --seeds 3

    Args:
        seeds: Trainings of each alternative; default 10.
        sim: The ideal vehicle (twin, the default: half an hour on two cores) or contact physics (a day).
        only: Some choices, by name (period, front, front_sides, others, hysteresis, reading, encoding, reward, closer,
            step, schedule, safe_steps, weights, cover, vehicles, discount, temperature, hidden, steps, letter).
        episodes: Of each training; default 1000.
        vehicles: That each learns from at once; default 64.
        worlds: Validation worlds of each kind; default 300.
        workers: Trainings at a time; default one a core. The result does not depend on it.
        executor: Where they run: processes of this machine (default), this process (inline), or Ray.
        address: Of a running Ray cluster, with --executor ray; without it Ray is started on this machine.
        out: Where the report goes; default runs/ledger.
    """
    split_seeds("validation", worlds)
    if seeds < 1:
        raise UserError(f"--seeds must be at least 1, not {seeds}")
    choices = _chosen(only)
    budget = Budget(sim, seeds, episodes, vehicles, worlds)
    where = make_executor(executor, workers or os.cpu_count() or 1, address)
    trials = [(c.name, a.label, task_of(a, s, budget)) for s in range(seeds) for c in choices for a in c.alternatives]
    out.mkdir(parents=True, exist_ok=True)
    try:
        tested = run_kept(
            where, "trainings", train_and_test, [trial[2] for trial in trials], Parts(out / "parts"), Counts
        )
    except KeyboardInterrupt:
        complain(f"interrupted; trainings that are done are kept in {out / 'parts'}: the same command goes on")
        return 130
    results: dict[tuple[str, str], list[list[Counts]]] = {}
    for (name, label, _), its in zip(trials, tested, strict=True):
        results.setdefault((name, label), []).append(its)
    found = entries(choices, results)
    write_text(out / "ledger.md", report.ledger_markdown(found, budget))
    write_text(out / "ledger.csv", report.ledger_csv(found))
    write_text(out / "ledger.json", json.dumps(report.ledger_values(found, budget), indent=1) + "\n")
    report.draw_ledger(found, budget, out / "ledger.png")
    for choice in choices:
        say(f"{choice.question}: {report.decision(choice, found)}")
    say(f"report: {out / 'ledger.md'}")
    return 0


def _chosen(only: str | None) -> list[Choice]:
    """The choices asked for.

    Raises:
        UserError: If there is none of such a name.
    """
    if only is None:
        return list(CHOICES)
    names = {choice.name: choice for choice in CHOICES}
    asked = [name.strip() for name in only.split(",") if name.strip()]
    unknown = [name for name in asked if name not in names]
    if unknown or not asked:
        raise UserError(f"--only: there is no choice '{(unknown or [''])[0]}'; choices: {', '.join(names)}")
    return [names[name] for name in asked]
