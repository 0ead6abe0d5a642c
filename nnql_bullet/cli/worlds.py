"""`nnql-bullet worlds`."""

import re
from collections.abc import Mapping
from json import dumps
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import tyro

from nnql_bullet.api import worlds as api
from nnql_bullet.cli.console import complain, say
from nnql_bullet.cli.flags import KeyFlags
from nnql_bullet.cli.shared import Place
from nnql_bullet.errors import UserError
from nnql_bullet.reports.tables import text_table
from nnql_bullet.worlds.exporters import CELL
from nnql_bullet.worlds.exporters.toml import write_world
from nnql_bullet.worlds.importers import READERS, Reading

SHOWN = 10
"""Most lines about what is left out of a world."""


def worlds(
    action: Annotated[Literal["list", "show", "import", "export"], tyro.conf.arg(metavar="list|show|import|export")],
    what: Annotated[Path | None, tyro.conf.arg(metavar="NAME|FILE|FOLDER")] = None,
    /,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE|FOLDER")] = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    robot: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    start: Annotated[Place, tyro.conf.arg(metavar="X,Y[,YAW]")] = None,
    target: Annotated[Place, tyro.conf.arg(metavar="X,Y")] = None,
    resolution: Annotated[float, tyro.conf.arg(metavar="X")] = CELL,
    json: bool = False,
    options: Annotated[Mapping[str, Any], KeyFlags(Reading)] = MappingProxyType({}),
) -> int:
    """List, look at, import and export worlds.

    list: the shipped kinds. show: size, cover, bottleneck and shortest path, and with --out a picture (.png). import: a
    ROS map (.yaml), Gazebo world (.world, .sdf), MovingAI map (.map) or GeoJSON as a TOML file; a folder of them as a
    folder. export: a ROS map (.yaml and .pgm), Gazebo world (.world, .sdf) or TOML file of the world of a seed.

    Maps have no start and no target: give them in the frame of the map, or two places far apart are chosen, with a way
    between them. Every verb takes such a file as --world too.

    For example:

        nnql-bullet worlds show cover_10 --seed 3 --out cover_10.png
        nnql-bullet worlds import warehouse.yaml --out warehouse.toml --start 3.5,-2,1.57 --target 10,4
        nnql-bullet worlds export rooms --seed 1 --out rooms.world

    Args:
        action: What to do.
        what: Shipped world, file, or folder of files to import.
        out: File or folder to write.
        seed: Seed of the world to show or export.
        robot: Vehicle that the way between chosen ends is wide enough for, or whose path is shown.
        start: Start, at rest, in the frame of the map [m, radians].
        target: Target in that frame [m].
        resolution: Side of a cell of the ROS map to write [m].
        json: Print JSON instead of text.
        options: How files are read where they leave a choice.
    """
    if action == "list":
        shipped = api.shipped_worlds()
        say(dumps(shipped) if json else text_table(("world", "what it is"), list(shipped.items())))
        return 0
    if what is None:
        raise UserError(f"worlds {action}: give a world; see: nnql-bullet worlds --help")
    asked = {"start": start, "target": target, "vehicle": robot, **options}
    if action == "show":
        view = api.view_world(api.load_world(what, **asked), seed=seed, vehicle=robot or "tricycle")
        if out is not None:
            view.draw(_picture(out))
        say(dumps(view.values) if json else view.text())
        if out is not None and not json:
            say(f"picture: {out}")
        return 0
    if out is None:
        raise UserError(f"worlds {action}: say where to write it with --out")
    if action == "import":
        return _import_folder(what, out, asked, json) if what.is_dir() else _import(what, out, asked, json)
    world = api.load_world(what, **asked)
    files = [str(file) for file in api.export_world(world, out, seed=seed, cell=resolution)]
    values = api.view_world(world, seed=seed).values
    ends = {name: ",".join(f"{value:g}" for value in values[name]) for name in ("start", "target")}
    if json:
        say(dumps({"files": files, **ends}))
        return 0
    for file in files:
        say(f"written: {file}")
    if out.suffix.lower() != ".toml":
        say(f"not in it: --start={ends['start']} --target={ends['target']}")
    return 0


def _picture(out: Path) -> Path:
    if out.suffix.lower() != ".png":
        raise UserError(f"{out}: pictures are written to files that end in .png")
    return out


def _toml(out: Path) -> Path:
    if out.suffix.lower() != ".toml":
        raise UserError(f"{out}: worlds are imported to files that end in .toml")
    return out


def _import(file: Path, out: Path, asked: Mapping[str, Any], json: bool) -> int:
    """Imports a file."""
    _toml(out)
    found = api.import_world(file, **asked)
    view = api.view_world(found.world, vehicle=asked["vehicle"] or "tricycle")
    write_world(found.world, out, f"{found.format}, from {file.name}")
    if json:
        told = {name: getattr(found, name) for name in ("format", "notes", "skipped", "chosen")} | {"file": str(out)}
        say(dumps(view.values | told))
        return 0
    say(f"{found.format}: {view.text()}")
    for note in filter(None, (*found.notes, found.chosen)):
        say(f"note: {note}")
    for what in found.skipped[:SHOWN]:
        say(f"left out: {what}")
    if len(found.skipped) > SHOWN:
        say(f"left out: {len(found.skipped) - SHOWN} more; --json lists them")
    say(f"world: {out}")
    return 0


def _import_folder(folder: Path, out: Path, asked: Mapping[str, Any], json: bool) -> int:
    """Imports all files of a folder that can be; those that are refused are named, and the exit code is 1."""
    if out.suffix or out.is_file():
        raise UserError(f"{out}: a folder of worlds is imported to a folder")
    files = sorted((file for file in folder.iterdir() if file.suffix.lower() in READERS), key=_in_order)
    if not files:
        raise UserError(f"{folder}: there is no file in it that ends in one of: {', '.join(READERS)}")
    out.mkdir(parents=True, exist_ok=True)
    told, refused = [], 0
    for file in files:
        try:
            found = api.import_world(file, **asked)
            view = api.view_world(found.world, vehicle=asked["vehicle"] or "tricycle")
            write_world(found.world, out / f"{file.stem}.toml", f"{found.format}, from {file.name}")
        except UserError as error:
            complain(str(error))
            refused += 1
            continue
        v = view.values
        told.append(v | {"file": str(out / f"{file.stem}.toml")})
        if not json:
            fits = "" if v["passable"] else f", too narrow for {view.vehicle}"
            say(f"{file.name}: {v['boxes'] + v['circles']} shapes, bottleneck {v['bottleneck']:.2f} m{fits}")
    if json:
        say(dumps(told))
    else:
        say(f"{len(told)} of {len(files)} worlds: {out}")
    return 1 if refused else 0


def _in_order(file: Path) -> list[tuple[int, str]]:
    """Sorts numbers in names by value."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"([0-9]{1,9})", file.name)]
