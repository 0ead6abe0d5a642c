"""Makes any simulator one that can be copied and pickled."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.sim.base import Motion, Simulator, Traces, driving
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec


class CopyableSimulator:
    """A `Simulator` whose copies drive on independently from where it is.

    An engine keeps its state in memory of its own, which a copied Python object does not take along. But what follows a
    reset is a function of the calls since then: a copy is made anew, is put into the same worlds, and is given the same
    commands again. So a copy takes as long as the episodes so far.
    """

    def __init__(self, make: Callable[[], Simulator]) -> None:
        """Makes the simulator.

        Args:
            make: Makes it, here and in the process of a copy.
        """
        self._make, self._closed = make, False
        self.inner = make()
        """The simulator itself."""
        self.size, self.vehicle, self.drive = self.inner.size, self.inner.vehicle, self.inner.drive
        self._worlds: dict[int, WorldSpec] = {}
        self._steps = np.zeros(self.size, np.int64)
        self._given = np.zeros((0, self.size, 2))  # heading change and speed of each step of an episode
        self._traced: list[int] = []
        self._retargeted: list[tuple[int, int, Point]] = []  # vehicle, step of its episode, target

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """See `Simulator.reset`."""
        self._worlds |= worlds
        self._steps[list(worlds)] = 0
        self._retargeted = [its for its in self._retargeted if its[0] not in worlds]
        return self.inner.reset(worlds)

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        """See `Simulator.advance`."""
        vehicles, self._traced = np.array(driving(active, self.size), np.int64), list(traces or ())
        if len(vehicles) and self._steps[vehicles].max() == len(self._given):
            self._given = np.concatenate([self._given, np.zeros((len(self._given) or 16, self.size, 2))])
        places = self._steps[vehicles], vehicles
        self._given[(*places, 0)] = heading_changes[vehicles]
        self._given[(*places, 1)] = 1.0 if speed_scales is None else speed_scales[vehicles]
        self._steps[vehicles] += 1
        return self.inner.advance(heading_changes, active, speed_scales, traces)

    def retarget(self, targets: Mapping[int, Point]) -> None:
        """See `Simulator.retarget`."""
        self._retargeted += [(i, int(self._steps[i]), target) for i, target in targets.items()]
        self.inner.retarget(targets)

    def close(self) -> None:
        """Closes the simulator; nothing happens the second time."""
        if not self._closed:
            self._closed = True
            self.inner.close()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "inner"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if self._closed:
            return
        self.inner = self._make()
        if self._worlds:
            self.inner.reset(self._worlds)
        for step in range(self._steps.max() + 1):
            self.inner.retarget({i: target for i, when, target in self._retargeted if when == step})
            if step == self._steps.max():
                break
            turns, scales = self._given[step].T
            self.inner.advance(turns, self._steps > step, scales, {vehicle: [] for vehicle in self._traced})
