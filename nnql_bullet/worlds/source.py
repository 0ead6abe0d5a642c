"""World files: TOML that says how worlds are drawn, and the drawing."""

from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Any

from nnql_bullet import assets, paper
from nnql_bullet.config import merged, options, parse, read_toml
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, Pose, as_rows, bearing, clearance
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.types import Positive
from nnql_bullet.worlds.grid import is_solvable
from nnql_bullet.worlds.layouts import AnyLayout, Arena
from nnql_bullet.worlds.patrols import Patrols
from nnql_bullet.worlds.spec import WorldSpec

MOST_ATTEMPTS = 200


@options
class WorldFile:
    """A world's TOML."""

    layout: AnyLayout
    patrols: Patrols | None = None
    """Boxes that move, beside what the layout places."""
    width: Positive = paper.ARENA_SIDE
    """[m]"""
    depth: Positive = paper.ARENA_SIDE
    """[m]"""
    start: tuple[float, float] = paper.START
    """Of the rear-axle centre [m]."""
    start_yaw_degrees: float | None = None
    """Towards the target where it is not given."""
    target: tuple[float, float] = paper.TARGET
    """[m]"""
    target_radius: Positive = 2.0
    """The target is reached when the rear-axle centre comes this near [m]."""
    obstacle_height: Positive = 1.5
    """Of boxes and walls [m]."""


class WorldSource:
    """Draws worlds from a world file: the same seed, the same world."""

    def __init__(self, name: str, file: WorldFile) -> None:
        self.name = name
        self.file = file

    def draw(self, seed: int, room: float) -> WorldSpec:
        """The world of a seed, with a path of half width `room` [m] from start to target.

        A random layout is drawn again until there is one; the attempt is part of the stream, so the result depends on
        the arguments alone. Patrols, which come and go, do not count; they are drawn last, so that they leave the rest
        as it is without them.

        Raises:
            UserError: If there is no path, or the start or the target stands too close to an obstacle, or there is no
                room for the patrols.
        """
        for attempt in range(MOST_ATTEMPTS if self.file.layout.is_random else 1):
            world = self._attempt(seed, attempt)
            if is_solvable(world, room):
                return self._with_patrols(world)
        self._explain(world, room)
        random = self.file.layout.is_random
        again = f" in {MOST_ATTEMPTS} attempts; have its layout leave more room" if random else "; move its boxes apart"
        raise UserError(f"world '{self.name}', seed {seed}: no path {2 * room:.2f} m wide to the target{again}")

    def _attempt(self, seed: int, attempt: int) -> WorldSpec:
        file = self.file
        arena = Arena(file.width, file.depth, (file.start, file.target))
        yaw = bearing(Pose(*file.start, 0.0), *file.target)
        if file.start_yaw_degrees is not None:
            yaw = radians(file.start_yaw_degrees)
        return WorldSpec(
            name=self.name,
            seed=seed,
            width=file.width,
            depth=file.depth,
            obstacles=self.file.layout.place(arena, rng(seed, Stream.LAYOUT, attempt)),
            start=Pose(*file.start, round(yaw, 6)),
            target=file.target,
            target_radius=file.target_radius,
            obstacle_height=file.obstacle_height,
        )

    def _with_patrols(self, world: WorldSpec) -> WorldSpec:
        patrols = self.file.patrols
        return replace(world, patrols=patrols.draw(world, rng(world.seed, Stream.PATROLS))) if patrols else world

    def _explain(self, world: WorldSpec, room: float) -> None:
        for key, (x, y) in (("start", self.file.start), ("target", self.file.target)):
            if not (0 < x < world.width and 0 < y < world.depth):
                raise UserError(f"world '{self.name}': its {key} ({x:g}, {y:g}) is outside the arena; move it inside")
            free = clearance(as_rows((OrientedBox(x, y, 0.0, 0.0),))[0], world.solids)
            if free <= room:
                what = "inside a box" if free == 0 else f"{free:.2f} m from a box or wall, too near for the vehicle"
                raise UserError(f"world '{self.name}', seed {world.seed}: its {key} ({x:g}, {y:g}) is {what}; move one")


def load_world(name: str) -> WorldSource:
    """Reads a world file, and the files that its `base` names under it.

    Args:
        name: A shipped world's name or a path to a TOML file.

    Raises:
        UserError: If a file is missing or malformed.
    """
    path = assets.find("worlds", name)
    return WorldSource(path.stem, parse(WorldFile, _with_base(path, ()), str(path)))


def _with_base(path: Path, below: tuple[Path, ...]) -> dict[str, Any]:
    if path.resolve() in below:
        raise UserError(f"{path}: its 'base' leads back to itself")
    values = read_toml(path)
    base = values.pop("base", None)
    if base is None:
        return values
    if not isinstance(base, str):
        raise UserError(f"{path}: 'base' must be the name of a world")
    beside = path.parent / f"{base}.toml"
    found = beside if beside.is_file() else assets.find("worlds", base)
    return merged(_with_base(found, (*below, path.resolve())), values)
