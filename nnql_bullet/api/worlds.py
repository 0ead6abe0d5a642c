"""Maps and worlds: read from other programs, looked at, and written for them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nnql_bullet import assets
from nnql_bullet.config import parse
from nnql_bullet.errors import UserError
from nnql_bullet.reports.worlds import WorldView
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.exporters import CELL, check_suffix, write_foreign
from nnql_bullet.worlds.exporters.toml import fixed, write_world
from nnql_bullet.worlds.imported import CLEARANCE, Imported, import_file
from nnql_bullet.worlds.importers import Reading, is_foreign
from nnql_bullet.worlds.source import World


def import_world(
    path: str | Path,
    *,
    start: Sequence[float] | None = None,
    target: Sequence[float] | None = None,
    vehicle: str | Path | VehicleSpec | None = None,
    **reading: Any,
) -> Imported:
    """Reads a map or world of another program: ROS map, SDF, BARN world, MovingAI map or GeoJSON.

    Such a file has no start and no target. What is not given is chosen: two places far apart with a way between them.

    Example:
        >>> import nnql_bullet as nb
        >>> _ = nb.export_world("rooms", "rooms.yaml")
        >>> found = nb.import_world("rooms.yaml", start=(2, 2, 0), target=(22, 14))
        >>> found.format, found.world.width, found.world.draw(seed=0).bottleneck.width > 0.8
        ('ROS map', 24.0, True)

    Args:
        path: The file: .yaml, .yml (ROS), .world, .sdf, .xml, .map (MovingAI), .geojson or .json.
        start: x, y [m] and, if given, yaw [rad] in the frame of the file.
        target: x, y [m] in the frame of the file.
        vehicle: The way between ends that are chosen is as wide as this one needs; by default as the shipped vehicle
            does, or narrower if there is no such way.
        **reading: Where a file leaves a choice: the fields of `worlds.importers.Reading`.

    Raises:
        UserError: If the file is malformed or too large, or no two places in it have a way between them.
    """
    passage = None if vehicle is None else VehicleSpec.load(vehicle).width + CLEARANCE
    return import_file(Path(path), parse(Reading, reading, "reading"), start, target, passage)


def load_world(
    world: str | Path | World,
    *,
    start: Sequence[float] | None = None,
    target: Sequence[float] | None = None,
    vehicle: str | Path | VehicleSpec | None = None,
    **reading: Any,
) -> World:
    """Reads any world, with other ends if they are given; see `import_world`.

    Raises:
        UserError: If it cannot be read, or is no file of another program and is to be read as one.
    """
    if not isinstance(world, World) and is_foreign(Path(world)):
        return import_world(world, start=start, target=target, vehicle=vehicle, **reading).world
    if reading:
        raise UserError(f"{next(iter(reading))}: '{world}' is no map or world of another program, and leaves no choice")
    return World.load(world).between(start, target)


def view_world(
    world: str | Path | World, *, seed: int = 0, vehicle: str | Path | VehicleSpec = "tricycle"
) -> WorldView:
    """Draws a world and measures it: size, shapes, cover, bottleneck, shortest path.

    Example:
        >>> import nnql_bullet as nb
        >>> nb.view_world("rooms", seed=1).values["passable"]
        True

    Args:
        world: A shipped world, a TOML file, a map or world of another program, or a `World`.
        seed: Seed of the world.
        vehicle: The vehicle that is to pass.

    Raises:
        UserError: If it cannot be read or drawn.
    """
    source, its = World.load(world), VehicleSpec.load(vehicle)
    needed = its.width + source.clearance
    drawn = source.draw(seed, its.width, allow_impassable=not source.layout.is_random)
    return WorldView(drawn, source.frame, its.name, its.width, needed)


def export_world(world: str | Path | World, path: str | Path, *, seed: int = 0, cell: float = CELL) -> list[Path]:
    """Writes the world of a seed for another program, or as a TOML file; what moves is left out there.

    Example:
        >>> import nnql_bullet as nb
        >>> [file.name for file in nb.export_world("rooms", "rooms.yaml", seed=1)]
        ['rooms.yaml', 'rooms.pgm']

    Args:
        world: A shipped world, a TOML file, a map or world of another program, or a `World`.
        path: A file that ends in .yaml or .yml (ROS map, with its picture beside it), .world or .sdf, or .toml.
        seed: Seed of the world.
        cell: Side of a cell of a ROS map [m].

    Returns:
        The files that were written.

    Raises:
        UserError: If the world cannot be read or drawn, or the file has another suffix.
        OSError: If a file cannot be written.
    """
    path = Path(path)
    check_suffix(path)
    source = World.load(world)
    drawn = source.draw(seed, allow_impassable=not source.layout.is_random)
    if path.suffix.lower() == ".toml":
        write_world(fixed(source, drawn), path)
        return [path]
    return write_foreign(drawn, source.frame, path, cell)


def shipped_worlds() -> dict[str, str]:
    """Lists the shipped worlds by name, each with what it is: the first comment of its file."""
    found = {}
    for path in sorted(assets.folder("worlds").glob("*.toml")):
        line, _, _ = path.read_text(encoding="utf-8").partition("\n")
        found[path.stem] = line.removeprefix("#").strip()
    return found
