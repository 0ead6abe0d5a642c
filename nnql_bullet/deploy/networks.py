"""Learned networks in NumPy: what drives, without what learns."""

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import TurnChooser
from nnql_bullet.agents.learning.frame_driver import FrameDriver
from nnql_bullet.agents.learning.frames import Look, frame_width
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.options import DoubleDqnOptions, NnqlOptions
from nnql_bullet.agents.learning.q_learning import encode
from nnql_bullet.agents.learning.q_table import QTableOptions
from nnql_bullet.agents.learning.weights import check
from nnql_bullet.env import ACTIONS, Observation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Policy
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

Arrays = Mapping[str, NDArray[Any]]
PARTS = "weight", "bias"
"""Parts of a layer."""
_LAYER_NORM = 1e-5
"""Added to the variance by a layer norm, as torch does."""


class TurnNetwork(TurnChooser):
    """The paper's network."""

    def __init__(self, arrays: Arrays, encoding: str, scale: float) -> None:
        self._w1, self._b1 = arrays["0.weight"].T.copy(), arrays["0.bias"]
        self._w2, self._b2 = arrays["2.weight"].T.copy(), arrays["2.bias"]
        self._encoding, self._scale = encoding, scale

    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """The network's outputs."""
        seen = encode(observations.readings[asked] / self._scale, self._encoding)
        hidden = 0.5 + 0.5 * np.tanh(0.5 * (seen @ self._w1 + self._b1))  # the sigmoid, which overflows nowhere
        return np.asarray(hidden @ self._w2 + self._b2)


class DuelingDriver(FrameDriver):
    """A `double_dqn` that drives, in single precision as it learned."""

    def __init__(self, options: DoubleDqnOptions, arrays: Arrays, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        super().__init__(options, vehicle, drive)
        places = ((f"hidden.{3 * i}", f"hidden.{3 * i + 1}") for i in range(len(options.hidden)))
        self._layers = [[arrays[f"{place}.{part}"] for place in two for part in PARTS] for two in places]
        self._heads = [arrays[f"{head}.{part}"] for head in ("value", "advantage") for part in PARTS]

    def values(self, look: Look) -> Array:
        """Q(s, a) of the six actions (n, 6)."""
        x = look.stacked.astype(np.float32) / np.float32(127.5) - np.float32(1.0)
        for weight, bias, gain, shift in self._layers:
            x = x @ weight.T + bias
            x -= x.mean(axis=-1, keepdims=True)
            x /= np.sqrt((x * x).mean(axis=-1, keepdims=True) + np.float32(_LAYER_NORM))
            x = np.maximum(gain * x + shift, 0)
        value, value_bias, advantage, advantage_bias = self._heads
        over = x @ advantage.T + advantage_bias
        q = x @ value.T + value_bias + over - over.mean(axis=-1, keepdims=True)
        return np.asarray(q, np.float64)


def in_numpy(options: Any, arrays: Arrays, vehicle: VehicleSpec, drive: DriveOptions) -> Policy:
    """What a learned policy drives by.

    Args:
        options: Of its agent.
        arrays: Its weights, by name.
        vehicle: The vehicle that it drives.
        drive: Its controller.

    Raises:
        UserError: If it needs more than NumPy, or these are not its weights.
    """
    if isinstance(options, NnqlOptions | GeneticOptions):
        hidden = options.hidden_units if isinstance(options, NnqlOptions) else paper.HIDDEN_UNITS
        units: tuple[int, ...] = (paper.SECTORS, hidden, len(paper.TURNS))
        check(arrays, _linear(zip(("0", "2"), pairwise(units), strict=True)), "a network", units)
        encoding = options.encoding if isinstance(options, NnqlOptions) else "proximity"
        return TurnNetwork(arrays, encoding, length_scale(vehicle.footprint))
    if isinstance(options, DoubleDqnOptions):
        units = options.frames * frame_width(options.rays, options.grid_map), *options.hidden
        layers = [(f"hidden.{3 * i}", ends) for i, ends in enumerate(pairwise(units))]
        heads = [("value", (units[-1], 1)), ("advantage", (units[-1], ACTIONS))]
        norms = [(f"hidden.{3 * i + 1}", one) for i, one in enumerate(options.hidden)]
        shapes = _linear([*layers, *heads]) | {f"{name}.{part}": (one,) for name, one in norms for part in PARTS}
        check(arrays, shapes, "a dueling network", (*units, ACTIONS))
        return DuelingDriver(options, arrays, vehicle, drive)
    if isinstance(options, QTableOptions):
        table = options.make_agent(0, vehicle, drive)
        table.load_state_dict(dict(arrays))
        return table
    raise UserError(
        f"a policy of kind '{options.kind}' drives with PyTorch only: give what nnql_bullet.load_policy returns, where "
        "PyTorch is installed"
    )


def _linear(layers: Iterable[tuple[str, tuple[int, int]]]) -> dict[str, tuple[int, ...]]:
    """Shapes of weights and biases of layers, each with its inputs and outputs."""
    shapes: dict[str, tuple[int, ...]] = {}
    for name, (inputs, outputs) in layers:
        shapes |= {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}
    return shapes
