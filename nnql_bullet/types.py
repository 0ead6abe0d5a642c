"""Types that several modules share: numbers of options with their bounds, and arrays and tuples of numbers.

Every size has an upper bound here: far above what anybody needs, and low enough that a slip of the keyboard is refused
at once. What is within the bounds may still need more memory than a machine has; see `memory.py`.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

LARGEST = 1e6
"""Largest magnitude of a number that has no bound of its own, in its unit."""

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(gt=0, le=LARGEST)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST)]
UnitInterval = Annotated[float, Field(ge=0, le=1)]
Extent = Annotated[float, Field(gt=0, le=1000)]
"""Of a world or of a box in it [m]."""
Reach = Annotated[float, Field(ge=0, le=100)]
"""Of a prediction or a margin around the vehicle [m]."""
Speed = Annotated[float, Field(gt=0, le=50)]
"""[m/s]"""
Period = Annotated[float, Field(gt=0, le=60)]
"""Time between decisions [s]."""

Seed = Annotated[int, Field(ge=0, lt=2**63)]
Count = Annotated[int, Field(ge=1, le=1_000_000_000)]
"""Of episodes or steps that are only counted."""
Steps = Annotated[int, Field(ge=1, le=100_000)]
"""Decisions of an episode."""
Vehicles = Annotated[int, Field(ge=1, le=4096)]
Units = Annotated[int, Field(ge=1, le=4096)]
"""Of a layer of a network."""
Layers = Annotated[tuple[Units, ...], Field(max_length=8)]
"""Units of each hidden layer of a network."""
Frames = Annotated[int, Field(ge=1, le=64)]
"""Moments that a network sees at once."""
BatchSize = Annotated[int, Field(ge=1, le=65_536)]
BufferSize = Annotated[int, Field(ge=1, le=1_000_000_000)]
"""Steps in a replay buffer."""
Few = Annotated[int, Field(ge=1, le=1000)]
"""Of what is repeated, tried or placed one by one."""
Population = Annotated[int, Field(ge=2, le=10_000)]

Bytes = NDArray[np.uint8]
Vector = tuple[float, float, float]
