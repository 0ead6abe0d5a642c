"""Kinds of worlds: their description, in TOML or in code, and the drawing of worlds."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import cos, degrees, dist, pi, radians, sin
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationError

from nnql_bullet import assets, paper
from nnql_bullet.arguments import checked
from nnql_bullet.config import merged, options, parse, read_toml
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, real
from nnql_bullet.geometry import Pose, bearing, placed, wrap_angle
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.types import LARGEST, Extent, NonNegative, Number
from nnql_bullet.worlds.importers import is_foreign
from nnql_bullet.worlds.layouts import AnyLayout, Arena, Layout
from nnql_bullet.worlds.layouts.base import Densifiable
from nnql_bullet.worlds.narrowing import as_narrow_as
from nnql_bullet.worlds.patrols import Patrols
from nnql_bullet.worlds.spec import WorldSpec
from nnql_bullet.worlds.waypoints import MOST_WAYPOINTS

MOST_ATTEMPTS = 200
"""Largest number of draws of a random layout."""
MOST_NARROWINGS = 50
"""Largest number of random layouts that are narrowed to the bottleneck of a seed."""
MOST_DRAWN = 300_000
"""Number of obstacles that are drawn for a bottleneck after which no other layout is narrowed."""
NO_ROOM = 10_000
"""How many of them a draw counts for that finds no room, whose number of candidates is large."""
MOST_BASES = 20
"""Longest chain of world files whose `base` is the next."""
MOST_NAME = 100
"""Longest name of a world."""
Waypoints = Annotated[tuple[tuple[Number, Number], ...], Field(max_length=MOST_WAYPOINTS)]
WIDTH = 0.65
"""Width of the shipped vehicle [m]."""


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
    at_rest: bool = False
    """Whether the vehicle starts at rest, as in maps and where `--start` is given; else at the speed of its drive."""
    target: tuple[Number, Number] = paper.TARGET
    """[m]"""
    waypoints: Waypoints = ()
    """Places to reach in turn before the target [m]."""
    target_radius: Extent = 2.0
    """Distance from the rear-axle centre at which the target, or a way point, is reached [m]."""
    obstacle_height: Extent = 1.5
    """Height of boxes and walls [m]."""
    clearance: NonNegative = 0.1
    """How much wider than the vehicle the narrowest passage is at least [m]."""
    max_clearance: NonNegative | None = None
    """How much wider it is at most [m]: each seed then has a bottleneck between the two, every width as often, for
    which obstacles are added to the layout. Without it bottlenecks are as they come."""
    origin: tuple[Number, Number] = (0.0, 0.0)
    """The arena's lower left corner in the frame of the map that it was made from [m], in which no other key is."""
    origin_yaw_degrees: Number = 0.0
    """Yaw of the arena in that frame [degrees]."""

    def __post_init__(self) -> None:
        """Refuses a name that no file could be named for, and a target that is reached at the start."""
        if not (0 < len(self.name) <= MOST_NAME and self.name.isprintable()) or {"/", "\\"} & set(self.name):
            raise ValueError(f"name must be one line of at most {MOST_NAME} characters without slashes")
        if not self.waypoints and dist(self.start, self.target) <= self.target_radius:
            raise ValueError(
                f"the target is reached at the start: they are {dist(self.start, self.target):g} m apart and "
                f"target_radius is {self.target_radius:g} m; move one, or lower target_radius"
            )
        if self.max_clearance is None:
            return
        if self.max_clearance < self.clearance:
            raise ValueError(f"max_clearance {self.max_clearance:g} is less than clearance {self.clearance:g}")
        if not isinstance(self.layout, Densifiable):
            raise ValueError(f"max_clearance: a layout '{self.layout.kind}' cannot be made denser; leave it out")

    @property
    def is_random(self) -> bool:
        """Whether seeds give different worlds."""
        return self.layout.is_random or self.patrols is not None

    @property
    def frame(self) -> Pose:
        """The arena's lower left corner in the frame of the map that it was made from; at (0, 0) for other worlds."""
        return Pose(*self.origin, radians(self.origin_yaw_degrees))

    def between(
        self,
        start: Sequence[float] | None = None,
        target: Sequence[float] | None = None,
        waypoints: Sequence[Sequence[float]] | None = None,
    ) -> "World":
        """Returns the world with another start or target, or with way points; from another start it starts at rest.

        Args:
            start: x, y [m] and, if given, yaw [rad], in the frame of the world's map; without a yaw it looks towards
                the target.
            target: x, y [m] in that frame.
            waypoints: x, y [m] in that frame of several targets in turn; the last is the target.

        Raises:
            UserError: If these are no numbers of a place in the arena, the target is reached at the start, or both
                target and way points are given.
        """
        values: dict[str, Any] = {}
        if waypoints is not None:
            if target is not None:
                raise UserError("give a target or way points: the last of these is the target")
            if not 0 < len(waypoints) <= MOST_WAYPOINTS:
                raise UserError(f"waypoints: give 1 to {MOST_WAYPOINTS} places x,y, not {len(waypoints)}")
            places = (checked_place("waypoints", point) for point in waypoints)
            *between, values["target"] = [in_frame(self.frame, point) for point in places]
            values["waypoints"] = tuple(between)
        elif target is not None:
            values["waypoints"] = ()
        if start is not None:
            values["start"] = in_frame(self.frame, checked_place("start", start))
            yaw = degrees(wrap_angle(start[2] - self.frame.yaw)) if len(start) == 3 else None
            values |= {"start_yaw_degrees": yaw, "at_rest": True}
        if target is not None:
            values["target"] = in_frame(self.frame, checked_place("target", target))
        try:
            world = replace(self, **values)
        except ValidationError as error:
            raise UserError(f"world '{self.name}': {error.errors()[0]['msg'].partition(', ')[2]}") from None
        world.check_ends()
        return world

    def check_ends(self) -> None:
        """Checks that start, way points and target are in the arena.

        Raises:
            UserError: If one is not.
        """
        between = [(f"way point {number}", point) for number, point in enumerate(self.waypoints, 1)]
        for name, point in (("start", self.start), *between, ("target", self.target)):
            check_inside(f"world '{self.name}': its {name}", point, (self.width, self.depth), self.frame)

    @staticmethod
    @checked
    def load(name: "str | Path | World") -> "World":
        """Reads a shipped world, a TOML file, or a map or world of another program; a `World` is returned as it is.

        ROS maps (.yaml), SDF (.world, .sdf), MovingAI maps (.map) and GeoJSON are read as `import_world` does without
        options.

        Raises:
            UserError: If a file is missing or malformed.
        """
        return name if isinstance(name, World) else load_world(str(name))

    @staticmethod
    @checked
    def from_toml(path: str | Path) -> "World":
        """Reads a TOML file, and the files that its `base` names under it.

        Raises:
            UserError: If a file is missing or malformed.
        """
        return load_world(str(path))

    @staticmethod
    @checked
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

    @checked
    def plot(self, path: Path | str, seed: int = 0) -> None:
        """Draws the world of a seed as a picture (.png)."""
        from nnql_bullet.reports.plots import draw_map

        draw_map(self.draw(seed), Path(path))

    @checked
    def draw(self, seed: int, vehicle_width: float = WIDTH, allow_impassable: bool = False) -> WorldSpec:
        """Draws the world of a seed, whose widest path is wider than the vehicle by `clearance` everywhere.

        A random layout is drawn again until it leaves such a path. With `max_clearance`, the bottleneck is as wide as
        the seed says, to a centimetre. The result depends on the arguments alone. Patrols are drawn last, so they do
        not change the other obstacles; they may cross the path.

        Args:
            seed: The seed.
            vehicle_width: [m]
            allow_impassable: Whether to take the first draw, however narrow its path is.

        Raises:
            UserError: If the path is too narrow, an end is outside the arena, or there is no room for the patrols.
        """
        if not 0 <= seed < 2**63:
            given = f", not {seed}" if abs(seed) < 10**30 else ""
            raise UserError(f"a world seed must be from 0 to 2^63 - 1{given}")
        self.check_ends()
        if isinstance(self.layout, Densifiable) and self.max_clearance is not None:
            return self._with_patrols(self._as_narrow_as_drawn(self.layout, seed, vehicle_width, self.max_clearance))
        attempts = MOST_ATTEMPTS if self.layout.is_random else 1
        for attempt in range(attempts):
            world = self._attempt(seed, attempt, self.layout)
            if allow_impassable or world.admits(vehicle_width + self.clearance):
                return self._with_patrols(world)
            if attempt == 0 and not replace(world, obstacles=()).admits(vehicle_width + self.clearance):
                attempts = 1  # no draw of obstacles mends ends that walls are too near to
                break
        found, again = world.bottleneck, f" in {attempts} attempts" if attempts > 1 else ""
        end = {self.start: "its start, ", self.target: "its target, "}.get((found.x, found.y), "")
        raise UserError(
            f"world '{self.name}', seed {seed}: its widest path narrows to {found.width:.2f} m at {end}({found.x:.2f}, "
            f"{found.y:.2f}){again}; the vehicle needs {vehicle_width + self.clearance:.2f} m (its width of "
            f"{vehicle_width:g} m and 'clearance', {self.clearance:g} m): move obstacles apart, lower 'clearance', or "
            "allow impassable worlds"
        )

    def _as_narrow_as_drawn(self, layout: Densifiable, seed: int, width: float, most: float) -> WorldSpec:
        """Draws the bottleneck of a seed, and a world that has it."""
        wanted = width + round(float(rng(seed, Stream.BOTTLENECK).uniform(self.clearance, most)), 3)
        attempt, drawn = 0, 0

        def draw(share: float) -> WorldSpec:
            nonlocal drawn
            drawn += NO_ROOM
            world = self._attempt(seed, attempt, layout.denser(share))
            drawn += len(world.obstacles) - NO_ROOM
            return world

        while attempt < MOST_NARROWINGS and drawn <= MOST_DRAWN:
            world = as_narrow_as(wanted, draw)
            if world is not None:
                return world
            attempt += 1
        raise UserError(
            f"world '{self.name}', seed {seed}: in {attempt} attempts none had a bottleneck of {wanted:.2f} m; "
            "make the layout sparser, or smaller obstacles possible, or change 'clearance' and 'max_clearance'"
        )

    def _attempt(self, seed: int, attempt: int, layout: Layout) -> WorldSpec:
        arena = Arena(self.width, self.depth, (self.start, *self.waypoints, self.target))
        yaw = bearing(Pose(*self.start, 0.0), *(*self.waypoints, self.target)[0])
        if self.start_yaw_degrees is not None:
            yaw = radians(self.start_yaw_degrees)
        return WorldSpec(
            name=self.name,
            seed=seed,
            width=self.width,
            depth=self.depth,
            obstacles=layout.place(arena, rng(seed, Stream.LAYOUT, attempt)),
            start=Pose(*self.start, round(yaw, 6)),
            target=self.target,
            target_radius=self.target_radius,
            obstacle_height=self.obstacle_height,
            waypoints=self.waypoints,
            at_rest=self.at_rest,
        )

    def _with_patrols(self, world: WorldSpec) -> WorldSpec:
        patrols = self.patrols
        return replace(world, patrols=patrols.draw(world, rng(world.seed, Stream.PATROLS))) if patrols else world


def in_frame(frame: Pose, point: Sequence[float]) -> tuple[float, float]:
    """Transforms a point x, y [m] from the frame that `frame` lies in into `frame`, to a micrometre."""
    dx, dy = point[0] - frame.x, point[1] - frame.y
    c, s = cos(frame.yaw), sin(frame.yaw)
    return round(c * dx + s * dy, 6), round(c * dy - s * dx, 6)


def checked_place(name: Literal["start", "target", "waypoints"], numbers: Sequence[float]) -> Sequence[float]:
    """Checks the numbers of a start, target or way point: x, y [m] and, of a start, maybe yaw [rad].

    Raises:
        UserError: If there are not so many, one is not finite or too large, or the yaw is beyond a turn.
    """
    counts, what = ((2, 3), "x,y or x,y,yaw") if name == "start" else ((2,), "x,y")
    if len(numbers) not in counts or not all(abs(number) <= LARGEST for number in numbers):
        raise UserError(f"{name}: must be {what}, finite numbers in metres{' and radians' if name == 'start' else ''}")
    if len(numbers) == 3 and abs(numbers[2]) > 2 * pi:
        raise UserError(f"{name}: its yaw is in radians, from -6.28 to 6.28, not {numbers[2]:g}")
    return numbers


def check_inside(what: str, point: tuple[float, float], size: tuple[float, float], frame: Pose) -> None:
    """Checks that a point [m] is in an arena of a size [m], whose corner lies at `frame` in its map.

    Raises:
        UserError: If it is not.
    """
    x, y = point
    if not (0 < x < size[0] and 0 < y < size[1]):
        u, v = placed(frame, x, y)
        given = "" if frame == Pose(0.0, 0.0, 0.0) else f", ({u:g}, {v:g}) in its map,"
        raise UserError(f"{what} ({x:g}, {y:g}){given} is outside the arena; move it inside")


WorldLike = Annotated[
    Annotated[str, Tag("a name")] | Annotated[World, Tag("a table")],
    Discriminator(lambda value: "a table" if isinstance(value, Mapping | World) else "a name"),
]
"""The name of a shipped world, the path of a file, or a `World`."""


def load_world(name: str) -> World:
    """Reads a world file, and the files that its `base` names under it.

    Args:
        name: A shipped world's name, or a path to a TOML file or to a map or world of another program.

    Raises:
        UserError: If a file is missing or malformed.
    """
    path = assets.find("worlds", name)
    if is_foreign(path):
        from nnql_bullet.worlds.imported import import_file

        return import_file(path).world
    return parse(World, {"name": path.stem, **_with_base(path, ())}, str(path))


def _with_base(path: Path, below: tuple[Path, ...]) -> dict[str, Any]:
    if real(path) in below:
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
    return merged(_with_base(found, (*below, real(path))), values)
