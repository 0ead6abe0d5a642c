"""`nnql-bullet ablate`."""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import complain, say
from nnql_bullet.cli.work import run_kept
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.ablation import Budget, Counts, entries, task_of, train_and_test
from nnql_bullet.evaluation.parts import Parts
from nnql_bullet.evaluation.splits import split_seeds
from nnql_bullet.evaluation.studies import STUDIES, Study
from nnql_bullet.executors import ExecutorKind, make_executor
from nnql_bullet.files import write_text
from nnql_bullet.reports import ablation as report
from nnql_bullet.run_config import SimulatorName


def ablate(
    preset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PRESET", help_behavior_hint="")] = "paper",
    /,
    seeds: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None,
    sim: Annotated[SimulatorName, tyro.conf.arg(help_behavior_hint="")] = "kinematic",
    only: Annotated[str | None, tyro.conf.arg(metavar="FACTOR,...", help_behavior_hint="")] = None,
    episodes: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None,
    vehicles: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 64,
    worlds: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 300,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W", help_behavior_hint="")] = None,
    executor: Annotated[ExecutorKind, tyro.conf.arg(help_behavior_hint="")] = "processes",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
) -> int:
    """Regenerate the evidence for every factor that a preset is made of.

    Of `paper` these are the factors that the paper leaves open, of `tuned` the ways back to the paper's numbers, of
    `double_dqn` the parts that could be left out. Every variant is trained from several seeds and tested on
    validation worlds, one departure from the preset at a time. Prints what the evidence decides, and leaves
    ablation.md, ablation.json, ablation.csv and ablation.png. Trainings that are done are kept in DIR/parts: after an
    interrupt the same command goes on.

    For example:

        nnql-bullet ablate
        nnql-bullet ablate --only period,encoding --seeds 3
        nnql-bullet ablate double_dqn

    Args:
        preset: paper (the default), tuned or double_dqn.
        seeds: Trainings of each variant; default 10, of tuned 5, of double_dqn 2.
        sim: The kinematic model (kinematic, the default: half an hour on two cores) or contact physics (a day).
        only: Some factors, by name; a wrong one has all of them listed.
        episodes: Of each training; default 1000, of double_dqn 4000.
        vehicles: That each learns from at once; default 64.
        worlds: Validation worlds of each kind; default 300.
        workers: Trainings at a time; default one a core. The result does not depend on it.
        executor: Where they run: processes of this machine (default), this process (inline), or Ray.
        address: Of a running Ray cluster, with --executor ray; without it Ray is started on this machine.
        out: Where the report goes; default runs/ablation, of another preset runs/ablation-PRESET.
    """
    split_seeds("validation", worlds)
    if seeds is not None and seeds < 1:
        raise UserError(f"--seeds must be at least 1, not {seeds}")
    study = _chosen(preset, only)
    budget = Budget(
        simulator=sim,
        seeds=seeds or study.seeds,
        episodes=study.episodes if episodes is None else episodes,
        vehicles=vehicles,
        worlds=worlds,
    )
    where = make_executor(executor, workers or os.cpu_count() or 1, address)
    trials = [
        (factor.name, variant.label, task_of(study, variant, seed, budget))
        for seed in range(budget.seeds)
        for factor in study.factors
        for variant in factor.variants
    ]
    folder = out or Path("runs") / ("ablation" if preset == "paper" else f"ablation-{preset}")
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
    found = entries(study, results)
    write_text(folder / "ablation.md", report.ablation_markdown(study, found, budget))
    write_text(folder / "ablation.csv", report.ablation_csv(found))
    write_text(folder / "ablation.json", json.dumps(report.ablation_values(study, found, budget), indent=1) + "\n")
    report.draw_ablation(study, found, budget, folder / "ablation.png")
    for factor in study.factors:
        say(f"{factor.question}: {report.decision(factor, found)}")
    say(f"report: {folder / 'ablation.md'}")
    return 0


def _chosen(preset: str, only: str | None) -> Study:
    """A preset's study, with the factors asked for.

    Raises:
        UserError: If there is none of such a name.
    """
    if preset not in STUDIES:
        raise UserError(f"there is no ablation of '{preset}'; presets: {', '.join(STUDIES)}")
    study = STUDIES[preset]
    if only is None:
        return study
    names = {factor.name: factor for factor in study.factors}
    asked = [name.strip() for name in only.split(",") if name.strip()]
    unknown = [name for name in asked if name not in names]
    if unknown or not asked:
        raise UserError(f"--only: there is no factor '{(unknown or [''])[0]}'; factors: {', '.join(names)}")
    return replace(study, factors=tuple(names[name] for name in asked))
