"""Learned networks in NumPy: what drives, without what learns."""

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import TurnChooser
from nnql_bullet.agents.foresight import CONTEXT, PHI
from nnql_bullet.agents.foresight import Look as Foreseen
from nnql_bullet.agents.learning.frame_driver import FrameDriver
from nnql_bullet.agents.learning.frames import Look, frame_width
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.manoeuvre_driver import MANNERS, ManoeuvreDriver
from nnql_bullet.agents.learning.options import DistilledOptions, DoubleDqnOptions, NnqlOptions
from nnql_bullet.agents.learning.q_learning import encode
from nnql_bullet.agents.learning.q_table import QTableOptions
from nnql_bullet.agents.learning.weights import check
from nnql_bullet.env import ACTIONS, MANOEUVRES, Observation
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
        x: NDArray[Any] = look.stacked.astype(np.float32) / np.float32(127.5) - np.float32(1.0)
        for layer in self._layers:
            x = np.maximum(_normed(x, *layer), 0)
        value, value_bias, advantage, advantage_bias = self._heads
        over = x @ advantage.T + advantage_bias
        q = x @ value.T + value_bias + over - over.mean(axis=-1, keepdims=True)
        return np.asarray(q, np.float64)


class ForeseeingDriver(ManoeuvreDriver):
    """A `distilled` that drives, in single precision as it learned."""

    def __init__(self, options: DistilledOptions, arrays: Arrays, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        super().__init__(options, vehicle, drive)
        places = ((f"surroundings.{3 * i}", f"surroundings.{3 * i + 1}") for i in range(len(options.hidden)))
        *self._layers, self._last = [
            [arrays[f"{place}.{part}"] for place in two for part in PARTS if f"{place}.{part}" in arrays]
            for two in places
        ]
        weight, bias = (arrays[f"foreseen.{part}"] for part in PARTS)
        self._foreseen = weight[:, :PHI].T.copy()
        self._manners = np.repeat(weight[:, PHI:].T + bias, ACTIONS, axis=0)
        self._value = [arrays[f"value.{layer}.{part}"] for layer in (1, 3) for part in PARTS]

    def values(self, look: Foreseen) -> Array:
        """What the network says of the manoeuvres (n, 24) [m]."""
        numbers: NDArray[Any] = look.stacked.astype(np.float32) / np.float32(127.5) - np.float32(1.0)
        x, phi = numbers[:, :CONTEXT], numbers[:, CONTEXT:].reshape(-1, MANOEUVRES, PHI)
        for layer in self._layers:
            x = np.maximum(_normed(x, *layer), 0)
        weight, bias = self._last
        each = phi @ self._foreseen + self._manners + (x @ weight.T + bias)[:, None]
        w1, b1, w2, b2 = self._value
        q = np.maximum(np.maximum(each, 0) @ w1.T + b1, 0) @ w2[0] + b2[0]
        return np.asarray(q, np.float64)


def _normed(x: Array, weight: Array, bias: Array, gain: Array, shift: Array) -> Array:
    """A layer and the layer norm after it."""
    x = x @ weight.T + bias
    x -= x.mean(axis=-1, keepdims=True)
    x /= np.sqrt((x * x).mean(axis=-1, keepdims=True) + np.float32(_LAYER_NORM))
    return np.asarray(gain * x + shift)


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
        shapes = _linear([*layers, *heads]) | _normal(norms)
        check(arrays, shapes, "a dueling network", (*units, ACTIONS))
        return DuelingDriver(options, arrays, vehicle, drive)
    if isinstance(options, DistilledOptions):
        units = CONTEXT, *options.hidden
        layers = [(f"surroundings.{3 * i}", ends) for i, ends in enumerate(pairwise(units))]
        norms = [(f"surroundings.{3 * i + 1}", one) for i, one in enumerate(options.hidden[:-1])]
        each = [("foreseen", (PHI + MANNERS, units[-1]))]
        heads = [("value.1", (units[-1], options.per_action)), ("value.3", (options.per_action, 1))]
        shapes = _linear([*layers, *each, *heads]) | _normal(norms)
        check(arrays, shapes, "a network of manoeuvres", (*units, options.per_action, MANOEUVRES))
        return ForeseeingDriver(options, arrays, vehicle, drive)
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


def _normal(layers: Iterable[tuple[str, int]]) -> dict[str, tuple[int, ...]]:
    """Shapes of gains and shifts of layer norms, each with its units."""
    return {f"{name}.{part}": (units,) for name, units in layers for part in PARTS}
