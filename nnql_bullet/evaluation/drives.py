"""Drives policies through worlds, in pieces of work."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from nnql_bullet import __version__
from nnql_bullet.agents.rules.random_turns import RandomTurnsOptions
from nnql_bullet.commands import flags
from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.parts import part_name
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.splits import BLOCK, SplitName, check_frozen, load_frozen, split_seeds
from nnql_bullet.experiment import Experiment
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.rollout import EpisodeSummary, run_episode, run_episodes
from nnql_bullet.run_config import Conditions, SimulatorName
from nnql_bullet.runs import load_policy
from nnql_bullet.sim.engines import PhysicsName
from nnql_bullet.text import shell_line
from nnql_bullet.worlds.layouts.random_boxes import RandomBoxes
from nnql_bullet.worlds.paths import Difficulty, difficulty
from nnql_bullet.worlds.source import World


@dataclass(frozen=True, slots=True)
class Tier:
    """Worlds of one file."""

    file: str
    """A shipped world or a TOML file."""
    name: str
    cover: float | None
    """Share of the arena under boxes, if the layout is of random boxes without patrols; else None."""
    seeds: range
    digests: tuple[str, ...]
    """Hashes of the worlds."""
    frozen: bool
    """Whether the check against the frozen worlds was possible; it passed then."""
    given: World | None = None
    """The world, if it was made in code."""

    @property
    def title(self) -> str:
        """Title for people."""
        return self.name if self.cover is None else f"{100 * self.cover:g} % cover"

    @property
    def world(self) -> str | World:
        """The value for a configuration's key `world`."""
        return self.given or self.file

    def block(self, first: int) -> range:
        """Returns the seeds of a piece of work that begins with world number `first` of the tier."""
        return self.seeds[first : first + BLOCK]

    def drawn(self, first: int) -> tuple[str, ...]:
        """Returns the seeds and hashes of the worlds of such a piece."""
        return *map(str, self.block(first)), *self.digests[first : first + BLOCK]


@dataclass(frozen=True, slots=True)
class Setting:
    """Split, simulator and conditions of an evaluation."""

    split: SplitName
    simulator: SimulatorName
    physics: PhysicsName
    conditions: Conditions | None = None
    """Conditions that replace each policy's own; None keeps those."""
    allow_impassable: bool = False
    """Whether worlds are taken as they are drawn, even if the vehicle is too wide for every path."""
    start: tuple[float, ...] | None = None
    """In place of each world's own: x, y [m] and, if given, yaw [rad], in the frame of its map."""
    target: tuple[float, ...] | None = None
    """In place of each world's own [m]."""

    @property
    def changes(self) -> dict[str, Any]:
        """Changes to a policy's configuration."""
        return {
            "simulator": self.simulator,
            "physics": self.physics,
            "conditions": self.conditions,
            "allow_impassable": self.allow_impassable,
            "start": self.start,
            "target": self.target,
        }

    @property
    def title(self) -> str:
        """Title for people."""
        where = "the kinematic model" if self.simulator == "kinematic" else f"{self.simulator}, {self.physics}"
        conditions = [self.conditions.title] if self.conditions else []
        return ", ".join((f"{self.split} worlds", where, *conditions))

    @property
    def flags(self) -> list[str]:
        """Flags of the setting on a command line, without the split."""
        physics = [] if self.simulator == "kinematic" else ["--physics", self.physics]
        impassable = ["--allow-impassable"] if self.allow_impassable else []
        changes = {"start": self.start, "target": self.target, "conditions": self.conditions}
        return ["--sim", self.simulator, *physics, *impassable, *flags(changes)]


def check_setting(policy: Policy, setting: Setting) -> None:
    """Checks an evaluation's setting before the drives, by making a simulator.

    Raises:
        UserError: If there is no such engine, or a condition is impossible.
    """
    own_world = {**setting.changes, "start": None, "target": None}
    load_policy(policy.source, own_world).experiment.simulator.close()


def distinct(seeds: range, experiment: Experiment, policies: Sequence[Policy]) -> range:
    """The seeds that give drives of their own: only the first where all worlds are the same and nothing is random."""
    noisy = experiment.config.conditions.sensor_noise > 0
    if noisy or any(policy.custom or policy.kind == RandomTurnsOptions.kind for policy in policies):
        return seeds
    first = experiment.world(seeds[0]).digest
    return seeds if any(experiment.world(seed).digest != first for seed in seeds[1:]) else seeds[:1]


def _cover_of(world: World) -> float | None:
    """The cover of a world that differs from the paper's in that alone; None for other kinds."""
    layout = world.layout
    alike = isinstance(layout, RandomBoxes) and replace(layout, cover=0.0) == RandomBoxes(
        kind="random_boxes", cover=0.0
    )
    return layout.cover if isinstance(layout, RandomBoxes) and alike and not world.patrols else None


def draw_tiers(
    given: Sequence[str | Path | World], setting: Setting, worlds: int, policies: Sequence[Policy]
) -> list[Tier]:
    """Draws and checks the first worlds of a split, of each kind; of a fixed world one, as all drives are the same.

    Args:
        given: Shipped worlds, files or worlds made in code.
        setting: The setting, with the split.
        worlds: Number of worlds of each kind.
        policies: The policies; the vehicle of the first gives the width of the free path.

    Raises:
        UserError: If a world is wrong or given twice, or is not the frozen one.
    """
    all_seeds, frozen, policy = split_seeds(setting.split, worlds), load_frozen(), policies[0]
    tiers: list[Tier] = []
    for one in given:
        file = one if isinstance(one, World) else str(one)
        experiment = load_policy(policy.source, {"world": file, **setting.changes}).experiment
        world = experiment.worlds
        if world.name in [tier.name for tier in tiers]:
            raise UserError(f"there are two worlds named '{world.name}'; give each once")
        named = "" if isinstance(file, World) else file
        as_frozen = not (setting.allow_impassable or setting.start or setting.target)
        checked = as_frozen and check_frozen(
            named, setting.split, worlds, policy.vehicle_width, experiment.world, frozen
        )
        seeds = distinct(all_seeds, experiment, policies)
        digests = tuple(experiment.world(seed).digest for seed in seeds)
        cover = _cover_of(world)
        code = file if isinstance(file, World) else None
        tiers.append(Tier(named or world.name, world.name, cover, seeds, digests, checked, code))
    return tiers


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
        where = self.setting.simulator, self.setting.physics, *flags({"conditions": self.setting.conditions})
        return part_name("drives", self.policy.fingerprint, *where, *self.tier.drawn(self.first))


def drive_tasks(policies: Sequence[Policy], tiers: Sequence[Tier], setting: Setting) -> list[DriveTask]:
    """Lists all drives, in pieces."""
    return [
        DriveTask(policy, tier, setting, first)
        for policy in policies
        for tier in tiers
        for first in range(0, len(tier.seeds), BLOCK)
    ]


def drive(task: DriveTask) -> list[EpisodeSummary]:
    """Drives through the worlds of a piece: in the kinematic model all at once, in contact physics one by one."""
    seeds = task.tier.block(task.first)
    if task.setting.simulator == "kinematic":
        experiment = _experiment(task.policy, task.tier.world, task.setting, len(seeds))
        with closing(experiment.new_simulator(workers=1)) as simulator:
            navigation = Navigation(simulator, experiment.config.task)
            return run_episodes(navigation, [experiment.world(seed) for seed in seeds], experiment.policy)
    experiment = _experiment(task.policy, task.tier.world, task.setting, 1)
    return run_episodes(experiment.navigation, [experiment.world(seed) for seed in seeds], experiment.policy)


class SurveyTask(_BlockTask):
    """Measurement of the difficulty of some worlds of a tier for the policy's vehicle."""

    @property
    def part(self) -> str:
        """See `parts.Piece`."""
        return part_name("survey", self.policy.vehicle_width, *self.tier.drawn(self.first))


def survey(task: SurveyTask) -> list[Difficulty]:
    """Measures the difficulty of each world of a piece."""
    experiment = _experiment(task.policy, task.tier.world, task.setting, 1)
    seeds = task.tier.block(task.first)
    return [difficulty(experiment.world(seed), experiment.vehicle.width) for seed in seeds]


def survey_tasks(policy: Policy, tiers: Sequence[Tier], setting: Setting) -> list[SurveyTask]:
    """Lists the measurements of all worlds, in pieces."""
    return [SurveyTask(policy, tier, setting, first) for tier in tiers for first in range(0, len(tier.seeds), BLOCK)]


@dataclass(frozen=True, slots=True)
class FilmTask:
    """A drive to repeat and record; the repetition is equal bit for bit."""

    policy: Policy
    tier: Tier
    setting: Setting
    seed: int
    """Seed of the world."""

    @property
    def name(self) -> str:
        """Name of the recording's file."""
        return f"{self.policy.name.replace('/', '_')}-{self.tier.name}-{self.seed}.npz"

    @property
    def replay(self) -> str:
        """Command line that repeats the drive."""
        where = ["--world", self.tier.file, "--seed", str(self.seed)]
        shield = ["--shield"] if self.policy.shielded else []
        return shell_line("nnql-bullet", "drive", self.policy.path, *where, *shield, *self.setting.flags)


def film(task: FilmTask) -> Recording:
    """Repeats and records a drive."""
    experiment = _experiment(task.policy, task.tier.world, task.setting, 1)
    recorder = Recorder(experiment.vehicle)
    run_episode(experiment.navigation, experiment.world(task.seed), experiment.policy, watcher=recorder)
    config = experiment.config
    return recorder.recording(
        policy=task.policy.name, simulator=config.simulator, physics=config.physics, version=__version__
    )


@lru_cache(maxsize=4)  # so that a worker does not make a new simulator for every piece
def _experiment(policy: Policy, world: str | World, setting: Setting, vehicles: int) -> Experiment:
    changes = {"world": world, "vehicles": vehicles, **setting.changes, **policy.changes}
    return load_policy(policy.source, changes).experiment
