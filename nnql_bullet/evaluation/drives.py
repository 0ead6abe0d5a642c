"""Drives policies through worlds, in pieces of work."""

import logging
import os
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from nnql_bullet import assets
from nnql_bullet.agents.rules.random_turns import RandomTurnsOptions
from nnql_bullet.commands import flags
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.parts import part_name
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.splits import BLOCK, Draws, check_frozen, load_frozen
from nnql_bullet.experiment import Experiment
from nnql_bullet.files import is_file, real
from nnql_bullet.planning.planner import PlanOptions
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.rollout import EpisodeSummary, run_episode, run_episodes
from nnql_bullet.runs import load_policy
from nnql_bullet.setting import Setting
from nnql_bullet.text import shell_line
from nnql_bullet.worlds.importers import READERS
from nnql_bullet.worlds.layouts.random_boxes import RandomBoxes
from nnql_bullet.worlds.paths import Difficulty, difficulty
from nnql_bullet.worlds.source import World
from nnql_bullet.worlds.spec import WorldSpec

_log = logging.getLogger(__name__)

MOST_KEPT = 400
"""Number of drawn worlds that a process keeps: reading the files of others takes longer than to drive through them."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A world of a tier."""

    file: str
    """A shipped world or a TOML file; the name of one made in code."""
    seed: int
    digest: str
    """Its hash."""


_kept: OrderedDict[tuple[Drawn, PlanOptions | None], WorldSpec] = OrderedDict()
"""Worlds that this process has drawn, the last used at the end; their hashes say that they are the same."""


@dataclass(frozen=True, slots=True)
class Refused:
    """A world file that nothing drives through."""

    file: str
    reason: str
    """What is wrong with it, in one line."""


@dataclass(frozen=True, slots=True)
class WorldFiles:
    """World files that are counted together."""

    name: str
    files: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Tier:
    """Worlds that are counted together: of one file, or of the files of a folder."""

    file: str
    """A shipped world, a TOML file or a folder."""
    name: str
    cover: float | None
    """Share of the arena under boxes, if the layout is of random boxes without patrols; else None."""
    worlds: tuple[Drawn, ...]
    frozen: bool
    """Whether the check against the frozen worlds was possible; it passed then."""
    given: tuple[tuple[str, World], ...] = ()
    """Worlds in place of what files say, by the names of the files: made in code, or kept by an earlier evaluation."""

    @property
    def title(self) -> str:
        """Title for people."""
        return self.name if self.cover is None else f"{100 * self.cover:g} % cover"

    @property
    def is_folder(self) -> bool:
        """Whether its worlds are of the files of a folder."""
        return any(world.file != self.file for world in self.worlds)

    def kind(self, world: Drawn) -> str | World:
        """Returns the value of a configuration's key `world` for a world of the tier."""
        return dict(self.given).get(world.file, world.file)

    def block(self, first: int) -> tuple[Drawn, ...]:
        """Returns the worlds of a piece of work that begins with world number `first` of the tier."""
        return self.worlds[first : first + BLOCK]

    def part(self, first: int) -> tuple[str, ...]:
        """Returns the seeds and hashes of the worlds of such a piece."""
        block = self.block(first)
        return *(str(world.seed) for world in block), *(world.digest for world in block)


def check_setting(policy: Policy, setting: Setting) -> str:
    """Checks an evaluation's setting before the drives, by making a simulator; returns the robot that will drive.

    Raises:
        UserError: If there is no such engine, or a condition is impossible.
    """
    experiment = load_policy(policy.source, policy.own(setting).changes).experiment
    experiment.simulator.close()
    return experiment.config.robot


def has_chance(policy: Policy, changes: Mapping[str, Any]) -> bool:
    """Whether drives of a policy through one and the same world may differ.

    Args:
        policy: The policy; an object of the caller's own may do anything.
        changes: Changes to its configuration.
    """
    noisy = load_policy(policy.source, changes).experiment.config.conditions.sensor_noise > 0
    return noisy or policy.custom is not None or policy.kind == RandomTurnsOptions.kind


def distinct(experiment: Experiment, kind: World, seeds: range, chance: bool) -> dict[int, str]:
    """Draws the worlds of those seeds that give drives of their own.

    Args:
        experiment: Draws the worlds.
        kind: The kind of worlds.
        seeds: The seeds.
        chance: Whether drives through the same world may differ.

    Returns:
        The hashes of worlds by seed; only the first where all worlds are the same and nothing is random.

    Raises:
        UserError: If a world cannot be drawn.
    """
    drawn = seeds if kind.is_random else seeds[:1]
    digests = {seed: experiment.draw(kind, seed).digest for seed in drawn}
    first = digests[seeds[0]]
    if chance:
        return dict.fromkeys(seeds, first) | digests
    return {seeds[0]: first} if set(digests.values()) == {first} else digests


def _cover_of(world: World) -> float | None:
    """The cover of a world that differs from the paper's in that alone; None for other kinds."""
    layout = world.layout
    alike = isinstance(layout, RandomBoxes) and replace(layout, cover=0.0) == RandomBoxes(
        kind="random_boxes", cover=0.0
    )
    return layout.cover if isinstance(layout, RandomBoxes) and alike and not world.patrols else None


def draw_tiers(
    given: Sequence[str | Path | World | WorldFiles], draws: Draws, setting: Setting, policies: Sequence[Policy]
) -> tuple[list[Tier], list[Refused]]:
    """Draws and checks worlds of each kind; of a fixed world one, as all drives are the same.

    Args:
        given: Shipped worlds, files, folders of files, files that are counted together, or worlds made in code.
        draws: Which worlds of each kind.
        setting: The setting.
        policies: The policies; the vehicle of the first gives the width of the free path.

    Returns:
        The tiers, each with a world at least, and the files that are wrong or have a world that cannot be drawn.

    Raises:
        UserError: If there is no such world, one is given twice or is not the frozen one, or all files are refused.
    """
    chance = any([has_chance(policy, policy.own(setting).changes) for policy in policies])
    tiers: list[Tier] = []
    refused: list[Refused] = []
    errors: list[UserError] = []
    for one in [str(one) if isinstance(one, str | Path) else one for one in given]:
        files = _files(one)
        worlds: list[Drawn] = []
        experiment: Experiment | None = None
        for file in files:
            shown = file.name if isinstance(file, World) else file
            try:
                experiment = experiment or _experiment_of(policies[0], file, setting)
                kind = experiment.kind(file)
                digests = distinct(experiment, kind, draws.seeds, chance)
            except UserError as error:
                refused.append(Refused(shown, str(error).removeprefix(f"{shown}: ")))
                errors.append(error)
            else:
                worlds += [Drawn(shown, seed, digest) for seed, digest in digests.items()]
        if experiment is None or not worlds:
            continue
        hopeless = experiment.out_of_reach(kind)
        if hopeless:
            _log.warning("%s: %s", policies[0].name, hopeless)
        of_folder = files != [one]
        name = kind.name
        if of_folder:
            name = one.name if isinstance(one, WorldFiles) else real(Path(str(one))).name
        if name in [tier.name for tier in tiers]:
            raise UserError(f"there are two worlds named '{name}'; give each once")
        checked = (
            not (setting.allow_impassable or any(setting.ends.values()))
            and draws.split is not None
            and isinstance(one, str)
            and check_frozen(
                *(one, draws.split, len(draws.seeds), policies[0].vehicle_width),
                partial(kind.draw, vehicle_width=policies[0].vehicle_width),  # a plan only turns the vehicle
                load_frozen(),
            )
        )
        cover = None if of_folder else _cover_of(kind)
        shown = one if isinstance(one, str) else one.name
        code = ((shown, one),) if isinstance(one, World) else ()
        tiers.append(Tier(shown, name, cover, tuple(worlds), checked, code))
    if not tiers:
        if len(errors) == 1:
            raise errors[0]
        raise UserError(f"all {len(refused)} worlds are refused; the first, {refused[0].file}: {refused[0].reason}")
    return tiers, refused


def _files(given: str | World | WorldFiles) -> Sequence[str | World]:
    """The world files of a folder in the order of their names, files that are given; any other world as it is.

    Raises:
        UserError: If there is no such world, or a folder has none.
    """
    if isinstance(given, World):
        return [given]
    if isinstance(given, WorldFiles):
        return given.files
    if not os.path.isdir(given) or is_file(assets.folder("worlds") / f"{given}.toml"):
        assets.find("worlds", given)
        return [given]
    suffixes = (".toml", *READERS)
    files = sorted(path for path in Path(given).glob("[!.]*") if path.suffix.lower() in suffixes and is_file(path))
    if not files:
        raise UserError(f"{given}: is a folder without worlds; give another one")
    return [str(path) for path in files]


@dataclass(frozen=True, slots=True)
class _BlockTask:
    """A piece of work: one policy, and some worlds of a tier."""

    policy: Policy
    tier: Tier
    setting: Setting
    first: int
    """Number of the first world in the tier."""

    @property
    def size(self) -> int:
        """Number of worlds."""
        return len(self.tier.block(self.first))


class DriveTask(_BlockTask):
    """Drives of one policy through some worlds of a tier."""

    @property
    def part(self) -> str:
        """See `parts.Piece`."""
        if self.policy.custom:
            return ""
        policy, setting = self.policy, self.policy.own(self.setting)
        where = setting.simulator, setting.physics, *flags({"conditions": setting.conditions})
        how = (
            policy.vehicle,
            *(["plan"] if setting.plan else []),
            *(its for its in setting.keys if its[0] != "robot"),
        )
        return part_name(__name__, "drives", policy.fingerprint, *how, *where, *self.tier.part(self.first))


def drive_tasks(policies: Sequence[Policy], tiers: Sequence[Tier], setting: Setting) -> list[DriveTask]:
    """Lists all drives, in pieces."""
    return [
        DriveTask(policy, tier, setting, first)
        for policy in policies
        for tier in tiers
        for first in range(0, len(tier.worlds), BLOCK)
    ]


def drive(task: DriveTask) -> list[EpisodeSummary]:
    """Drives through the worlds of a piece: in the kinematic model all at once, in contact physics one by one."""
    if task.setting.simulator == "kinematic":
        experiment = _experiment(task.policy, task.tier, task.setting, task.size)
        with closing(experiment.new_simulator(workers=1)) as simulator:
            navigation = experiment.new_navigation(simulator)
            return run_episodes(navigation, _drawn(experiment, task), experiment.policy)
    experiment = _experiment(task.policy, task.tier, task.setting, 1)
    return run_episodes(experiment.navigation, _drawn(experiment, task), experiment.policy)


def _drawn(experiment: Experiment, task: _BlockTask) -> list[WorldSpec]:
    """Draws the worlds of a piece, or takes them as this process has drawn them before."""
    plan = experiment.config.plan  # which turns the vehicle at its start
    keys = [(world, plan) for world in task.tier.block(task.first)]
    new = [world for world, _ in keys if (world, plan) not in _kept]
    kinds = {world.file: experiment.kind(task.tier.kind(world)) for world in new}
    drawn = {key: _kept[key] for key in keys if key in _kept}
    drawn |= {(world, plan): experiment.draw(kinds[world.file], world.seed) for world in new}
    for key in keys:
        _kept[key] = drawn[key]
        _kept.move_to_end(key)
    while len(_kept) > MOST_KEPT:
        _kept.popitem(last=False)
    return [drawn[key] for key in keys]


class SurveyTask(_BlockTask):
    """Measurement of the difficulty of some worlds of a tier for the policy's vehicle."""

    @property
    def part(self) -> str:
        """See `parts.Piece`."""
        return part_name(__name__, "survey", self.policy.vehicle_width, *self.tier.part(self.first))


def survey(task: SurveyTask) -> list[Difficulty]:
    """Measures the difficulty of each world of a piece."""
    experiment = _experiment(task.policy, task.tier, task.setting, 1)
    return [difficulty(world, experiment.vehicle.width) for world in _drawn(experiment, task)]


def survey_tasks(policy: Policy, tiers: Sequence[Tier], setting: Setting) -> list[SurveyTask]:
    """Lists the measurements of all worlds, in pieces."""
    return [SurveyTask(policy, tier, setting, first) for tier in tiers for first in range(0, len(tier.worlds), BLOCK)]


@dataclass(frozen=True, slots=True)
class FilmTask:
    """A drive to repeat and record; the repetition is equal bit for bit."""

    policy: Policy
    tier: Tier
    setting: Setting
    world: Drawn

    @property
    def where(self) -> str:
        """Kind, file of a folder and seed of the world, for people."""
        stem = (Path(self.world.file).stem,) if self.tier.is_folder else ()
        return ", ".join((self.tier.title, *stem, f"seed {self.world.seed}"))

    @property
    def name(self) -> str:
        """Name of the recording's file."""
        stem = (Path(self.world.file).stem,) if self.tier.is_folder else ()
        return "-".join((self.policy.name.replace("/", "_"), self.tier.name, *stem, f"{self.world.seed}.npz"))

    @property
    def replay(self) -> str:
        """Command line that repeats the drive."""
        where = ["--world", self.world.file, "--seed", str(self.world.seed)]
        return shell_line("nnql-bullet", "drive", self.policy.path, *where, *self.policy.own(self.setting).flags)


def film(task: FilmTask) -> Recording:
    """Repeats and records a drive."""
    experiment = _experiment(task.policy, task.tier, task.setting, 1)
    world = experiment.draw(experiment.kind(task.tier.kind(task.world)), task.world.seed)
    recorder = Recorder(experiment.vehicle)
    run_episode(experiment.navigation, world, experiment.policy, watcher=recorder)
    config = experiment.config
    return recorder.recording(
        policy=task.policy.name, simulator=config.simulator, physics=config.physics, made_by=made_by()
    )


@lru_cache(maxsize=4)  # so that a worker does not make a new simulator for every piece
def _experiment(policy: Policy, tier: Tier, setting: Setting, vehicles: int) -> Experiment:
    return _experiment_of(policy, tier.kind(tier.worlds[0]), setting, vehicles)


def _experiment_of(policy: Policy, world: str | World, setting: Setting, vehicles: int = 1) -> Experiment:
    changes = {"world": world, "vehicles": vehicles, **setting.ends, **policy.own(setting).changes}
    return load_policy(policy.source, changes).experiment
