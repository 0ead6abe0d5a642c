"""The files that a run is made of: its folder keeps what they say, so that it can be driven anywhere.

`sources.json` has the worlds that were files, by the names that the configuration has for them, and names the copy of
the robot's description in `robot/`, unless that is a shipped one.
"""

import json
from collections.abc import Sequence
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from nnql_bullet.config import options, to_values
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, read_json, write_atomically, write_text
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.source import World

SOURCES, ROBOT = "sources.json", "robot"


@options
class Sources:
    """What files said when a run began."""

    worlds: dict[str, World]
    """Worlds by the names of their files in the configuration."""
    robots: dict[str, str]
    """Copies in the run folder by the names of the robot's files in the configuration."""


def keep_sources(config: RunConfig, folder: Path) -> None:
    """Writes what the files of a configuration say into a run folder; nothing if it names no file.

    Raises:
        UserError: If a file cannot be read.
        OSError: If one cannot be written.
    """
    worlds = {name: to_values(World.load(name)) for name in _world_files(config)}
    robots = {}
    if is_file(config.robot):
        description, urdf = Path(config.robot), load_vehicle(config.robot).urdf
        robots[config.robot] = f"{ROBOT}/{description.name}"
        for file in (description, urdf):
            copy = folder / ROBOT / file.relative_to(description.parent)
            copy.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(copy, partial(Path.write_bytes, data=file.read_bytes()))
    if worlds or robots:
        write_text(folder / SOURCES, json.dumps({"worlds": worlds, "robots": robots}, indent=1, sort_keys=True) + "\n")


def files_digest(config: RunConfig, worlds: Sequence[str] = ()) -> str:
    """Hashes what the files say that a configuration names, wherever they are; empty if it names none.

    Args:
        config: The configuration.
        worlds: Further worlds.

    Raises:
        UserError: If a file cannot be read.
    """
    said = [to_values(World.load(name)) for name in _world_files(config, worlds)]
    robot = load_vehicle(config.robot).digest if is_file(config.robot) else ""
    return sha256(json.dumps([robot, said], sort_keys=True).encode()).hexdigest()[:16] if said or robot else ""


def located(config: RunConfig, folder: Path) -> RunConfig:
    """A configuration with what its run folder keeps in place of the names of files.

    Raises:
        UserError: If what it keeps is damaged.
    """
    sources = _read(folder)
    robot = sources.robots.get(config.robot)
    changes: dict[str, Any] = {"robot": str(folder / robot) if robot else None, "training": {}}
    changes["world"] = _kept(config.world, sources)
    changes["training"]["worlds"] = [_kept(world, sources) for world in config.training.worlds]
    if config.training.selection:
        selection = [_kept(world, sources) for world in config.training.selection.worlds]
        changes["training"]["selection"] = {"worlds": selection}
    return changed(config, **changes) if sources.worlds or robot else config


def changed_sources(folder: Path) -> list[str]:
    """Files that say something else than when a run began; one that is gone does not matter, nor one never read."""
    sources, found = _read(folder), []
    for name, world in sources.worlds.items():
        try:
            found += [name] if is_file(name) and World.load(name) != world else []
        except UserError:
            found.append(name)
    for name, copy in sources.robots.items():
        pairs = [(Path(name).parent / file.relative_to(folder / ROBOT), file) for file in _files(folder / copy)]
        found += [str(file) for file, its in pairs if is_file(file) and file.read_bytes() != its.read_bytes()]
    return found


def _files(robot: Path) -> list[Path]:
    return sorted(path for path in robot.parent.rglob("*") if path.is_file())


def _read(folder: Path) -> Sources:
    if not is_file(folder / SOURCES):
        return Sources(worlds={}, robots={})
    try:
        sources = TypeAdapter(Sources).validate_json(json.dumps(read_json(folder / SOURCES)))
    except ValidationError:
        raise UserError(f"{folder / SOURCES}: damaged; train anew") from None
    if any(copy != f"{ROBOT}/{Path(name).name}" for name, copy in sources.robots.items()):
        raise UserError(f"{folder / SOURCES}: damaged: copies of robots are in {ROBOT}/; train anew")
    return sources


def _world_files(config: RunConfig, worlds: Sequence[str] = ()) -> list[str]:
    selection = config.training.selection
    named = (config.world, *config.training.worlds, *(selection.worlds if selection else ()), *worlds)
    return [name for name in dict.fromkeys(named) if isinstance(name, str) and is_file(name)]


def _kept(world: str | World, sources: Sources) -> Any:
    found = sources.worlds.get(world) if isinstance(world, str) else world
    return to_values(found) if found else world
