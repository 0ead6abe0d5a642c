"""Writes world files of this program."""

from dataclasses import MISSING, fields, replace
from pathlib import Path

from nnql_bullet.config import to_values, write_toml
from nnql_bullet.files import write_text
from nnql_bullet.worlds.layouts.boxes import boxes_of
from nnql_bullet.worlds.source import World
from nnql_bullet.worlds.spec import WorldSpec


def fixed(world: World, drawn: WorldSpec) -> World:
    """The world with the obstacles that were drawn, for every seed; patrols are drawn still."""
    return replace(world, layout=boxes_of(drawn.obstacles))


def write_world(world: World, path: Path, comment: str = "") -> None:
    """Writes a world as a TOML file, whose name is not that of the world if the world has another one.

    Args:
        world: The world.
        path: The file.
        comment: First line of the file; one line.
    """
    values = to_values(world)
    kept = {f.name: values[f.name] for f in fields(world) if f.name in values and values[f.name] != _default(f)}
    layout = kept.pop("layout")
    if kept.get("name") == path.stem:
        del kept["name"]
    tables = {name: kept.pop(name) for name in list(kept) if isinstance(kept[name], dict)}
    shapes = {name: layout.pop(name) for name in ("boxes", "circles") if layout["kind"] == "boxes"}
    text = write_toml({**kept, **tables, "layout": layout})
    for name, rows in shapes.items():
        if rows:
            text += f"{name} = [\n{''.join(f'    {{ {_pairs(row)} }},{chr(10)}' for row in rows)}]\n"
    write_text(path, f"# {comment}\n{text}" if comment else text)


def _default(field: object) -> object:
    default = getattr(field, "default", MISSING)
    return list(default) if isinstance(default, tuple) else default


def _pairs(row: dict[str, float]) -> str:
    return ", ".join(f"{key} = {value!r}" for key, value in row.items() if key != "yaw_degrees" or value)
