"""Maps beside a graph: what they tell it of a decision, and what is remembered after it.

The search for ways through a map ends when it ends, which a graph of fixed steps cannot. So a `double_dqn` or a
`distilled` in ONNX has its map in the runtime, in the agent's own code.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.agents import foresight
from nnql_bullet.agents.foresight import Foresight
from nnql_bullet.agents.learning import frames
from nnql_bullet.agents.learning.frames import FrameMaker, Look
from nnql_bullet.agents.learning.options import DistilledOptions, DoubleDqnOptions
from nnql_bullet.env import Observation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment


@dataclass(frozen=True, slots=True)
class Told:
    """What n maps tell at a decision."""

    inputs: NDArray[np.float32]
    """Inputs of the graph after those of the sensors (n, numbers)."""
    frames: NDArray[np.uint8]
    """What was seen before, as bytes (n, bytes)."""
    look: Any
    """The memory with the present observation entered, as the map has it."""


class MapBeside(Protocol):
    """Keeps the maps of n vehicles."""

    def nothing(self, size: int) -> Any:
        """Memory of n vehicles at the start of a drive; its `age` counts decisions."""

    def told(self, memory: Any, observations: Observation) -> Told:
        """Enters what n vehicles see into a copy of their memory, and says what a graph is told."""

    def after(self, told: Told, observations: Observation, outputs: Mapping[str, NDArray[Any]]) -> Any:
        """The memory of vehicles after the graph decided."""

    def values_of(self, policy: Any, state: Any) -> NDArray[Any]:
        """The values (n, m) by which the policy itself made the decision that gave this state."""


def map_of(experiment: Experiment) -> MapBeside:
    """The map of a `double_dqn` or a `distilled`.

    Raises:
        UserError: If the agent is of another kind.
    """
    options, vehicle, drive = experiment.config.agent, experiment.vehicle, experiment.config.drive
    if isinstance(options, DistilledOptions):
        return ForesightMap(Foresight(vehicle, drive))
    if isinstance(options, DoubleDqnOptions):
        return FrameMap(FrameMaker(options.rays, options.frames, options.grid_map, vehicle, drive))
    raise UserError(f"a policy of kind '{options.kind}' has no map")


def forgotten(memory: Any, vehicles: Mapping[int, int]) -> Any:
    """The memory without what is known of some vehicles, by their numbers."""
    age = memory.age.copy()
    age[list(vehicles)] = 0
    return replace(memory, age=age)


class FrameMap:
    """The map of a `double_dqn`; see `FrameMaker.sense`."""

    def __init__(self, maker: FrameMaker) -> None:
        self._maker = maker

    def nothing(self, size: int) -> frames.Memory:
        """See `MapBeside`."""
        return self._maker.nothing(size)

    def told(self, memory: frames.Memory, observations: Observation) -> Told:
        """Ways around, the way to the target, and the last action."""
        sensed = self._maker.sense(memory, observations)
        last = np.where(memory.age == 0, -1, memory.actions)
        inputs = np.concatenate([sensed.around, sensed.way[:, None], last[:, None]], axis=1)
        return Told(inputs.astype(np.float32), memory.frames.reshape(len(last), -1), sensed)

    def after(self, told: Told, observations: Observation, outputs: Mapping[str, NDArray[Any]]) -> frames.Memory:
        """See `MapBeside`."""
        seen = told.look.memory
        memory = replace(seen, frames=outputs["next_frames"].reshape(seen.frames.shape))
        return self._maker.after(Look(memory, told.look.progress), observations, outputs["action"])

    def values_of(self, policy: Any, state: Any) -> NDArray[Any]:
        """See `MapBeside`."""
        return np.asarray(policy.values_of(state))


class ForesightMap:
    """The map of a `distilled`, and the search that foresees what each manoeuvre comes to; see `agents.foresight`."""

    def __init__(self, foreseeing: Foresight) -> None:
        self._foresight = foreseeing

    def nothing(self, size: int) -> foresight.Memory:
        """See `MapBeside`."""
        return self._foresight.nothing(size)

    def told(self, memory: foresight.Memory, observations: Observation) -> Told:
        """What is foreseen of the manoeuvres, what is around, the way, what is thin, and whether a drive begins."""
        look = self._foresight.look(memory, observations)
        foreseen, around, ways, thin = self._foresight.foreseen(look, observations)
        n = len(ways)
        parts = [foreseen.reshape(n, -1), around.reshape(n, -1), ways[:, None], thin[:, None], memory.age[:, None] == 0]
        kept = memory.frames[:, : foresight.SECTORS * (foresight.SCANS - 1)]
        return Told(np.concatenate(parts, axis=1).astype(np.float32), kept, look)

    def after(self, told: Told, observations: Observation, outputs: Mapping[str, NDArray[Any]]) -> foresight.Memory:
        """See `MapBeside`."""
        seen = told.look.memory.frames.copy()
        scans = outputs["next_frames"]
        seen[:, : scans.shape[1]] = scans
        look = replace(told.look, memory=replace(told.look.memory, frames=seen))
        return self._foresight.after(look, observations, outputs["action"])

    def values_of(self, policy: Any, state: Any) -> NDArray[Any]:
        """See `MapBeside`."""
        return np.asarray(state.values)
