"""`nnql-bullet gap`."""

import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro

from nnql_bullet.cli.console import say
from nnql_bullet.cli.work import run_all
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation import gap as measure
from nnql_bullet.evaluation.gap import Gap, Pair, Side, Trial
from nnql_bullet.evaluation.policies import fingerprint
from nnql_bullet.evaluation.splits import SplitName, split_seeds
from nnql_bullet.executors import make_executor
from nnql_bullet.files import write_text
from nnql_bullet.reports import gap as report
from nnql_bullet.run_config import SimulatorName
from nnql_bullet.runs import open_policy
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.task import ENDINGS


def gap(
    runs: Annotated[list[Path], tyro.conf.Positional, tyro.conf.arg(metavar="RUN ...", help_behavior_hint="")],
    /,
    against: Annotated[SimulatorName, tyro.conf.arg(help_behavior_hint="")] = "kinematic",
    sim: Annotated[EngineName, tyro.conf.arg(help_behavior_hint="")] = "bullet",
    physics: Annotated[PhysicsName, tyro.conf.arg(help_behavior_hint="")] = "reference",
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE", help_behavior_hint="")] = None,
    worlds: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="")] = 100,
    split: Annotated[SplitName, tyro.conf.arg(help_behavior_hint="")] = "validation",
    faults: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W", help_behavior_hint="")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
) -> int:
    """Measure what physics costs a policy: the same policy, worlds and seeds in two simulators.

    Prints how drives ended on both sides, and leaves gap.md, gap.json, episodes.csv and pictures: outcomes against each
    other, how the drives come apart, the drives that ended differently with a cause each and the command that replays
    it, and success by fault (friction, payload, sensor noise, a dead sector).

    For example:

        nnql-bullet gap runs/paper-0
        nnql-bullet gap runs/paper-0 runs/paper-1 --world cover_10 --split test
        nnql-bullet gap runs/paper-0 --against mujoco --no-faults

    Args:
        runs: Run folders, or policy files.
        against: What contact physics is held against: the kinematic model (kinematic, the default), or the other
            engine.
        sim: Engine of contact physics; default bullet.
        physics: Settings of contact physics; default reference, the more exact.
        world: Shipped world (paper, cover_10, ...) or TOML file; default that of the training.
        worlds: How many worlds; default 100.
        split: Worlds to choose with (validation, the default), or those for the final table (test).
        faults: Whether to drive with faults too, which takes some twelve times as long.
        workers: Processes; default one a core. The result does not depend on it.
        out: Where the report goes; default runs/gap.
    """
    if not runs:
        raise UserError("give a run: a folder that `train` left, or the name of a shipped policy")
    if against == sim:
        raise UserError(f"--against {against} is the engine itself; give another, or another --sim")
    seeds = split_seeds(split, worlds)
    first, second = Side(against, physics), Side(sim, physics)
    fingerprints = _check(runs, world, (first, second), seeds[0])
    folder = out or Path("runs") / "gap"
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".flips-", dir=folder) as flips:
        tasks = measure.tasks(runs, world, seeds, first, second, faults, Path(flips))
        executor = make_executor("processes", workers or os.cpu_count() or 1)
        results = run_all(executor, "driving", measure.work, tasks, lambda task: len(task.seeds))
        drives = [drive for piece in results for drive in piece]
        pairs = [drive for drive in drives if isinstance(drive, Pair)]
        trials = [drive for drive in drives if isinstance(drive, Trial)]
        result = Gap(tuple(map(str, runs)), fingerprints, world, split, seeds, first, second, pairs, trials)
        _replace(folder / "flips", Path(flips))
    _write(result, folder)
    _print(result)
    say(f"report: {folder / 'gap.md'}")
    return 0


def _check(runs: list[Path], world: str | None, sides: tuple[Side, Side], seed: int) -> tuple[str, ...]:
    """What is wrong with runs, world or engines shows before anything is written.

    Returns:
        The fingerprints of the runs.

    Raises:
        UserError: If something is.
    """
    fingerprints = []
    for run in runs:
        for side in sides:
            experiment, _ = open_policy(run, {"world": world, "simulator": side.simulator})
            experiment.simulator.close()
        experiment.world(seed)
        fingerprints.append(fingerprint(experiment))
    return tuple(fingerprints)


def _replace(folder: Path, by: Path) -> None:
    """Has a folder hold the recordings of another one, and no older ones."""
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.npz"):
        old.unlink()
    for new in by.glob("*.npz"):
        new.replace(folder / new.name)


def _write(gap: Gap, folder: Path) -> None:
    write_text(folder / "gap.md", report.gap_markdown(gap))
    write_text(folder / "gap.json", json.dumps(report.gap_values(gap), indent=1) + "\n")
    write_text(folder / "episodes.csv", report.gap_csv(gap))
    report.draw_gap(gap, folder / "gap.png")
    for name in ("faults.png", "flips.png"):
        (folder / name).unlink(missing_ok=True)
    report.draw_faults(gap, folder / "faults.png")
    report.draw_flips(gap, folder / "flips", folder / "flips.png")


def _print(gap: Gap) -> None:
    matrix = measure.outcome_matrix(gap.pairs)
    say(f"rows {gap.first.name}, columns {gap.second.name}; {len(gap.pairs)} pairs of drives")
    say(f"{'':<11}" + "".join(f"{ending:>11}" for ending in ENDINGS))
    for ending, row in zip(ENDINGS, matrix.tolist(), strict=True):
        say(f"{ending:<11}" + "".join(f"{count:>11}" for count in row))
    say(f"McNemar p = {measure.success_p_value(gap.pairs):.2g}; {len(gap.flips)} drives ended differently")
    if gap.trials:
        say(f"{'fault':<24}{'goal %':>20}{'collision %':>20}{'p':>9}{f'goal % in {gap.first.name}':>28}")
        for row in measure.fault_rows(gap):
            p_value = f"{row.p_value:.2g}" if row.fault else ""
            shares = f"{row.shares['goal']!s:>20}{row.shares['collision']!s:>20}"
            say(f"{row.fault or 'none':<24}{shares}{p_value:>9}{row.first_goal or 'as none'!s:>28}")
