"""Plans ways through a whole world: the cheapest way over a grid from everywhere to a target.

A cell is free if the vehicle's width and some clearance fit around its centre. A metre costs more where the vehicle
could not turn round on the spot, so that a plan keeps to the middle of passages and prefers wide ones. Dijkstra's
algorithm (SciPy's) runs once for each target, from there outwards; its tree then gives the way from any place, so that
planning again costs nothing. Moving obstacles are not part of a plan.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from math import ceil, floor, sqrt
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.config import options
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.jit import njit
from nnql_bullet.types import NonNegative, Reach
from nnql_bullet.vehicle.scale import turning_radius
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.passages import Passage, Point, narrowest_passage
from nnql_bullet.worlds.paths import Cell, free_cells
from nnql_bullet.worlds.spec import WorldSpec

if TYPE_CHECKING:
    from scipy.sparse import csr_array

CELLS_ACROSS = 10
"""Number of cells across the vehicle's width; fewer in arenas of more than `MOST_CELLS` cells."""
MOST_CELLS = 400_000
CLEARANCE = 0.1
"""How much wider than the vehicle the narrowest place of a plan is, where the world leaves a choice [m]."""
LOOK_AHEAD = 2.5
"""Of the carrot, in turning radii."""
ROOM = 1.5
"""Distance from obstacles that a plan prefers to keep, in turning radii."""
KEPT = 4
"""Most grids, and ways through each, that a planner keeps."""
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
K = TypeVar("K")
V = TypeVar("V")


@options
class PlanOptions:
    """Options of the plan that leads a vehicle to targets beyond its sight. Lengths that are not given follow it."""

    look_ahead: Reach | None = None
    """Length along the plan at which the point that the vehicle drives at moves on ahead of it [m]; by default 2.5
    times its turning radius."""
    room: Reach | None = None
    """Distance from obstacles that the plan prefers to keep [m]; by default 1.5 times the turning radius."""
    caution: NonNegative = 5.0
    """How many times as much a metre costs, beyond the first, at the edge of what the vehicle passes at all."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The cells of a world. Rows follow y, columns x."""

    side: float
    """[m]"""
    free: NDArray[np.bool_]
    """Whether the vehicle passes over the centre of a cell (rows, columns)."""
    cost: Array
    """Cost of a metre in each cell, at least 1; infinite where it is not free (rows, columns)."""
    graph: "csr_array"
    """Cost of the way between neighbouring free cells, each pair once."""
    ways: "OrderedDict[Point, Ways]" = field(default_factory=OrderedDict)
    """The ways to some targets."""

    def cell_of(self, x: float, y: float) -> Cell:
        """The cell that a place is in; the nearest for one outside."""
        rows, columns = self.free.shape
        return min(max(floor(y / self.side), 0), rows - 1), min(max(floor(x / self.side), 0), columns - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Ways:
    """The cheapest ways to a target from everywhere."""

    grid: Grid
    target: Point
    """[m]"""
    cost: Array
    """Cost of the way from each cell (rows, columns); infinite where there is none."""
    toward: NDArray[np.int32]
    """The next cell on the way, as a place in the flattened grid (cells,)."""
    nearest: NDArray[np.int32]
    """Row and column of the nearest cell with a way (2, rows, columns)."""

    def begin(self, x: float, y: float) -> Cell:
        """The nearest cell with a way to a place [m]."""
        row, column = self.grid.cell_of(x, y)
        return int(self.nearest[0, row, column]), int(self.nearest[1, row, column])

    def way(self, x: float, y: float) -> Array:
        """The way from a place [m] to the target, cell by cell (k, 2) [m]; the last is the target itself."""
        cells = _walk(self.toward, *self.begin(x, y), self.grid.free.shape[1])
        points = (cells[:, ::-1] + 0.5) * self.grid.side
        points[-1] = self.target
        return np.asarray(points, np.float64)

    def straight_cost(self, begin: Cell, end: Cell) -> float:
        """Cost of the straight way between the centres of two cells; infinite through a cell that is not free."""
        return float(_straight_cost(begin, end, self.grid.cost, self.grid.side))


class Planner:
    """Plans the ways of a vehicle."""

    def __init__(self, options: PlanOptions, vehicle: VehicleSpec) -> None:
        """Works out the lengths.

        Args:
            options: Of the plan.
            vehicle: Its footprint says where it passes.
        """
        radius = turning_radius(vehicle.footprint)
        self.look_ahead = LOOK_AHEAD * radius if options.look_ahead is None else options.look_ahead
        self.turning_radius = radius
        self._room = ROOM * radius if options.room is None else options.room
        self._caution = options.caution
        self._name, self._width = vehicle.name, vehicle.width
        self._grids: OrderedDict[tuple[bytes, float, bool], Grid] = OrderedDict()

    def ways(self, world: WorldSpec, start: Point, target: Point) -> Ways:
        """Finds the ways to a target [m] from around a start [m].

        Raises:
            UserError: If the vehicle does not get there, with the narrowest place of the widest path.
        """
        passage = self.check(world, start, target)
        width = min(self._width + CLEARANCE, passage.width)
        for slack in (False, True):
            ways = self._ways(self._grid(world, width, slack), target)
            if ways and np.isfinite(ways.cost[ways.grid.cell_of(*start)]):
                return ways
        raise UserError(
            f"world '{world.name}': no plan from ({start[0]:.2f}, {start[1]:.2f}) to ({target[0]:.2f}, "
            f"{target[1]:.2f}): its way is narrower than the {self._side(world):.2f} m cells of the plan's grid tell"
        )

    def check(self, world: WorldSpec, start: Point, target: Point) -> Passage:
        """Finds the narrowest place of the widest path from a start to a target [m].

        Raises:
            UserError: If the vehicle does not pass there.
        """
        given = start == (world.start.x, world.start.y) and world.targets == (target,)
        passage = world.bottleneck if given else narrowest_passage(world.solids, start, target)
        if passage.admits(self._width):
            return passage
        raise UserError(
            f"world '{world.name}': no plan leads '{self._name}', {self._width:g} m wide, from ({start[0]:.2f}, "
            f"{start[1]:.2f}) to ({target[0]:.2f}, {target[1]:.2f}): the widest path narrows to {passage.width:.2f} m "
            f"at ({passage.x:.2f}, {passage.y:.2f}); move obstacles apart, or give another target or a narrower robot"
        )

    def _side(self, world: WorldSpec) -> float:
        return max(self._width / CELLS_ACROSS, sqrt(world.width * world.depth / MOST_CELLS))

    def _grid(self, world: WorldSpec, width: float, slack: bool) -> Grid:
        """The grid of a world in which a disc of a width [m] passes.

        With slack, all cells around the way of such a disc are connected; some are then free that it does not pass.
        """
        key = world.solids.tobytes(), width, slack
        if key not in self._grids:
            from scipy.ndimage import distance_transform_edt  # loaded where a plan is made, as all of SciPy here

            side = self._side(world)
            distance = max(width / 2 - (side / sqrt(2) if slack else 0.0), 0.0)
            shape = ceil(world.depth / side), ceil(world.width / side)
            free = free_cells(shape, side, world.solids, distance)
            away = distance + side * np.asarray(distance_transform_edt(np.pad(free, 1)))[1:-1, 1:-1]
            near = np.clip((self._room - away) / max(self._room - distance, side), 0.0, 1.0)
            cost = np.where(free, 1.0 + self._caution * near**2, np.inf)
            self._grids[key] = Grid(side, free, cost, _graph(free, cost, side))
        return _kept(self._grids, key)

    def _ways(self, grid: Grid, target: Point) -> Ways | None:
        """The ways to a target; None if its cell is not free."""
        end = grid.cell_of(*target)
        if not grid.free[end]:
            return None
        if target not in grid.ways:
            from scipy.ndimage import distance_transform_edt
            from scipy.sparse.csgraph import dijkstra

            place = end[0] * grid.free.shape[1] + end[1]
            cost, toward = dijkstra(grid.graph, directed=False, indices=place, return_predecessors=True)
            costs = np.asarray(cost).reshape(grid.free.shape)
            _, nearest = distance_transform_edt(~np.isfinite(costs), return_indices=True)
            grid.ways[target] = Ways(grid, target, costs, toward, nearest)
        return _kept(grid.ways, target)


def _kept(store: "OrderedDict[K, V]", key: K) -> V:
    """Looks something up, and forgets what was not asked for the longest."""
    store.move_to_end(key)
    while len(store) > KEPT:
        store.popitem(last=False)
    return store[key]


def _graph(free: NDArray[np.bool_], cost: Array, side: float) -> "csr_array":
    """Links each free cell with those of its eight neighbours that are free; both cells count for half of the way."""
    from scipy.sparse import csr_array

    rows, columns = free.shape
    places = np.arange(free.size, dtype=np.int32).reshape(free.shape)
    begins, ends, costs = [], [], []
    for down, right in _NEIGHBOURS:
        one = slice(0, rows - down), slice(max(-right, 0), columns - max(right, 0))
        other = slice(down, rows), slice(max(right, 0), columns + min(right, 0))
        both = free[one] & free[other]
        begins.append(places[one][both])
        ends.append(places[other][both])
        costs.append((side * np.hypot(down, right) / 2 * (cost[one] + cost[other]))[both])
    pairs = np.concatenate(begins), np.concatenate(ends)
    return csr_array((np.concatenate(costs), pairs), shape=(free.size, free.size))


@njit(nogil=True)
def _walk(toward: NDArray[np.int32], row: int, column: int, columns: int) -> NDArray[np.int64]:
    """Follows a tree from a cell to its root: rows and columns (k, 2)."""
    count, place = 1, row * columns + column
    while toward[place] >= 0:
        place = toward[place]
        count += 1
    cells, place = np.empty((count, 2), np.int64), row * columns + column
    for k in range(count):
        cells[k, 0], cells[k, 1] = place // columns, place % columns
        place = toward[place]
    return cells


@njit(nogil=True)
def _straight_cost(begin: Cell, end: Cell, cost: Array, side: float) -> float:
    """Adds the costs of the cells that a straight line passes, twice as dense as they are."""
    down, right = end[0] - begin[0], end[1] - begin[1]
    steps = 2 * max(abs(down), abs(right), 1)
    total = 0.0
    for k in range(steps + 1):
        row = int(np.rint(begin[0] + down * k / steps))
        column = int(np.rint(begin[1] + right * k / steps))
        total += cost[row, column] * (0.5 if k in (0, steps) else 1.0)
    return total * side * float(np.hypot(down, right)) / steps
