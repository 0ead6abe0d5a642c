"""The files that a run is made of: it keeps what they say, needs none of them, and tells when one changes."""

import hashlib
import json
from functools import partial
from pathlib import Path
from typing import Any

from nnql_bullet.config import to_values
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, read_json, write_atomically, write_text
from nnql_bullet.run_config import ROBOT, RunConfig, changed
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.source import World

SOURCES = "sources.json"
"""File of a run folder with hashes of the files that it was begun with."""


def kept(config: RunConfig) -> RunConfig:
    """The configuration with the worlds that are files written out in it.

    Raises:
        UserError: If a world cannot be read.
    """
    training = config.training
    changes: dict[str, Any] = {"world": _written_out(config.world), "training": {}}
    changes["training"]["worlds"] = [_written_out(world) for world in training.worlds]
    if training.selection:
        changes["training"]["selection"] = {"worlds": [_written_out(world) for world in training.selection.worlds]}
    return changed(config, **changes)


def _written_out(world: str | World) -> Any:
    return to_values(World.load(world)) if isinstance(world, World) or is_file(world) else world


def keep_robot(config: RunConfig, folder: Path) -> None:
    """Copies the TOML and URDF of a robot that is not shipped into a run folder.

    Raises:
        UserError: If the robot cannot be read.
    """
    if not is_file(config.robot):
        return
    description, urdf = Path(config.robot), load_vehicle(config.robot).urdf
    copies = {folder / ROBOT / file.relative_to(description.parent): file.read_bytes() for file in (description, urdf)}
    for copy, content in copies.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(copy, partial(Path.write_bytes, data=content))


def portable(config: RunConfig) -> dict[str, Any]:
    """The values of a configuration, with the copy of its robot as seen from the run folder; see `located`."""
    values = to_values(config)
    if is_file(config.robot):
        values["robot"] = f"{ROBOT}/{Path(config.robot).name}"
    return values


def note_sources(config: RunConfig, folder: Path) -> None:
    """Writes hashes of the files that a configuration names into a run folder."""
    found = {str(Path(name).resolve()): _digest(name) for name in _files(config)}
    if found:
        write_text(folder / SOURCES, json.dumps(found, indent=1, sort_keys=True) + "\n")


def changed_sources(folder: Path) -> list[str]:
    """The files that a run was begun with and that say something else now; one that is gone does not matter.

    Raises:
        UserError: If the hashes are damaged.
    """
    if not is_file(folder / SOURCES):
        return []
    hashes = read_json(folder / SOURCES)
    if not isinstance(hashes, dict):
        raise UserError(f"{folder / SOURCES}: damaged; delete it")
    return [name for name, digest in hashes.items() if is_file(name) and _digest(name) != digest]


def _files(config: RunConfig) -> list[str]:
    selection = config.training.selection
    named = (config.robot, config.world, *config.training.worlds, *(selection.worlds if selection else ()))
    return [name for name in dict.fromkeys(named) if isinstance(name, str) and is_file(name)]


def _digest(name: str) -> str:
    """Hash of what a file says, with the files that it names; empty if it cannot be read."""
    try:
        text = json.dumps(to_values(World.load(name)), sort_keys=True)
    except UserError:
        try:
            text = Path(name).read_text(encoding="utf-8-sig") + load_vehicle(name).urdf.read_text(encoding="utf-8-sig")
        except (UserError, OSError, UnicodeDecodeError):
            return ""
    return hashlib.sha256(text.encode()).hexdigest()
