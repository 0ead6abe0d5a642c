"""Kinds of worlds: their description, in TOML or in code, and the drawing of worlds."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import dist, radians
from pathlib import Path
from typing import Annotated, Any

from pydantic import Discriminator, Tag

from nnql_bullet import assets, paper
from nnql_bullet.config import merged, options, parse, read_toml
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file
from nnql_bullet.geometry import OrientedBox, Pose, as_rows, bearing, clearance
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.types import Extent, Number
from nnql_bullet.worlds.grid import is_solvable
from nnql_bullet.worlds.layouts import AnyLayout, Arena
from nnql_bullet.worlds.patrols import Patrols
from nnql_bullet.worlds.spec import WorldSpec

MOST_ATTEMPTS = 200
"""Largest number of draws of a random layout."""
MOST_BASES = 20
"""Longest chain of world files whose `base` is the next."""
FOREIGN = (".yaml", ".yml", ".pgm", ".png", ".world", ".sdf", ".xml", ".json")
"""Suffixes of maps and worlds of other programs."""
MOST_NAME = 100
"""Longest name of a world."""
ROOM = 0.7888466169590319
"""Default half width of the free path in every world [m]; it fits the shipped vehicle."""


@options
class World:
    """A kind of world, from which worlds are drawn; the same seed gives the same world.

    Example:
        >>> import nnql_bullet as nb
        >>> world = nb.World.from_boxes([(50, 50, 20, 4)], name="wall")
        >>> world.draw(seed=0).cover
        0.008
        >>> nb.World.load("cover_10").draw(seed=3).digest == nb.World.load("cover_10").draw(seed=3).digest
        True
    """

    layout: AnyLayout
    """How obstacles are placed."""
    name: str = "world"
    """Name of the kind; by default the stem of its file's name."""
    patrols: Patrols | None = None
    """Moving boxes, in addition to those of the layout."""
    width: Extent = paper.ARENA_SIDE
    """[m]"""
    depth: Extent = paper.ARENA_SIDE
    """[m]"""
    start: tuple[Number, Number] = paper.START
    """Start of the rear-axle centre [m]."""
    start_yaw_degrees: Number | None = None
    """Heading at the start [degrees]; by default towards the target."""
    target: tuple[Number, Number] = paper.TARGET
    """[m]"""
    target_radius: Extent = 2.0
    """Distance from the rear-axle centre at which the target is reached [m]."""
    obstacle_height: Extent = 1.5
    """Height of boxes and walls [m]."""

    def __post_init__(self) -> None:
        """Refuses a name that no file could be named for, and a target that is reached at the start."""
        if not (0 < len(self.name) <= MOST_NAME and self.name.isprintable()) or {"/", "\\"} & set(self.name):
            raise ValueError(f"name must be one line of at most {MOST_NAME} characters without slashes")
        if dist(self.start, self.target) <= self.target_radius:
            raise ValueError(
                f"the target is reached at the start: they are {dist(self.start, self.target):g} m apart and "
                f"target_radius is {self.target_radius:g} m; move one, or lower target_radius"
            )

    @staticmethod
    def load(name: "str | Path | World") -> "World":
        """Reads a shipped world or a TOML file; a `World` is returned as it is.

        Raises:
            UserError: If a file is missing or malformed.
        """
        return name if isinstance(name, World) else load_world(str(name))

    @staticmethod
    def from_toml(path: str | Path) -> "World":
        """Reads a TOML file, and the files that its `base` names under it.

        Raises:
            UserError: If a file is missing or malformed.
        """
        return load_world(str(path))

    @staticmethod
    def from_boxes(boxes: Iterable[tuple[float, ...]], **values: Any) -> "World":
        """Makes a world with boxes at given places.

        Args:
            boxes: Centre x and y, length and width [m] and optionally yaw [degrees] of each box.
            **values: Other fields of `World`.

        Raises:
            UserError: If a value is wrong.
        """
        names = ("x", "y", "length", "width", "yaw_degrees")
        layout = {"kind": "boxes", "boxes": [dict(zip(names, box, strict=False)) for box in boxes]}
        return parse(World, {**values, "layout": layout}, "world")

    def plot(self, path: Path | str, seed: int = 0) -> None:
        """Draws the world of a seed as a picture (.png)."""
        from nnql_bullet.reports.plots import draw_map

        draw_map(self.draw(seed), Path(path))

    def draw(self, seed: int, room: float = ROOM) -> WorldSpec:
        """Draws the world of a seed, with a path of half width `room` [m] from start to target.

        A random layout is drawn again until it leaves such a path. The result depends on the arguments alone. Patrols
        are drawn last, so they do not change the other obstacles; they may cross the path.

        Raises:
            UserError: If there is no path, or the start or the target is too close to an obstacle, or there is no room
                for the patrols.
        """
        for attempt in range(MOST_ATTEMPTS if self.layout.is_random else 1):
            world = self._attempt(seed, attempt)
            if is_solvable(world, room):
                return self._with_patrols(world)
            if attempt == 0:  # no draw of boxes mends ends that walls are too near to
                self._check_ends(replace(world, obstacles=()), room)
        self._check_ends(world, room)
        random = self.layout.is_random
        again = f" in {MOST_ATTEMPTS} attempts; have its layout leave more room" if random else "; move its boxes apart"
        raise UserError(f"world '{self.name}', seed {seed}: no path {2 * room:.2f} m wide to the target{again}")

    def _attempt(self, seed: int, attempt: int) -> WorldSpec:
        arena = Arena(self.width, self.depth, (self.start, self.target))
        yaw = bearing(Pose(*self.start, 0.0), *self.target)
        if self.start_yaw_degrees is not None:
            yaw = radians(self.start_yaw_degrees)
        return WorldSpec(
            name=self.name,
            seed=seed,
            width=self.width,
            depth=self.depth,
            obstacles=self.layout.place(arena, rng(seed, Stream.LAYOUT, attempt)),
            start=Pose(*self.start, round(yaw, 6)),
            target=self.target,
            target_radius=self.target_radius,
            obstacle_height=self.obstacle_height,
        )

    def _with_patrols(self, world: WorldSpec) -> WorldSpec:
        patrols = self.patrols
        return replace(world, patrols=patrols.draw(world, rng(world.seed, Stream.PATROLS))) if patrols else world

    def _check_ends(self, world: WorldSpec, room: float) -> None:
        """Raises UserError if the start or the target is outside the arena or too close to an obstacle."""
        for key, (x, y) in (("start", self.start), ("target", self.target)):
            if not (0 < x < world.width and 0 < y < world.depth):
                raise UserError(f"world '{self.name}': its {key} ({x:g}, {y:g}) is outside the arena; move it inside")
            free = clearance(as_rows((OrientedBox(x, y, 0.0, 0.0),))[0], world.solids)
            if free <= room:
                what = "inside a box" if free == 0 else f"{free:.2f} m from a box or wall, too near for the vehicle"
                raise UserError(f"world '{self.name}', seed {world.seed}: its {key} ({x:g}, {y:g}) is {what}; move one")


WorldLike = Annotated[
    Annotated[str, Tag("a name")] | Annotated[World, Tag("a table")],
    Discriminator(lambda value: "a table" if isinstance(value, Mapping | World) else "a name"),
]
"""The name of a shipped world, the path of a TOML file, or a `World`."""


def load_world(name: str) -> World:
    """Reads a world file, and the files that its `base` names under it.

    Args:
        name: A shipped world's name or a path to a TOML file.

    Raises:
        UserError: If a file is missing or malformed.
    """
    path = assets.find("worlds", name)
    if path.suffix.lower() in FOREIGN:
        raise UserError(f"{path}: maps and worlds of other programs are not read; write its boxes into a TOML file")
    return parse(World, {"name": path.stem, **_with_base(path, ())}, str(path))


def _with_base(path: Path, below: tuple[Path, ...]) -> dict[str, Any]:
    if path.resolve() in below:
        raise UserError(f"{path}: its 'base' leads back to itself")
    if len(below) == MOST_BASES:
        raise UserError(f"{path}: more than {MOST_BASES} worlds are based on one another; write their keys in one file")
    values = read_toml(path)
    base = values.pop("base", None)
    if base is None:
        return values
    if not isinstance(base, str):
        raise UserError(f"{path}: 'base' must be the name of a world")
    beside = path.parent / f"{base}.toml"
    found = beside if is_file(beside) else assets.find("worlds", base)
    return merged(_with_base(found, (*below, path.resolve())), values)
