"""Tabular Q-learning, which the paper holds its network against (III): "a large-scale memory space" is needed.

In numbers: by default 27 states of five values, 1080 bytes, against the 89 weights of the network, 712 bytes. All eight
sectors with the same two edges make 6561 states, 262 kB; with four edges 390 625 states, 15.6 MB.
"""

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.learning.q_learning import QLearning, QLearningOptions, td_errors, turn_steps
from nnql_bullet.config import options
from nnql_bullet.env import Observation, Transition
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import FRONT, FRONT_LEFT, FRONT_RIGHT
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

MOST_STATES = 2**22
"""Of a table, whose values then take 168 MB."""

Edge = Annotated[float, Field(gt=0, le=paper.SENSOR_RANGE)]


@options
class QTableOptions(QLearningOptions):
    """The paper's numbers, and how readings become states."""

    network: ClassVar[tuple[str, ...]] = ("edges", "sectors")
    """Keys that two agents have to share for the weights of one to be those of the other."""
    kind: Literal["q_table"] = "q_table"
    edges: Annotated[tuple[Edge, ...], Field(max_length=100)] = (3.5, 5.0)
    """Readings from which the next level begins [m], rising."""
    sectors: tuple[Annotated[int, Field(ge=0, lt=paper.SECTORS)], ...] = (FRONT, FRONT_LEFT, FRONT_RIGHT)
    """Sectors whose readings make up the state. Each further sector multiplies the size of the table."""

    def __post_init__(self) -> None:
        """Refuses edges that do not rise, sectors given twice, and tables that are too large."""
        super().__post_init__()
        if list(self.edges) != sorted(set(self.edges)):
            raise ValueError("edges have to rise")
        if len(self.sectors) != len(set(self.sectors)):
            raise ValueError("a sector is given twice")
        if self.states > MOST_STATES:
            raise ValueError(f"a table of {self.states} states is too large; give fewer edges or sectors")

    @property
    def states(self) -> int:
        """Rows of the table."""
        return int((len(self.edges) + 1) ** len(self.sectors))

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "QTable":
        """Builds the agent."""
        return QTable(self, length_scale(vehicle.footprint))


class QTable(QLearning):
    """Q-values of every combination of a few levels of the readings."""

    options: QTableOptions

    def __init__(self, options: QTableOptions, scale: float = 1.0) -> None:
        self.options, self._edges = options, scale * np.array(options.edges)
        self._table = np.zeros((options.states, len(paper.TURNS)))
        self._visited = np.zeros(options.states, np.bool_)

    def state(self, readings: Array) -> NDArray[np.int64]:
        """Rows of the table (n,) for readings (n, 8) [m]."""
        levels = np.digitize(readings[:, self.options.sectors], self._edges)
        base = len(self.options.edges) + 1
        return np.asarray(levels @ base ** np.arange(len(self.options.sectors)))

    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """Rows of the table."""
        return np.asarray(self._table[self.state(observations.readings[asked])])

    def learn(self, transitions: Transition, state: None, episodes: NDArray[np.int64]) -> Array:
        """Updates the table by eq. (2).

        Several vehicles learn from the table as it stands; where they meet in one entry, their updates add up.
        """
        t, o = transitions, self.options
        errors = np.full(len(t.r_t), np.nan)
        learned = np.flatnonzero(t.active & self.asks(t.s_tm1))
        steps = turn_steps(t, learned, o.discount)
        s_tm1, s_t = self.state(steps.s_tm1), self.state(steps.s_t)
        q_tm1, q_t = self._table[s_tm1], self._table[s_t]
        errors[learned] = td_errors(q_tm1, steps.a_tm1, steps.r_t, steps.discount_t, q_t)
        np.add.at(self._table, (s_tm1, steps.a_tm1), o.learning_rate * errors[learned])
        self._visited[s_tm1] = True
        return errors

    def diagnostics(self, episode: int) -> dict[str, float]:
        """The temperature, and how many states it has learned in: as a number, and as a share of the table."""
        visited = int(self._visited.sum())
        return {**super().diagnostics(episode), "states": visited, "table_share": visited / self.options.states}

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """The states that it has learned in (k,), and their Q-values (k, 5); all others are zero."""
        states = np.flatnonzero(self._visited)
        return {"states": states, "values": self._table[states]}

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Replaces the table."""
        try:
            states, values = arrays["states"], arrays["values"]
            fits = values.shape == (*states.shape, len(paper.TURNS)) and np.isfinite(values).all()
            known = np.arange(self.options.states)[states]  # not those from the end
            if not fits or (states != known).any() or len(np.unique(states)) < len(states):
                raise ValueError
        except (KeyError, IndexError, ValueError, TypeError):
            raise UserError(f"this is not a table of Q-values of {self.options.states} states") from None
        self._table[:], self._visited[:] = 0.0, False
        self._table[states], self._visited[states] = values, True
