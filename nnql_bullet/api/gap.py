"""`gap`: the same policies, worlds and seeds in two simulators."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from typing_extensions import Unpack

from nnql_bullet.api.evaluate import EvaluationArguments
from nnql_bullet.arguments import checked
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation import gap as measure
from nnql_bullet.evaluation.drives import distinct, has_chance
from nnql_bullet.evaluation.gap import Gap, Pair, PairTask, Side, Trial
from nnql_bullet.evaluation.policies import executor_for, open_policies
from nnql_bullet.evaluation.splits import SplitName, choose_draws
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.files import staged, write_text
from nnql_bullet.locks import locked
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import RECORDINGS
from nnql_bullet.reports import gap as report
from nnql_bullet.run_config import SimulatorName
from nnql_bullet.runs import PolicyLike, load_policy
from nnql_bullet.setting import Setting
from nnql_bullet.work import OnProgress, run_all
from nnql_bullet.worlds.source import World

_OLD = ("faults.png", "flips.png", *(f"flips/{pattern}" for pattern in RECORDINGS))
"""Files of an older report that a new one may be without."""


@dataclass(frozen=True)
class GapResults:
    """Results of `gap`."""

    gap: Gap
    """Both simulators, and every drive."""

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A flat record for each drive; `pandas.DataFrame(rows)` takes them."""
        return report.gap_records(self.gap)

    def table(self) -> str:
        """Endings in the two simulators against each other, and success by fault."""
        return report.gap_table(self.gap)

    def save(self, folder: Path | str) -> None:
        """Writes the report, tables, pictures and the recordings of drives that ended differently into a folder."""
        g = self.gap
        with staged(Path(folder), "gap.json", _OLD) as out:
            flips = out / "flips"
            flips.mkdir()
            for pair in g.pairs:
                for side, recording in zip((g.first, g.second), pair.recordings, strict=False):
                    recording.save(measure.flip_file(flips, pair.run, pair.world_seed, side))
            write_text(out / "gap.md", report.gap_markdown(g))
            write_text(out / "episodes.csv", report.gap_csv(g))
            report.draw_gap(g, out / "gap.png")
            report.draw_faults(g, out / "faults.png")
            report.draw_flips(g, flips, out / "flips.png")
            write_text(out / "gap.json", json.dumps(report.gap_values(g), indent=1) + "\n")


@checked
def gap(
    policies: PolicyLike | Sequence[PolicyLike],
    *,
    against: SimulatorName = "kinematic",
    world: str | Path | World | None = None,
    split: SplitName | None = None,
    n_worlds: int | None = None,
    seeds: range | None = None,
    faults: bool = True,
    out: Path | str | None = None,
    on_progress: OnProgress | None = None,
    **asked: Unpack[EvaluationArguments],
) -> GapResults:
    """Measures the sim-to-sim gap: the same policies, worlds and seeds in two simulators, drive by drive.

    Example:
        >>> import nnql_bullet as nb
        >>> results = nb.gap("straight", world="cover_10", n_worlds=1, physics="fast", faults=False)
        >>> len(results.gap.pairs)
        1

    Args:
        policies: See `evaluate`.
        against: The first simulator.
        world: A shipped world, a TOML file, a map or world of another program, or a `World`; by default that of the
            training.
        split: "validation", the default, has worlds to choose with, "test" those for a final table.
        n_worlds: Number of worlds, by default 100.
        seeds: Seeds of the worlds, in place of `split` and `n_worlds`.
        faults: Whether policies drive with a series of faults too, which takes some twelve times as long.
        out: Folder for the report; without it nothing is written.
        on_progress: Receives the progress.
        **asked: How policies drive, and where pieces of work run.

    Raises:
        UserError: If an argument is wrong, a policy or world cannot be read, or another process writes to `out`.
        WorkFailed: If a piece of work fails.
    """
    setting = Setting.of(asked)
    if setting.simulator == "kinematic":
        raise UserError("simulator: the second one is one of contact physics; give the kinematic model as against")
    if against == setting.simulator:
        raise UserError(f"against: '{against}' is the simulator itself; give another one")
    draws, world = choose_draws(split, n_worlds, seeds), str(world) if isinstance(world, Path) else world
    first, second = Side(against, setting.physics), Side(setting.simulator, setting.physics)
    opened = open_policies(policies, setting.shield, setting.robot, own_world=world is None)
    opened = [its for its in opened if its.shielded == setting.shield]
    where = executor_for(opened, asked)
    ours = [measure.check(PairTask(policy, world, draws.seeds, first, second, setting)) for policy in opened]
    for its, side in product(dict.fromkeys(ours if asked.get("check", True) else ()), (first, second)):
        check_at_first_use(its, side.simulator, side.physics, on_progress)
    own = [{"world": world, **setting.ends, **policy.own(setting).changes} for policy in opened]
    experiment = load_policy(opened[0].source, own[0]).experiment
    chances = [has_chance(policy, its) for policy, its in zip(opened, own, strict=True)]
    numbers = {one: len(distinct(experiment, experiment.worlds, draws.seeds, one)) for one in set(chances)}
    driven = [draws.seeds[: numbers[one]] for one in chances]
    tasks = measure.tasks(opened, world, driven, first, second, setting, faults)
    folder = None if out is None else Path(out)
    with locked(folder):
        made_by()  # which is asked for at the end, when the sources may be others
        pieces = run_all(where, "driving", measure.work, tasks, lambda task: len(task.seeds), on_progress=on_progress)
        drives = [drive for piece in pieces for drive in piece]
        pairs = [drive for drive in drives if isinstance(drive, Pair)]
        trials = [drive for drive in drives if isinstance(drive, Trial)]
        prints = tuple(policy.fingerprint for policy in opened)
        names = tuple(policy.path for policy in opened)
        robots = tuple(policy.robot for policy in opened)
        shown = world.name if isinstance(world, World) else world
        results = GapResults(Gap(names, prints, shown, draws, first, second, pairs, trials, setting, robots))
        if folder:
            results.save(folder)
    return results
