"""A vehicle's course: its targets in turn and, with a planner, the carrot that it drives at.

The carrot is a point on the plan that moves on ahead of the vehicle (Wallace et al., "First results in robot road
following", IJCAI 1985, and the pure-pursuit followers since). It never moves back, and the straight way to it costs no
more than the plan does: it leads through no wall, and cuts no corner that the plan keeps away from.
"""

from collections.abc import Sequence
from math import inf

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.planning.planner import Planner, Ways
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec

OFF = 1.5
"""Distance from the plan beyond which it is made anew, in turning radii."""
DEARER = 1.02
"""Cost of the straight way to the carrot over the plan's, at most."""


class Course:
    """One vehicle's way to its targets."""

    def __init__(self, world: WorldSpec, targets: Sequence[Point], planner: Planner | None, x: float, y: float) -> None:
        """Starts on the way to the first target.

        Args:
            world: The vehicle's world.
            targets: Places to reach in turn [m].
            planner: Plans the way to each; without one the course leads straight there.
            x: Position of the rear-axle centre [m].
            y: [m]

        Raises:
            UserError: If a planner finds no way.
        """
        self.plans: list[tuple[float, Array]] = []
        """Plans so far: when each was made since the start [s], and its corners (k, 2) [m]."""
        self.aim: Point
        """What the vehicle is to drive at [m]."""
        self.distance_left: float
        """Length of the known way to the last target [m]."""
        self._world, self._left, self._planner, self._time = world, tuple(targets), planner, 0.0
        for place in self._left:
            if not (0 < place[0] < world.width and 0 < place[1] < world.depth):
                raise UserError(f"world '{world.name}': a target ({place[0]:g}, {place[1]:g}) is outside the arena")
        if planner:
            for begin, end in zip(self._left, self._left[1:], strict=False):
                planner.check(world, begin, end)
        self._begin(x, y)

    @property
    def target(self) -> Point:
        """The target to reach now [m]."""
        return self._left[0]

    @property
    def is_at_waypoint(self) -> bool:
        """Whether the target to reach now is not the last."""
        return len(self._left) > 1

    def turn_to_next(self, x: float, y: float) -> None:
        """Goes on to the next target from a place [m]."""
        self._left = self._left[1:]
        self._begin(x, y)

    def update(self, x: float, y: float, duration: float) -> None:
        """Moves the carrot on.

        Args:
            x: Position of the rear-axle centre [m].
            y: [m]
            duration: Time since the last update [s].
        """
        self._time += duration
        if self._pursuit is None:
            self.aim, self.distance_left = self.target, _distance((x, y), self.target) + self._beyond
            return
        if not self._pursuit.follow(x, y):
            self._plan(x, y)
        self.aim, self.distance_left = self._pursuit.carrot, self._pursuit.left + self._beyond

    def _begin(self, x: float, y: float) -> None:
        """Starts on the way to the present target."""
        self._beyond = sum(_distance(one, other) for one, other in zip(self._left, self._left[1:], strict=False))
        self._pursuit: _Pursuit | None = None
        if self._planner:
            self._ways = self._planner.ways(self._world, (x, y), self.target)
            self._plan(x, y)
        self.update(x, y, 0.0)

    def _plan(self, x: float, y: float) -> None:
        """Makes a plan from a place [m]."""
        if self._planner:
            self._pursuit = _Pursuit(self._ways, x, y, self._planner.look_ahead, self._planner.turning_radius)
            self._pursuit.follow(x, y)
            self.plans.append((self._time, _corners(self._pursuit.path)))


class _Pursuit:
    """A plan, and how far a vehicle is along it."""

    def __init__(self, ways: Ways, x: float, y: float, look_ahead: float, radius: float) -> None:
        self._ways, self._look_ahead, self._least, self._off = ways, look_ahead, min(look_ahead, radius), OFF * radius
        self.path = np.concatenate([[(x, y)], ways.way(x, y)])
        self._along = np.concatenate([[0.0], np.hypot(*np.diff(self.path, axis=0).T).cumsum()])
        self._cells = [ways.begin(x, y), *(ways.grid.cell_of(*point) for point in self.path[1:].tolist())]
        self._reached, self._ahead = 0, 1  # the vehicle's place on the path, and the carrot's

    @property
    def carrot(self) -> Point:
        """Its place [m]."""
        x, y = self.path[self._ahead].tolist()
        return x, y

    def follow(self, x: float, y: float) -> bool:
        """Moves on with the vehicle; returns False if it is off the plan, or sees nothing of it."""
        last = len(self.path) - 1
        window = int(np.searchsorted(self._along, self._along[self._reached] + 2 * self._look_ahead, side="right"))
        away = np.hypot(*(self.path[self._reached : window] - (x, y)).T)
        self._reached += int(away.argmin())
        begin = self._ways.begin(x, y)
        here, there = self._ways.cost[begin], float(away.min())
        self.left = float(self._along[-1] - self._along[self._reached]) + there
        if there > self._off:
            return False
        ahead = self._along - self._along[self._reached]
        farthest, nearest = (int(np.searchsorted(ahead, its)) for its in (self._look_ahead, self._least))
        for k in range(min(farthest, last), max(self._ahead, self._reached) - 1, -1):
            cost = self._ways.straight_cost(begin, self._cells[k])
            spared = DEARER * (here - self._ways.cost[self._cells[k]]) + self._ways.grid.side
            if cost <= spared or (k <= nearest and cost < inf):
                self._ahead = k
                return True
        return False


def _distance(one: Point, other: Point) -> float:
    return float(np.hypot(one[0] - other[0], one[1] - other[1]))


def _corners(path: Array) -> Array:
    """The places of a path (k, 2) at which it turns, and its ends."""
    steps = np.round(np.diff(path, axis=0), 9)
    turns = (np.diff(steps, axis=0) != 0.0).any(axis=1)
    return np.asarray(path[np.concatenate([[True], turns, [True]])])
