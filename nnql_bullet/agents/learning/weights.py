"""Weights of neural networks in and out: the state dict of a torch module as NumPy arrays by name."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array

if TYPE_CHECKING:
    import torch

Shapes = Mapping[str, tuple[int, ...]]


def state_dict(module: "torch.nn.Module") -> dict[str, Array]:
    """Copies the weights and biases of a module, by name."""
    return {name: value.numpy().copy() for name, value in module.state_dict().items()}


def _is_finite(values: Array) -> bool:
    return values.dtype.kind in "fiub" and bool(np.isfinite(values).all())


def fits(arrays: Mapping[str, Array], shapes: Shapes) -> bool:
    """Tells whether arrays have exactly these names and shapes, and hold finite numbers only."""
    theirs = {name: value.shape for name, value in arrays.items()}
    return theirs == dict(shapes) and all(map(_is_finite, arrays.values()))


def check(arrays: Mapping[str, Array], shapes: Shapes, network: str, units: Sequence[int]) -> None:
    """Refuses arrays that are not the weights of a network.

    Args:
        arrays: Weights and biases by name.
        shapes: Names and shapes of the network's weights.
        network: What the network is called in the error, with its article.
        units: Units of the network's layers, for the error.

    Raises:
        UserError: If a name, a shape or a number is wrong.
    """
    if (odd := next((name for name, its in arrays.items() if not _is_finite(its)), None)) is not None:
        raise UserError(f"'{odd}' of {network} is not finite: the training that wrote it diverged, or it is damaged")
    if not fits(arrays, shapes):
        raise UserError(f"these are not the weights of {network} of {'-'.join(map(str, units))} units")


def load_state_dict(
    module: "torch.nn.Module", arrays: Mapping[str, Array], network: str = "a network", units: Sequence[int] = ()
) -> None:
    """Replaces the weights and biases of a module.

    Args:
        module: The network; it stays as it was if the arrays are refused.
        arrays: As `state_dict` gives them.
        network: See `check`.
        units: See `check`.

    Raises:
        UserError: If these are not the weights of such a module.
    """
    import torch  # here because agents without torch check their weights by this module

    check(arrays, {name: tuple(value.shape) for name, value in module.state_dict().items()}, network, units)
    module.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})
