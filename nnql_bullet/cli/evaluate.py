"""`nnql-bullet evaluate`."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import complain, say, say_table
from nnql_bullet.cli.driving import asked_conditions
from nnql_bullet.cli.failures import clear
from nnql_bullet.cli.filming import FPS, film_of, shoot, whole
from nnql_bullet.cli.work import run_all, run_kept
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.drives import (
    FilmTask,
    Setting,
    Tier,
    draw_tiers,
    drive,
    drive_tasks,
    film,
    survey,
    survey_tasks,
)
from nnql_bullet.evaluation.metrics import Evaluation, comparisons, rows
from nnql_bullet.evaluation.parts import Parts
from nnql_bullet.evaluation.policies import Policy, open_policies
from nnql_bullet.evaluation.splits import SplitName
from nnql_bullet.executors import Executor, ExecutorKind, make_executor
from nnql_bullet.experiment import Experiment
from nnql_bullet.files import write_text
from nnql_bullet.recording import Recording
from nnql_bullet.render.film import HOLD
from nnql_bullet.reports import evaluation as report
from nnql_bullet.rollout import EpisodeSummary
from nnql_bullet.run_config import SimulatorName
from nnql_bullet.runs import open_policy
from nnql_bullet.sim.engines import PhysicsName
from nnql_bullet.worlds.paths import Difficulty

COVERS = {"2.5": "cover_2.5", "5": "paper", "7.5": "cover_7.5", "10": "cover_10", "15": "cover_15", "20": "cover_20"}
"""Percent of the arena under boxes, and the shipped world."""
CLIP = 12.0
"""How long before its end a clip of a failure begins [s]."""
CLIP_SIZE = (960, 540)
"""[pixels]"""


def evaluate(
    policies: Annotated[list[Path], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY ...", help_behavior_hint="")],
    /,
    split: Annotated[SplitName, tyro.conf.arg(help_behavior_hint="")] = "validation",
    worlds: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 100,
    cover: Annotated[str | None, tyro.conf.arg(metavar="P,P,...", help_behavior_hint="")] = None,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE,...", help_behavior_hint="")] = None,
    sim: Annotated[SimulatorName, tyro.conf.arg(help_behavior_hint="")] = "bullet",
    physics: Annotated[PhysicsName, tyro.conf.arg(help_behavior_hint="")] = "reference",
    shield: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")] = False,
    friction: Annotated[float | None, tyro.conf.arg(metavar="MU", help_behavior_hint="")] = None,
    payload: Annotated[float | None, tyro.conf.arg(metavar="KG", help_behavior_hint="")] = None,
    noise: Annotated[float | None, tyro.conf.arg(metavar="M", help_behavior_hint="")] = None,
    dead_sector: Annotated[int | None, tyro.conf.arg(metavar="0..7", help_behavior_hint="")] = None,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W", help_behavior_hint="")] = None,
    executor: Annotated[ExecutorKind, tyro.conf.arg(help_behavior_hint="")] = "processes",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None,
    clips: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 0,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = Path("runs/evaluate"),
    json_output: Annotated[
        bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(name="json", help_behavior_hint="")
    ] = False,
) -> int:
    """Drive several policies through the same worlds, and say how good each is and how sure that is.

    Policies that differ by their training seed alone are one method. Prints success with 95 % intervals, and leaves
    evaluation.md, results.json, results.csv, episodes.csv (a line for each drive) and pictures: how drives ended,
    success against cover, paths of failures; `nnql-bullet failures DIR` then sorts these. The same inputs give the same
    bytes. Pieces that are done are kept in DIR/parts: after an interrupt the same command goes on, and a longer one
    reuses them.

    For example:

        nnql-bullet evaluate straight hand_rule look_ahead --sim kinematic
        nnql-bullet evaluate runs/paper-0 runs/paper-1 hand_rule --cover 5,10
        nnql-bullet evaluate runs/paper-0 straight --world traps,aisles,moving --worlds 50 --split test
        nnql-bullet evaluate double_dqn --shield --friction 0.5 --payload 80

    Args:
        policies: Run folders, policy files, rules by name, or TOML files that configure a rule.
        split: Worlds to choose with (validation, the default), or those for the final table (test).
        worlds: How many of each kind; default 100.
        cover: Shipped worlds by the percentage under boxes: 2.5, 5, 7.5, 10, 15, 20; default 5,10,15 without --world.
        world: Other shipped worlds (traps, aisles, moving, ...) or TOML files, beside those of --cover.
        sim: Contact physics (bullet, the default, or mujoco) or the kinematic model (kinematic).
        physics: Settings of contact physics; default reference, the more exact.
        shield: Drive each policy in a shield too, which takes only what leaves room to stop, and report it beside.
        friction: Of the wheels against the ground, instead of the vehicle's own.
        payload: On the middle of the deck [kg].
        noise: Standard deviation of each ray [m].
        dead_sector: A sensor that sees nothing, untold; 0 is the front, counted counter-clockwise.
        workers: Pieces that run at a time; default one a core. The result does not depend on it.
        executor: Where they run: processes of this machine (default), this process (inline), or Ray.
        address: Of a running Ray cluster, with --executor ray; without it Ray is started on this machine.
        clips: Videos of the last seconds of failures, one of each method in each kind of world, that are left in
            DIR/clips; at most so many, default none.
        out: Where the report goes; default runs/evaluate.
        json_output: Print results.json instead of the table.
    """
    if clips < 0:
        raise UserError(f"--clips: must not be negative, not {clips}")
    files = _files(cover, world)
    setting = Setting(split, sim, physics, asked_conditions(friction, payload, noise, dead_sector))
    where = make_executor(executor, workers or os.cpu_count() or 1, address)
    opened = open_policies(policies, shield)
    _check_engine(opened[0], setting)
    tiers = draw_tiers(files, setting, worlds, opened[0])
    out.mkdir(parents=True, exist_ok=True)
    try:
        evaluation = _driven(where, opened, tiers, setting, Parts(out / "parts"))
        films = _filmed(where, evaluation)
    except KeyboardInterrupt:
        complain(f"interrupted; what is driven so far is kept in {out / 'parts'}: the same command goes on")
        return 130
    _write(evaluation, films, out, json_output)
    _shoot_clips([task for task, _ in films[:clips]], out)
    return 0


def _files(cover: str | None, world: str | None) -> list[str]:
    """The world files that are asked for.

    Raises:
        UserError: If there is no such cover.
    """
    covers = _items(cover) if cover is not None else [] if world else ["5", "10", "15"]
    unknown = [one for one in covers if one not in COVERS]
    if unknown:
        raise UserError(f"--cover: there are worlds with {', '.join(COVERS)} percent, not '{unknown[0]}'")
    return [*(COVERS[one] for one in covers), *_items(world or "")]


def _items(text: str) -> list[str]:
    return [item.strip() for item in text.split(",") if item.strip()]


def _check_engine(policy: Policy, setting: Setting) -> None:
    """An engine that is not there, and conditions that cannot be, show before anything is driven."""
    experiment: Experiment = open_policy(Path(policy.path), setting.changes)[0]
    experiment.simulator.close()


def _driven(
    executor: Executor, policies: Sequence[Policy], tiers: Sequence[Tier], setting: Setting, parts: Parts
) -> Evaluation:
    """Everything that is not there yet is driven."""
    difficulties: dict[str, list[Difficulty]] = {tier.name: [] for tier in tiers}
    surveys = survey_tasks(policies[0], tiers, setting)
    for task, found in zip(surveys, run_kept(executor, "worlds", survey, surveys, parts, Difficulty), strict=True):
        difficulties[task.tier.name] += found
    drives: dict[tuple[str, str], list[EpisodeSummary]] = {}
    tasks = drive_tasks(policies, tiers, setting)
    pieces = run_kept(executor, "driving", drive, tasks, parts, EpisodeSummary)
    for one, summaries in zip(tasks, pieces, strict=True):
        drives.setdefault((one.policy.name, one.tier.name), []).extend(summaries)
    return Evaluation(setting, policies, tiers, difficulties, drives)


def _filmed(executor: Executor, e: Evaluation) -> list[tuple[FilmTask, Recording]]:
    """The first drive of each method in each tier that failed, recorded."""
    tasks: dict[tuple[str, str], FilmTask] = {}
    for policy in e.policies:
        for tier in e.tiers:
            for summary in e.drives[policy.name, tier.name]:
                if summary.ending != "goal":
                    task = FilmTask(policy, tier, e.setting, summary.world_seed)
                    tasks.setdefault((policy.method, tier.name), task)
    chosen = list(tasks.values())
    return list(zip(chosen, run_all(executor, "failures", film, chosen), strict=True))


def _shoot_clips(tasks: Sequence[FilmTask], out: Path) -> None:
    """Draws how recorded failures ended."""
    folder = out / "clips"
    for old in folder.glob("*.mp4"):
        old.unlink()
    for task in tasks:
        folder.mkdir(exist_ok=True)
        film = film_of(out / "failures" / task.name, "split", CLIP_SIZE)
        shoot(film, whole(film.recording)[-round((CLIP + HOLD) * FPS) :], folder / f"{Path(task.name).stem}.mp4")


def _write(evaluation: Evaluation, films: list[tuple[FilmTask, Recording]], out: Path, json_output: bool) -> None:
    found, tests, tasks = rows(evaluation), comparisons(evaluation), [task for task, _ in films]
    values = json.dumps(report.evaluation_values(evaluation, found, tests, tasks), indent=1)
    failures = out / "failures"
    failures.mkdir(exist_ok=True)
    clear(failures)
    for task, recording in films:
        recording.save(failures / task.name)
    for name in ("cover.png", "failures.png"):
        (out / name).unlink(missing_ok=True)
    report.draw_outcomes(evaluation, found, out / "outcomes.png")
    report.draw_cover(evaluation, found, out / "cover.png")
    report.draw_failures(films, out / "failures.png")
    write_text(out / "results.csv", report.results_csv(found))
    write_text(out / "episodes.csv", report.episodes_csv(evaluation))
    write_text(out / "evaluation.md", report.evaluation_markdown(evaluation, found, tests, tasks))
    write_text(out / "results.json", values + "\n")
    if json_output:
        say(values)
        return
    say(f"success in %, {evaluation.setting.title}, {len(evaluation.tiers[0].seeds)} worlds each (95 % intervals)")
    say_table(*report.success_table(evaluation, found))
    say(f"report: {out / 'evaluation.md'}")
