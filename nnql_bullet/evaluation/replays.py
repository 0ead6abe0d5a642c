"""Finds the failed drives of an evaluation, from its results, and repeats them."""

import csv
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nnql_bullet.config import parse
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.drives import Drawn, FilmTask, Tier, film
from nnql_bullet.evaluation.failures import GROUPS, Features, Group, features, group
from nnql_bullet.evaluation.metrics import Evaluation
from nnql_bullet.evaluation.policies import Policy, open_policies
from nnql_bullet.files import is_file, plain_file, read_json
from nnql_bullet.recording import Recording
from nnql_bullet.run_config import Conditions, frozen_keys
from nnql_bullet.setting import Setting
from nnql_bullet.sources import read_sources
from nnql_bullet.text import shell_line
from nnql_bullet.worlds.waypoints import as_waypoints


@dataclass(frozen=True, slots=True)
class FailedDrive:
    """A drive of an evaluation that did not reach its target."""

    film: FilmTask
    ending: str
    steps: int

    @property
    def seed(self) -> int:
        """Seed of the world."""
        return self.film.world.seed

    @property
    def place(self) -> tuple[str, str]:
        """Method and kind of world."""
        return self.film.policy.method, self.film.tier.name

    @property
    def title(self) -> str:
        """Title for people."""
        return f"{self.film.policy.name} in {self.film.where}"


@dataclass(frozen=True, slots=True)
class FinishedEvaluation:
    """The command of an evaluation, and its failed drives."""

    command: str
    """Command line that repeats the evaluation, without the folder."""
    failed: list[FailedDrive]
    """Failed drives in the order of policies, worlds and seeds."""


def open_evaluation(folder: Path) -> FinishedEvaluation:
    """Reads an evaluation from its folder.

    Raises:
        UserError: If there is none, or its files are damaged.
    """
    if not is_file(folder / "results.json"):
        raise UserError(
            f"{folder}: holds no evaluation; make one: nnql-bullet evaluate RUN ... --out {shell_line(str(folder))}"
        )
    try:
        values = read_json(folder / "results.json")
        conditions = None if values["conditions"] is None else parse(Conditions, values["conditions"], "conditions")
        impassable = bool(values.get("allow_impassable", False))
        start, target = (
            None if values.get(name) is None else tuple(map(float, values[name])) for name in ("start", "target")
        )
        places = values.get("waypoints")
        waypoints, plan = None if places is None else as_waypoints(places), bool(values.get("plan", False))
        sources, keys = read_sources(folder), values.get("keys", {})
        robot = sources.robot(keys.get("robot"), folder)
        keys = frozen_keys(keys | ({"robot": robot} if robot else {}))
        where = values["simulator"], values["physics"], conditions, impassable
        setting = Setting(*where, start, target, waypoints, plan, keys)
        policies = {policy["name"]: Policy(**policy) for policy in values["policies"]}
        tiers = {
            tier["name"]: Tier(
                file=tier["file"],
                name=tier["name"],
                cover=tier["cover"],
                worlds=tuple(
                    Drawn(world.get("file", tier["file"]), world["seed"], world["digest"]) for world in tier["worlds"]
                ),
                frozen=tier["frozen"],
                given=tuple((file, its) for file, its in sources.worlds.items() if file in _files(tier)),
            )
            for tier in values["tiers"]
        }
        with plain_file(folder / "episodes.csv").open(encoding="utf-8-sig", newline="") as file:
            failed = []
            for row in csv.DictReader(file):
                if row["ending"] != "goal":
                    tier = tiers[row["world"]]
                    place = row.get("file", tier.file), int(row["world_seed"])
                    (world,) = [its for its in tier.worlds if (its.file, its.seed) == place]
                    task = FilmTask(policies[row["policy"]], tier, setting, world)
                    failed.append(FailedDrive(task, row["ending"], int(row["steps"])))
        return FinishedEvaluation(values["command"], failed)
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, csv.Error) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise UserError(f"{folder}: results are damaged ({reason}); make them again: nnql-bullet evaluate") from None


def _files(tier: Mapping[str, Any]) -> set[str]:
    return {world.get("file", tier["file"]) for world in tier["worlds"]}


def finished(evaluation: Evaluation) -> FinishedEvaluation:
    """Lists the failed drives of an evaluation."""
    failed = [
        FailedDrive(FilmTask(policy, tier, evaluation.setting, world), one.ending, one.steps)
        for policy in evaluation.policies
        for tier in evaluation.tiers
        for world, one in zip(tier.worlds, evaluation.drives[policy.name, tier.name], strict=True)
        if one.ending != "goal"
    ]
    return FinishedEvaluation(evaluation.command, failed)


def earlier_alike(keys: Iterable[Hashable]) -> list[int]:
    """Counts for each key the equal keys before it."""
    seen: Counter[Hashable] = Counter()
    found = []
    for key in keys:
        found.append(seen[key])
        seen[key] += 1
    return found


def choose(failed: Sequence[FailedDrive], most: int) -> list[FailedDrive]:
    """Chooses at most `most` failed drives of each method in each kind of world.

    It takes the first of each policy, then the second of each policy, and so on.

    Returns:
        The chosen drives, in their order in `failed`.
    """
    ranks = earlier_alike((one.film.policy.name, one.film.tier.name) for one in failed)
    by_rank = sorted(range(len(failed)), key=lambda number: (ranks[number], number))
    before = earlier_alike(failed[number].place for number in by_rank)
    return [failed[number] for number in sorted(n for n, rank in zip(by_rank, before, strict=True) if rank < most)]


def check_policies(evaluation: FinishedEvaluation, failed: Sequence[FailedDrive]) -> None:
    """Checks that no policy has changed since the evaluation.

    Raises:
        UserError: If one has changed or cannot be read.
    """
    robots = {one.film.policy: one.film.setting.robot for one in failed}
    for policy in robots:
        (now,) = open_policies([policy.source], policy.shielded, robots[policy])[-1:]
        if now.fingerprint != policy.fingerprint:
            raise UserError(f"{policy.path}: is not what was evaluated; evaluate anew: {evaluation.command}")
        if policy.vehicle not in ("", now.vehicle):  # older evaluations do not say it
            raise UserError(
                f"the robot '{policy.robot}' is not what it was when {policy.path} was evaluated; put its files back, "
                f"or evaluate anew: {evaluation.command}"
            )


@dataclass(frozen=True, slots=True)
class Replay:
    """A repeated failed drive."""

    failed: FailedDrive
    ending: str
    """Ending of the repeated drive."""
    steps: int
    """Number of decisions in the repeated drive."""
    digest: str
    """Hash of the repeated drive's world."""
    features: Features
    recording: Recording

    @property
    def group(self) -> Group:
        """Group of the failure."""
        return group(self.features)


def replay(failed: FailedDrive) -> Replay:
    """Repeats a failed drive."""
    recording = film(failed.film)
    about = recording.about
    return Replay(
        failed, about["ending"], len(recording.action), about["world"]["digest"], features(recording), recording
    )


def check_replay(evaluation: FinishedEvaluation, replayed: Replay) -> None:
    """Checks that a repeated drive equals the one in the evaluation.

    Raises:
        UserError: If the drive or its world differs.
    """
    failed, again = replayed.failed, f"evaluate anew: {evaluation.command}"
    if replayed.digest != failed.film.world.digest:
        raise UserError(f"{failed.title}: its world is not what it was, the world file or program changed; {again}")
    if (replayed.ending, replayed.steps) != (failed.ending, failed.steps):
        raise UserError(
            f"{failed.title}: {failed.ending} after {failed.steps} decisions in the evaluation, but {replayed.ending} "
            f"after {replayed.steps} now; the program changed, so {again}"
        )


@dataclass(frozen=True, slots=True)
class Failures:
    """Repeated failures of an evaluation."""

    evaluation: FinishedEvaluation
    replays: Sequence[Replay]
    most: int
    """Largest number of replays of each method in each kind of world."""

    @property
    def groups(self) -> dict[Group, list[Replay]]:
        """Replays of each group that has any, in the order of `GROUPS`."""
        return {name: its for name in GROUPS if (its := [one for one in self.replays if one.group == name])}

    @property
    def places(self) -> list[tuple[str, str]]:
        """Methods and kinds of worlds with failures."""
        return list(dict.fromkeys(one.failed.place for one in self.replays))
