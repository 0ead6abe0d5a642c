"""`nnql-bullet ledger`."""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import complain, say
from nnql_bullet.cli.work import run_kept
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.books import BOOKS, Book
from nnql_bullet.evaluation.ledger import Budget, Counts, entries, task_of, train_and_test
from nnql_bullet.evaluation.parts import Parts
from nnql_bullet.evaluation.splits import split_seeds
from nnql_bullet.executors import ExecutorKind, make_executor
from nnql_bullet.experiment import SimulatorName
from nnql_bullet.files import write_text
from nnql_bullet.reports import ledger as report


def ledger(
    preset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PRESET", help_behavior_hint="")] = "paper",
    /,
    seeds: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None,
    sim: Annotated[SimulatorName, tyro.conf.arg(help_behavior_hint="")] = "twin",
    only: Annotated[str | None, tyro.conf.arg(metavar="CHOICE,...", help_behavior_hint="")] = None,
    episodes: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None,
    vehicles: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 64,
    worlds: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 300,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W", help_behavior_hint="")] = None,
    executor: Annotated[ExecutorKind, tyro.conf.arg(help_behavior_hint="")] = "processes",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
) -> int:
    """Regenerate the evidence for every choice that a preset is made of.

    Of `paper` these are the choices that the paper leaves open, of `tuned` the ways back to the paper's numbers, of
    `double_dqn` the parts that could be left out. Every alternative is trained from several seeds and tested on
    validation worlds, one departure from the preset at a time. Prints what the evidence decides, and leaves ledger.md,
    ledger.json, ledger.csv and ledger.png. Trainings that are done are kept in DIR/parts: after an interrupt the same
    command goes on.

    For example:

        nnql-bullet ledger
        nnql-bullet ledger --only period,encoding --seeds 3
        nnql-bullet ledger double_dqn

    Args:
        preset: paper (the default), tuned or double_dqn.
        seeds: Trainings of each alternative; default 10, of tuned 5, of double_dqn 2.
        sim: The ideal vehicle (twin, the default: half an hour on two cores) or contact physics (a day).
        only: Some choices, by name; a wrong one has all of them listed.
        episodes: Of each training; default 1000, of double_dqn 4000.
        vehicles: That each learns from at once; default 64.
        worlds: Validation worlds of each kind; default 300.
        workers: Trainings at a time; default one a core. The result does not depend on it.
        executor: Where they run: processes of this machine (default), this process (inline), or Ray.
        address: Of a running Ray cluster, with --executor ray; without it Ray is started on this machine.
        out: Where the report goes; default runs/ledger, of another preset runs/ledger-PRESET.
    """
    split_seeds("validation", worlds)
    if seeds is not None and seeds < 1:
        raise UserError(f"--seeds must be at least 1, not {seeds}")
    book = _chosen(preset, only)
    budget = Budget(
        simulator=sim,
        seeds=seeds or book.seeds,
        episodes=book.episodes if episodes is None else episodes,
        vehicles=vehicles,
        worlds=worlds,
    )
    where = make_executor(executor, workers or os.cpu_count() or 1, address)
    trials = [
        (choice.name, alternative.label, task_of(book, alternative, seed, budget))
        for seed in range(budget.seeds)
        for choice in book.choices
        for alternative in choice.alternatives
    ]
    folder = out or Path("runs") / ("ledger" if preset == "paper" else f"ledger-{preset}")
    folder.mkdir(parents=True, exist_ok=True)
    try:
        tested = run_kept(
            where, "trainings", train_and_test, [trial[2] for trial in trials], Parts(folder / "parts"), Counts
        )
    except KeyboardInterrupt:
        complain(f"interrupted; trainings that are done are kept in {folder / 'parts'}: the same command goes on")
        return 130
    results: dict[tuple[str, str], list[list[Counts]]] = {}
    for (name, label, _), its in zip(trials, tested, strict=True):
        results.setdefault((name, label), []).append(its)
    found = entries(book, results)
    write_text(folder / "ledger.md", report.ledger_markdown(book, found, budget))
    write_text(folder / "ledger.csv", report.ledger_csv(found))
    write_text(folder / "ledger.json", json.dumps(report.ledger_values(book, found, budget), indent=1) + "\n")
    report.draw_ledger(book, found, budget, folder / "ledger.png")
    for choice in book.choices:
        say(f"{choice.question}: {report.decision(choice, found)}")
    say(f"report: {folder / 'ledger.md'}")
    return 0


def _chosen(preset: str, only: str | None) -> Book:
    """A preset's book, with the choices asked for.

    Raises:
        UserError: If there is none of such a name.
    """
    if preset not in BOOKS:
        raise UserError(f"there is no ledger of '{preset}'; presets: {', '.join(BOOKS)}")
    book = BOOKS[preset]
    if only is None:
        return book
    names = {choice.name: choice for choice in book.choices}
    asked = [name.strip() for name in only.split(",") if name.strip()]
    unknown = [name for name in asked if name not in names]
    if unknown or not asked:
        raise UserError(f"--only: there is no choice '{(unknown or [''])[0]}'; choices: {', '.join(names)}")
    return replace(book, choices=tuple(names[name] for name in asked))
