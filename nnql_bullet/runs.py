"""Run folders, which hold a training, and policies that are loaded from them.

- config.toml: the configuration, every key resolved
- sources.json, robot/, start.safetensors: what the files of worlds, of the robot and of the policy that the training
  began from said, which the configuration names (`sources.py`)
- made_by.json: what made it (`provenance.made_by`), in the order in which several did
- episodes.csv: a line for each finished episode
- checkpoint.safetensors: the agent's weights after the last line of episodes.csv, and the state of the training then;
  with a selection (`training/selection.py`) the candidates too
- policy.safetensors: the weights to drive with: the last ones, or those that were selected in the end
- selection.csv: with a selection, the goals of each candidate, once the training is over
- evaluations.csv: with evaluations between the episodes (`training/evaluation.py`), a line for each
- learning_curve.png, README.md: a picture and the policy's card, made when the training stops (`api/training.py`)
- tensorboard/: with `--log tensorboard`, a log; it is outside of what equal trainings have in common
- .lock: while a process trains there, which process it is
"""

import csv
import io
import json
import logging
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from numpy.typing import NDArray

from nnql_bullet import __version__, assets
from nnql_bullet.agents import RULES, Trainable
from nnql_bullet.agents.base import Custom, Decider
from nnql_bullet.arguments import checked
from nnql_bullet.config import dotted, parse, read_toml, to_values, write_toml
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment, refuse_speed
from nnql_bullet.files import plain_file, read_json, real, write_text
from nnql_bullet.locks import LOCK
from nnql_bullet.presets import load_config
from nnql_bullet.provenance import made_by
from nnql_bullet.rollout import EpisodeSummary, Policy
from nnql_bullet.run_config import RunConfig, changed, migrated
from nnql_bullet.sources import ROBOT, SOURCES, START, changed_robots, changed_worlds, keep_sources, located
from nnql_bullet.task import REWARD_TERMS
from nnql_bullet.training.base import Trainer, TrainingEpisode
from nnql_bullet.training.checkpoint import POLICY, Weights, load_weights, policy_file, save_weights
from nnql_bullet.training.evaluation import Evaluation, reason_to_stop
from nnql_bullet.training.log import TENSORBOARD
from nnql_bullet.training.selection import Candidates, most_goals
from nnql_bullet.vehicle.urdf import load_vehicle

CONFIG, EPISODES, CHECKPOINT = "config.toml", "episodes.csv", "checkpoint.safetensors"
LEARNING_CURVE, SELECTION, REPORT = "learning_curve.png", "selection.csv", "report.html"
EVALUATIONS, CARD, MADE_BY = "evaluations.csv", "README.md", "made_by.json"
_log = logging.getLogger(__name__)
_REWARD = "reward/"
"""Prefix of the columns of reward terms that are not the paper's, as in the `info` of the environment."""
_UNDER_WAY, _CANDIDATE = "under_way/", "candidate/"
_NUMBERS = ("duration", "path_length", "clearance", "mean_clearance", "lateral_acceleration", "heading_error")


@dataclass(frozen=True)
class State:
    """The state of a training at a checkpoint."""

    learned: dict[str, NDArray[Any]]
    """For `Trainable.load_state_dict`."""
    under_way: dict[str, NDArray[Any]]
    """For `Trainer.load_state_dict`."""


@dataclass(frozen=True)
class Run:
    """A training run and its folder."""

    folder: Path
    config: RunConfig
    episodes: list[TrainingEpisode] = field(default_factory=list)
    """Finished so far."""
    candidates: Candidates = field(default_factory=dict)
    """Late states to select the policy from."""
    evaluations: list[Evaluation] = field(default_factory=list)
    """Made so far."""
    state: State | None = None
    """At its last checkpoint; None before the first."""

    @property
    def policy(self) -> "LoadedPolicy":
        """The policy that it has learned.

        Raises:
            UserError: If there is none yet.
        """
        return load_policy(self.folder)

    @property
    def stopped_early(self) -> str:
        """Why it is over before all its episodes are done; empty if it is not."""
        training = self.config.training
        return reason_to_stop(self.evaluations, training.stop_at_success, training.patience)

    @property
    def is_trained(self) -> bool:
        """Whether nothing is left to learn: all its episodes are done, or an evaluation has ended it."""
        return len(self.episodes) == self.config.episodes or bool(self.stopped_early)

    @property
    def is_over(self) -> bool:
        """Whether it is trained, and its policy is what was learned or, if so configured, selected."""
        if not self.is_trained or not (self.folder / POLICY).is_file():
            return False
        if self.config.training.selection:
            return (self.folder / SELECTION).is_file()
        return load_weights(self.folder / POLICY).episodes == len(self.episodes)

    def create(self, overwrite: bool) -> None:
        """Creates the folder, or empties it of an older run.

        What a training has left that ended before its first checkpoint is no loss, and is emptied unasked. Whenever
        this is cut short, either the old run can be resumed, or the folder holds nothing that would be lost.

        Raises:
            UserError: If it holds a run and `overwrite` is False, holds something else, or the run begins from it.
        """
        folder, start = self.folder, self.config.start_from
        if start is not None and real(policy_file(start)).parent == real(folder):
            raise UserError(f"{folder}: is what the training begins from, so it stays as it is; give another folder")
        found = {path.name for path in folder.iterdir()} - {LOCK} if folder.is_dir() else set()
        if found and not found <= {CONFIG, EPISODES, SOURCES, ROBOT, START, TENSORBOARD, EVALUATIONS, MADE_BY}:
            if not overwrite:
                raise UserError(f"{folder}: is not empty; resume the run there, overwrite it, or give another folder")
            if CONFIG not in found:
                raise UserError(f"{folder}: holds no run, so it is not overwritten; give another folder")
        if (folder / TENSORBOARD).is_dir():
            shutil.rmtree(folder / TENSORBOARD)
        # The checkpoint can restore the files before it.
        shown = (LEARNING_CURVE, REPORT, CARD)
        for name in (POLICY, SELECTION, *shown, CHECKPOINT, SOURCES, START, EVALUATIONS, MADE_BY, EPISODES):
            (folder / name).unlink(missing_ok=True)
        folder.mkdir(parents=True, exist_ok=True)
        self.save_config()
        self.sign()
        keep_sources(self.config, folder)

    def save(self, agent: Trainable, training: Trainer) -> None:
        """Writes episodes, checkpoint and policy, in an order that is consistent whenever it is cut short.

        An earlier selection and report are void then.

        Raises:
            OSError: If a file cannot be written; the checkpoint before this one is then whole.
        """
        for old in (SELECTION, REPORT):
            (self.folder / old).unlink(missing_ok=True)
        write_text(self.folder / EPISODES, _as_csv(self.episodes))
        if self.evaluations:
            lines = [f"{one.episodes},{one.goals},{one.worlds}" for one in self.evaluations]
            write_text(self.folder / EVALUATIONS, "\n".join(["episodes,goals,worlds", *lines, ""]))
        config, done, learned = to_values(self.config), len(self.episodes), agent.state_dict()
        under_way = {_UNDER_WAY + name: values for name, values in training.state_dict().items()}
        candidates = {
            f"{_CANDIDATE}{episodes}/{name}": values
            for episodes, arrays in self.candidates.items()
            for name, values in arrays.items()
        }
        save_weights(Weights(config, done, {**learned, **under_way, **candidates}), self.folder / CHECKPOINT)
        self.save_policy(learned)

    def save_policy(self, learned: dict[str, NDArray[Any]]) -> None:
        """Writes what was learned in the episodes so far as the policy.

        Raises:
            OSError: If it cannot be written.
        """
        save_weights(Weights(to_values(self.config), len(self.episodes), learned), self.folder / POLICY)

    def save_selected(self, candidates: Candidates, goals: Mapping[int, int], worlds: int) -> int:
        """Makes the candidate with the most goals the policy, and writes down how each did.

        Args:
            candidates: That were tried.
            goals: In how many worlds each came to its target.
            worlds: Of so many.

        Returns:
            After how many episodes it was.

        Raises:
            OSError: If a file cannot be written; the selection is then not made.
        """
        best = most_goals(goals)
        config = to_values(self.config)
        save_weights(Weights(config, best, candidates[best]), self.folder / POLICY)
        lines = [f"{episodes},{count},{worlds},{int(episodes == best)}" for episodes, count in goals.items()]
        write_text(self.folder / SELECTION, "\n".join(["episodes,goals,worlds,selected", *lines, ""]))
        return best

    def go_on(self) -> None:
        """Writes what the folder lacks before it goes on: a run that was cut short in its beginning may lack files."""
        self.save_config()
        self.sign()
        if self.state is None and not (self.folder / SOURCES).is_file():
            keep_sources(self.config, self.folder)

    @property
    def makers(self) -> list[dict[str, Any]]:
        """What made it, in order (see `provenance.made_by`), each with the number of episodes that it began after.

        Raises:
            UserError: If the file is damaged.
        """
        file = self.folder / MADE_BY
        found = read_json(file) if file.is_file() else []  # version 0.2 wrote none
        if not isinstance(found, list) or not all(isinstance(its, dict) for its in found):
            raise UserError(f"{file}: damaged; delete it, or train anew")
        return found

    def sign(self) -> None:
        """Writes down what makes it from here on, if that is not what made it last; warns if the code is another."""
        makers, now = self.makers, {**made_by(), "after_episodes": len(self.episodes)}
        last = makers[-1] if makers else {}
        if {**last, "after_episodes": 0} == {**now, "after_episodes": 0}:
            return
        if last.get("code", now["code"]) != now["code"]:
            _log.warning(
                "%s was begun by other code of the program (%s on Python %s) and goes on with this (%s on Python %s); "
                "for a result of one code, train anew",
                *(self.folder, last["code"], last.get("python"), now["code"], now["python"]),
            )
        write_text(self.folder / MADE_BY, json.dumps([*makers, now], indent=1) + "\n")

    def save_config(self) -> None:
        """Writes the configuration, every key resolved."""
        text = f"# Resolved by nnql-bullet {__version__}\n{write_toml(to_values(self.config))}"
        write_text(self.folder / CONFIG, text)


@dataclass(frozen=True)
class LoadedPolicy:
    """A policy that is ready to drive."""

    name: str
    """As it was asked for."""
    experiment: Experiment
    """Its agent has learned what the policy knows."""
    episodes: int
    """Training episodes behind it; 0 for a rule."""

    @property
    def label(self) -> str:
        """What drives, in a few words."""
        config = self.experiment.config
        kind = config.agent.kind
        label = (
            self.name
            if isinstance(self.experiment.agent, Custom)
            else kind
            if kind in RULES
            else f"{kind}, {self.episodes} episodes"
        )
        return f"{label} + shield" if config.shield else label

    def changed(self, changes: Mapping[str, Any]) -> "LoadedPolicy":
        """The same policy with nested values laid over its configuration (see `config.merged`).

        Raises:
            UserError: If a key or value is wrong.
        """
        config, agent = self.experiment.config, self.experiment.agent
        if isinstance(agent, Custom):
            return LoadedPolicy(self.name, _experiment(config, changes, agent), self.episodes)
        experiment = _experiment(config, changes)
        if isinstance(self.experiment.agent, Trainable):
            experiment.trainable.load_state_dict(self.experiment.agent.state_dict())
        return LoadedPolicy(self.name, experiment, self.episodes)


PolicyLike = str | Path | LoadedPolicy | Policy | Decider
"""A policy by its path or name, one that `load_policy` returned, or an object of your own."""


@checked
def load_policy(policy: PolicyLike, changes: Mapping[str, Any] = MappingProxyType({})) -> LoadedPolicy:
    """Loads what a run has learned, or a rule.

    Example:
        >>> import nnql_bullet as nb
        >>> policy = nb.load_policy("double_dqn")
        >>> policy.episodes, policy.experiment.config.simulator
        (12000, 'kinematic')

    Args:
        policy: A run folder, a policy file, the name of a shipped policy or of a rule, or a TOML file that configures
            a rule. An object of your own, which has a method `act`, gets the configuration of the preset `paper`.
        changes: Nested values laid over the configuration that it was trained with (see `config.merged`).

    Raises:
        UserError: If there is no such policy, or a value is wrong.
    """
    if isinstance(policy, LoadedPolicy):
        return policy.changed(changes)
    if not isinstance(policy, str | Path):
        return _own_policy(policy, changes)
    name, path = str(policy), Path(policy)
    if _is_configured(path):
        config = load_config(name, {})
        if config.agent.kind not in RULES:
            raise UserError(f"{name}: '{config.agent.kind}' has to learn first; train it with this configuration")
        return LoadedPolicy(name, _experiment(config, changes), 0)
    if path.suffix == ".py":
        raise UserError(f"{name}: a policy in Python is an object; give it to nnql_bullet.drive in a script")
    if not os.path.exists(path) and not _is_shipped(path):
        known = f"policies: {', '.join(assets.policies())}; rules: {', '.join(RULES)}"
        raise UserError(f"{name}: no such run or policy file, no shipped policy and no rule; {known}")
    experiment, weights = read_learned(policy, changes)
    experiment.trainable.load_state_dict(weights.arrays)
    return LoadedPolicy(name, experiment, weights.episodes)


def read_learned(policy: str | Path, changes: Mapping[str, Any]) -> tuple[Experiment, Weights]:
    """Reads what a run has learned, for one who puts the weights where they belong.

    Args:
        policy: A run folder, a policy file or the name of a shipped policy.
        changes: See `load_policy`.

    Returns:
        The objects of the run with an untrained agent, and the weights.

    Raises:
        UserError: If there is no such policy, it is damaged, or a value is wrong.
    """
    file = policy_file(policy)
    weights = load_weights(file)
    config = located(parse(RunConfig, migrated(weights.config), str(file)), file.parent)
    return _experiment(config, changes), weights


def is_learned(policy: PolicyLike) -> bool:
    """Whether `read_learned` can read a policy: it is no rule, no object, and there."""
    if not isinstance(policy, str | Path) or _is_configured(Path(policy)):
        return False
    return os.path.exists(policy) or _is_shipped(Path(policy))


def _experiment(config: RunConfig, changes: Mapping[str, Any], agent: Policy | None = None) -> Experiment:
    """Makes the objects of a configuration with nested values laid over it.

    Raises:
        UserError: If a key or value is wrong, or the vehicle does not reach the speed.
    """
    experiment = Experiment(changed(config, **changes), agent)
    speed = dotted(changes).get("drive.speed")
    if speed is not None and speed > experiment.config.drive.speed:
        refuse_speed(experiment.vehicle, speed)
    return experiment


def tell_differences(policy: PolicyLike, robot: str | None, own_world: bool = False) -> None:
    """Logs what is not as it was when a policy learned: its vehicle, or files that its run folder keeps.

    Args:
        policy: See `load_policy`.
        robot: What it is to drive; None is what it learned with.
        own_world: Whether it is to drive in the world in which it learned.

    Raises:
        UserError: If there is no such policy or robot.
    """
    name = policy.name if isinstance(policy, LoadedPolicy) else policy
    if isinstance(name, str | Path) and os.path.exists(name) and not _is_configured(Path(name)):
        folder = Path(name) if os.path.isdir(name) else Path(name).parent
        changed_files = changed_robots(folder) if robot is None else {}
        changed_files |= changed_worlds(folder) if own_world else {}
        for file, difference in changed_files.items():
            _log.warning(
                "%s has changed since %s was trained (%s); it drives with its own copy, as it was then; name the file "
                "to drive with what it says now",
                *(file, name, difference),
            )
    if robot is None:
        return
    loaded, vehicle = load_policy(policy), load_vehicle(robot)
    own = load_vehicle(loaded.experiment.config.robot)
    if loaded.episodes and own.digest != vehicle.digest:
        _log.info(
            "%s was trained on the robot '%s' and drives '%s' here; the lengths that it goes by follow the vehicle",
            *(loaded.name, own.name, vehicle.name),
        )


def _own_policy(policy: Policy | Decider, changes: Mapping[str, Any]) -> LoadedPolicy:
    """An object of the caller as a policy.

    Raises:
        UserError: If it cannot act, or a value is wrong.
    """
    if not isinstance(policy, Decider):
        raise UserError(f"{type(policy).__name__} is no policy: it has no method act(observations)")
    lacking = [name for name in ("action_values", "reset") if not hasattr(policy, name)]
    if hasattr(policy, "initial_state") and lacking:
        raise UserError(f"{type(policy).__name__} has a memory but lacks: {', '.join(lacking)}; see rollout.Policy")
    agent = policy if isinstance(policy, Custom) else Custom(policy)
    return LoadedPolicy(agent.name, _experiment(RunConfig(), changes, agent), 0)


def drives_folder(policy: Path) -> Path:
    """Where drives of what `load_policy` takes are kept: with its run, or under its name in runs/ if it has none."""
    named = _is_configured(policy) or _is_shipped(policy)
    home = Path("runs") / policy.stem if named else policy if policy.is_dir() else policy.parent
    return home / "drives"


def _is_shipped(policy: Path) -> bool:
    """Whether it is the name of a shipped policy, and of nothing else."""
    return str(policy) in assets.policies() and not policy.exists()


def _is_configured(policy: Path) -> bool:
    """Whether it is not learned but named, or configured by a TOML file."""
    return policy.suffix == ".toml" or (str(policy) in RULES and not policy.exists())


@checked
def load_run(folder: Path | str, episodes: int | None = None) -> Run:
    """Reads a run folder as it was at its last checkpoint. Nothing is written.

    Args:
        folder: The run folder.
        episodes: A new number of episodes to train in all; by default the one that it has been configured for.

    Raises:
        UserError: If the folder holds no run, its files do not fit each other, or it has more episodes already.
    """
    folder = Path(folder)
    if not (folder / CONFIG).is_file():
        raise UserError(f"{folder}: holds no run (no {CONFIG}); give the folder that a training wrote")
    config = parse(RunConfig, migrated(read_toml(folder / CONFIG)), str(folder / CONFIG))
    run = Run(folder, config)
    if (folder / CHECKPOINT).exists():
        weights = load_weights(folder / CHECKPOINT)
        rows = _read_csv(folder / EPISODES)[: weights.episodes]
        trained = parse(RunConfig, migrated(weights.config), str(folder / CHECKPOINT))
        if replace(trained, episodes=config.episodes) != config or len(rows) != weights.episodes:
            raise UserError(f"{folder}: {CHECKPOINT} does not belong to its {CONFIG} and {EPISODES}; train anew")
        evaluations = _read_evaluations(folder / EVALUATIONS, weights.episodes, config.training.evaluate_every)
        parts = weights.arrays.items()
        state = State(
            learned={name: values for name, values in parts if not name.startswith((_UNDER_WAY, _CANDIDATE))},
            under_way={name.removeprefix(_UNDER_WAY): values for name, values in parts if name.startswith(_UNDER_WAY)},
        )
        run = Run(folder, config, rows, _candidates(weights.arrays), evaluations, state)
    if episodes is None:
        return run
    if episodes < len(run.episodes):
        raise UserError(f"{folder}: has {len(run.episodes)} episodes already, so {episodes} leave nothing to do")
    return replace(run, config=changed(config, episodes=episodes))


def _candidates(arrays: Mapping[str, NDArray[Any]]) -> Candidates:
    """Those in a checkpoint."""
    found: Candidates = {}
    for name in sorted(name for name in arrays if name.startswith(_CANDIDATE)):
        episodes, _, part = name.removeprefix(_CANDIDATE).partition("/")
        found.setdefault(int(episodes), {})[part] = arrays[name]
    return dict(sorted(found.items()))


def _as_csv(episodes: list[TrainingEpisode]) -> str:
    """A line for each episode; numbers are exact, so that reading them back gives the same ones."""
    text = io.StringIO()
    terms = list(episodes[0].summary.terms) if episodes else REWARD_TERMS
    names = [name if name in REWARD_TERMS else _REWARD + name for name in terms]
    names += list(episodes[0].diagnostics) if episodes else []
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["episode", "world_seed", "ending", "steps", "non_safe_steps", *_NUMBERS, "return", *names])
    for e in episodes:
        s = e.summary
        numbers = [getattr(s, name) for name in _NUMBERS]
        numbers += [s.episode_return, *(s.terms[name] for name in terms), *e.diagnostics.values()]
        row = [e.episode, s.world_seed, s.ending, s.steps, s.non_safe_steps, *(repr(float(n)) for n in numbers)]
        writer.writerow(row)
    return text.getvalue()


def _read_csv(path: Path) -> list[TrainingEpisode]:
    known = {"episode", "world_seed", "ending", "steps", "non_safe_steps", *_NUMBERS, "return"}
    try:
        with plain_file(path).open(encoding="utf-8-sig", newline="") as file:
            rows = csv.DictReader(file)
            others = [name for name in rows.fieldnames or () if name not in known]
            terms = [name for name in others if name in REWARD_TERMS or name.startswith(_REWARD)]
            return [_episode(row, terms, [name for name in others if name not in terms]) for row in rows]
    except (OSError, KeyError, ValueError, TypeError, csv.Error) as error:
        raise UserError(f"{path}: damaged or missing ({error}); the run cannot be gone on with") from None


def _read_evaluations(path: Path, episodes: int, every: int | None) -> list[Evaluation]:
    """Reads the evaluations that were made in so many episodes.

    Raises:
        UserError: If one is missing or damaged.
    """
    done = range(every, episodes + 1, every) if every else ()
    if not done:
        return []
    try:
        with plain_file(path).open(encoding="utf-8-sig", newline="") as file:
            rows = [Evaluation(**{name: int(value) for name, value in row.items()}) for row in csv.DictReader(file)]
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise UserError(f"{path}: damaged or missing ({error}); the run cannot be gone on with") from None
    if [one.episodes for one in rows[: len(done)]] != list(done) or any(one.worlds < 1 for one in rows):
        raise UserError(f"{path}: its evaluations are not those of {episodes} episodes; the run cannot be gone on with")
    return rows[: len(done)]


def _episode(row: dict[str, str], terms: list[str], diagnostics: list[str]) -> TrainingEpisode:
    numbers: dict[str, Any] = {name: float(row[name]) for name in _NUMBERS}
    summary = EpisodeSummary(
        world_seed=int(row["world_seed"]),
        ending=row["ending"],
        steps=int(row["steps"]),
        non_safe_steps=int(row["non_safe_steps"]),
        episode_return=float(row["return"]),
        terms={name.removeprefix(_REWARD): float(row[name]) for name in terms},
        **numbers,
    )
    return TrainingEpisode(int(row["episode"]), summary, {name: float(row[name]) for name in diagnostics})
