"""A sweep: a file of a search among the keys of a run, and the training of each trial."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from nnql_bullet import session
from nnql_bullet.config import options, parse, read_toml, to_values
from nnql_bullet.errors import UserError, WorkFailed
from nnql_bullet.evaluation.space import Space, Trial, is_hopeless, read_space
from nnql_bullet.files import is_file
from nnql_bullet.presets import config_of
from nnql_bullet.run_config import RunConfig
from nnql_bullet.runs import CONFIG, load_run
from nnql_bullet.training.log import VALIDATION
from nnql_bullet.types import Few, Seed

FIXED = (
    "seed",
    "episodes",
    "agent.kind",
    "training.evaluate_every",
    "training.evaluate_worlds",
    "training.evaluate_count",
)
"""Keys that are the same for all trials: by these they are compared."""
_WORLDS = ("world", "training.worlds")
"""Keys of the worlds that trials are evaluated in, unless `training.evaluate_worlds` names others."""


@options
class SweepOptions:
    """Options of a sweep."""

    space: dict[str, Any]
    """For each key to search a table with `low`, `high` and, if wanted, `log` or `step`, or a list of values."""
    trials: Few = 40
    """Number of trainings."""
    seed: Seed = 0
    """Seed of what is drawn; that of all trainings is the key `seed` of the run."""
    random: Annotated[int, Field(ge=0, le=1000)] = 10
    """First trials that are drawn at random; the others follow what those before came to."""
    together: Few = 4
    """Trials of a round, which are drawn at the same time: so many can run at a time."""
    prune: bool = True
    """Whether a trial ends early if its best evaluation so far is below the median of the earlier trials then."""


@dataclass(frozen=True)
class Sweep:
    """A sweep as its file says."""

    name: str
    options: SweepOptions
    space: Space[RunConfig]

    @property
    def evaluations(self) -> int:
        """Number of evaluations of a training."""
        config = self.space.base
        return config.episodes // (config.training.evaluate_every or config.episodes)


def read_sweep(file: Path) -> Sweep:
    """Reads a file: a configuration with a table `sweep`.

    Raises:
        UserError: If there is no such file, a key or value is wrong, or trials could not be compared.
    """
    values, where = read_toml(file), str(file)
    table = values.pop("sweep", None)
    if not isinstance(table, Mapping):
        raise UserError(f"{where}: has no table [sweep]; see: nnql-bullet sweep --help")
    its = parse(SweepOptions, table, f"{where}: sweep")
    base = config_of(values, where)
    space = read_space(its.space, base, f"{where}: sweep.space", base.agent.kind, FIXED)
    training = base.training
    if training.evaluate_every is None or base.episodes % training.evaluate_every:
        raise UserError(
            f"{where}: trials are compared by the evaluation after their last episode; give training.evaluate_every, "
            f"a number that divides the {base.episodes} episodes"
        )
    varied = [name for name in _WORLDS if name in space.names]
    if varied and training.evaluate_worlds is None:
        raise UserError(f"{where}: '{varied[0]}' is searched; give training.evaluate_worlds, to compare trials by")
    return Sweep(file.stem, its, space)


@dataclass(frozen=True)
class TrialTask:
    """A training to be done."""

    number: int
    values: Mapping[str, Any]
    """Of the space, by dotted names."""
    config: RunConfig
    folder: Path
    """Run folder."""
    least: Sequence[float]
    """See `space.bars`."""


def train_trial(task: TrialTask) -> Trial:
    """Trains one trial, or goes on with what its folder holds of it, until it is over or hopeless."""
    folder = task.folder
    history: list[float] = []

    def hear(done: int, numbers: Mapping[str, float]) -> None:
        history.extend(value for name, value in numbers.items() if name == VALIDATION)

    def stop() -> bool:
        return is_hopeless(history, task.least)

    try:
        begun = load_run(folder) if is_file(folder / CONFIG) else None
        if begun is None or begun.config != task.config:
            session.train(task.config, folder, workers=1, overwrite=True, log=hear, stop=stop)
        else:
            history += [one.success for one in begun.evaluations]
            if not stop():
                session.resume(folder, workers=1, log=hear, stop=stop)
    except (UserError, WorkFailed) as error:
        return Trial(task.number, task.values, tuple(history), "failed", str(error))
    return Trial(task.number, task.values, tuple(history), "pruned" if stop() else "trained")


def identity(sweep: Sweep, digest: str) -> str:
    """All that the trials of a sweep depend on, but for their number.

    Args:
        sweep: The sweep.
        digest: Hash of what the files say that it names.
    """
    values = {name: value for name, value in to_values(sweep.options).items() if name != "trials"}
    return json.dumps([to_values(sweep.space.base), values, digest], sort_keys=True)
