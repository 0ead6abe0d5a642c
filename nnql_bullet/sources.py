"""The files that a run or an evaluation is made of: its folder keeps what they say, so that it can go anywhere.

`sources.json` has the worlds that were files, by the names that they were given by, and names the copy of the robot's
description in `robot/`, unless that is a shipped one. A policy that a training began from is copied, shipped or not.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from nnql_bullet.config import dotted, options, read_toml, to_values
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, plain_file, read_json, write_atomically, write_text
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.training.checkpoint import policy_file
from nnql_bullet.vehicle.urdf import collision_meshes, load_vehicle
from nnql_bullet.worlds.source import World

SOURCES, ROBOT, START = "sources.json", "robot", "start.safetensors"
NAMED, LONGEST = 3, 40
"""Most values that a difference names, and the longest text of a value in it."""
_log = logging.getLogger(__name__)


@options
class Sources:
    """What files said when a run began or an evaluation was made."""

    worlds: dict[str, World]
    """Worlds by the names of their files."""
    robots: dict[str, str]
    """Copies in the folder by the names of the robot's files."""
    start: dict[str, str] = field(default_factory=dict)
    """SHA-256 of the policy that a training began from by the name that it was given by; START is its copy."""

    def robot(self, name: str | None, folder: Path) -> str | None:
        """Returns the path of the copy of a robot in their folder; None if there is none."""
        return str(folder / self.robots[name]) if name in self.robots else None


def keep_sources(config: RunConfig, folder: Path) -> None:
    """Writes what the files of a configuration say into a run folder; see `keep_files`."""
    keep_files(_named_worlds(config), config.robot, folder, config.start_from)


def keep_files(worlds: Sequence[str], robot: str | None, folder: Path, start: str | None = None) -> None:
    """Writes what the files of worlds, of a robot and of a policy to start from say into a folder, if there are any.

    Raises:
        UserError: If a file cannot be read.
        OSError: If one cannot be written.
    """
    kept = {name: to_values(World.load(name)) for name in dict.fromkeys(worlds) if is_file(name)}
    robots = {robot: _copied(robot, folder / ROBOT)} if robot and is_file(robot) else {}
    said: dict[str, Any] = {"worlds": kept, "robots": robots}
    if start is not None:
        weights = _policy_bytes(start)
        write_atomically(folder / START, partial(Path.write_bytes, data=weights))
        said["start"] = {start: sha256(weights).hexdigest()}
    if any(said.values()):
        write_text(folder / SOURCES, json.dumps(said, indent=1, sort_keys=True) + "\n")


def _copied(robot: str, folder: Path) -> str:
    """Copies the files of a robot that it drives by, and returns the name of the copy of its description.

    A mesh that is elsewhere than below the description is copied to where it is looked for.
    """
    description, vehicle = Path(robot), load_vehicle(robot)
    copies = {folder / file.relative_to(description.parent): file for file in (description, vehicle.urdf)}
    beside = folder / vehicle.urdf.relative_to(description.parent).parent
    for name, mesh in collision_meshes(vehicle.urdf).items():
        inside = Path(name.rpartition("://")[2])
        if not inside.is_absolute() and ".." not in inside.parts:
            copies[beside / inside] = mesh
    for copy, file in copies.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(copy, partial(Path.write_bytes, data=file.read_bytes()))
    if load_vehicle(folder / description.name).digest != vehicle.digest:
        _log.warning(
            "%s: its meshes cannot be kept with what is made of it; leave them where they are, or put them below the "
            "folder of this file",
            robot,
        )
    return f"{ROBOT}/{description.name}"


def files_digest(config: RunConfig, worlds: Sequence[str] = ()) -> str:
    """Hashes what the files of worlds, robot and start say that a configuration names, those that are shipped too.

    Args:
        config: The configuration.
        worlds: Further worlds.

    Raises:
        UserError: If a file cannot be read.
        OSError: If that of the start cannot be read.
    """
    worlds_said = [to_values(World.load(name)) for name in _named_worlds(config, worlds)]
    start = None if config.start_from is None else sha256(_policy_bytes(config.start_from)).hexdigest()
    said = load_vehicle(config.robot).digest, worlds_said, start
    return sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:16]


def located(config: RunConfig, folder: Path) -> RunConfig:
    """A configuration with what its run folder keeps in place of the names of files.

    Raises:
        UserError: If what it keeps is damaged.
    """
    sources = read_sources(folder)
    robot = sources.robot(config.robot, folder)
    changes: dict[str, Any] = {"robot": robot, "training": {}}
    changes["world"] = _kept(config.world, sources)
    changes["training"]["worlds"] = [_kept(world, sources) for world in config.training.worlds]
    if config.training.evaluate_worlds:
        evaluated = [_kept(world, sources) for world in config.training.evaluate_worlds]
        changes["training"]["evaluate_worlds"] = evaluated
    if config.training.selection:
        selection = [_kept(world, sources) for world in config.training.selection.worlds]
        changes["training"]["selection"] = {"worlds": selection}
    changes["start_from"] = str(folder / START) if config.start_from in sources.start else None
    return changed(config, **changes) if sources.worlds or robot or sources.start else config


def changed_sources(folder: Path) -> dict[str, str]:
    """Finds files that say something else than what a folder keeps, and what differs.

    One that is gone does not matter, nor one never read.
    """
    return changed_worlds(folder) | changed_robots(folder) | _changed_start(folder)


def changed_worlds(folder: Path) -> dict[str, str]:
    """Finds such files of worlds."""
    found = {}
    for name, world in read_sources(folder).worlds.items():
        if is_file(name):
            try:
                now = World.load(name)
            except UserError as error:
                found[name] = f"it cannot be read: {error}"
            else:
                found |= {name: _difference(to_values(now), to_values(world))} if now != world else {}
    return found


def changed_robots(folder: Path) -> dict[str, str]:
    """Finds such files of robots."""
    found = {}
    for name, kept in read_sources(folder).robots.items():
        for copy in sorted(path for path in (folder / kept).parent.rglob("*") if path.is_file()):
            file = Path(name).parent / copy.relative_to(folder / ROBOT)
            if is_file(file) and file.read_bytes() != copy.read_bytes():
                toml = copy.suffix == ".toml"
                found[str(file)] = _difference(read_toml(file), read_toml(copy)) if toml else "its text differs"
    return found


def _changed_start(folder: Path) -> dict[str, str]:
    """Finds such a file of the policy that a training began from."""
    found: dict[str, str] = {}
    for name, digest in read_sources(folder).start.items():
        with suppress(UserError, OSError):
            found |= {name: "its weights differ"} if sha256(_policy_bytes(name)).hexdigest() != digest else {}
    return found


def _policy_bytes(policy: str) -> bytes:
    """Reads the file of a policy, as it is.

    Raises:
        UserError: If there is none.
        OSError: If it cannot be read.
    """
    return plain_file(policy_file(policy)).read_bytes()


def _difference(now: Mapping[str, Any], then: Mapping[str, Any]) -> str:
    """Says which values differ, and how."""
    news, olds = dotted(now), dotted(then)
    keys = [key for key in sorted(news.keys() | olds.keys()) if news.get(key) != olds.get(key)]
    texts = [f"{key} was {_short(olds.get(key))}, is {_short(news.get(key))}" for key in keys[:NAMED]]
    more = [f"{len(keys) - NAMED} more"] if len(keys) > NAMED else []
    return "; ".join((*texts, *more)) or "its text differs"


def _short(value: object) -> str:
    text = "not set" if value is None else json.dumps(value, default=str)
    return text if len(text) <= LONGEST else "another list" if isinstance(value, list) else f"{text[:LONGEST]}..."


def read_sources(folder: Path) -> Sources:
    """Reads what a folder keeps of files.

    Raises:
        UserError: If it is damaged.
    """
    if not is_file(folder / SOURCES):
        return Sources(worlds={}, robots={})
    try:
        sources = TypeAdapter(Sources).validate_json(json.dumps(read_json(folder / SOURCES)))
    except ValidationError:
        raise UserError(f"{folder / SOURCES}: damaged; make its folder anew") from None
    if any(copy != f"{ROBOT}/{Path(name).name}" for name, copy in sources.robots.items()):
        raise UserError(f"{folder / SOURCES}: damaged: copies of robots are in {ROBOT}/; make its folder anew")
    return sources


def _named_worlds(config: RunConfig, worlds: Sequence[str] = ()) -> list[str]:
    training = config.training
    selection = training.selection.worlds if training.selection else ()
    named = (config.world, *training.worlds, *selection, *(training.evaluate_worlds or ()), *worlds)
    return [name for name in dict.fromkeys(named) if isinstance(name, str)]


def _kept(world: str | World, sources: Sources) -> Any:
    found = sources.worlds.get(world) if isinstance(world, str) else world
    return to_values(found) if found else world
