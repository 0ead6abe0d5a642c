"""Makes every generator of random numbers in the package."""

import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from enum import IntEnum

import numpy as np

from nnql_bullet.errors import UserError


class Stream(IntEnum):
    """Purpose of a generator. The streams are independent: a change in one does not change the others."""

    LAYOUT = 0
    WORLD = 1
    POLICY = 2
    WEIGHTS = 3
    SENSOR_NOISE = 4
    BOOTSTRAP = 5
    PATROLS = 6
    CHANCE = 7
    REPLAY = 8
    MIX = 9
    DOMAIN_RANDOMIZATION = 10
    BOTTLENECK = 11
    SWEEP = 12


VALIDATION_WORLDS = range(0, 100_000)
TEST_WORLDS = range(100_000, 200_000)
TRAINING_WORLDS = range(1_000_000, 1_000_000_000)
"""Ranges of world seeds. Variants are compared in validation worlds and results are reported in test worlds; training
uses neither. Users may use the seeds from 200 000 to 999 999 for anything."""


def rng(seed: int, stream: Stream, index: int = 0) -> np.random.Generator:
    """Makes a generator whose numbers depend on the arguments alone.

    Args:
        seed: Seed of the world for `Stream.LAYOUT`, `Stream.BOTTLENECK`, `Stream.PATROLS`, `Stream.SENSOR_NOISE` and
            `Stream.CHANCE`; seed of the run for the others.
        stream: Purpose of the numbers.
        index: Number of the episode, or of the attempt to draw a world.
    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(int(stream), index))))


def training_world_seed(seed: int, episode: int) -> int:
    """Draws the seed of the world for one episode of a run."""
    return int(rng(seed, Stream.WORLD, episode).integers(TRAINING_WORLDS.start, TRAINING_WORLDS.stop))


@contextmanager
def fenced(generator: np.random.Generator) -> Iterator[None]:
    """Seeds the global generators of Python, NumPy and torch (if it is loaded), and restores their states afterwards.

    Some libraries draw from the global generators and accept no other; their calls belong inside.

    Args:
        generator: Gives the seed.
    """
    torch = sys.modules.get("torch")  # what has not loaded it draws nothing from it
    python, numpy = random.getstate(), np.random.get_state()
    seed = int(generator.integers(2**32))
    try:
        with torch.random.fork_rng(devices=[]) if torch else nullcontext():
            random.seed(seed)
            np.random.seed(seed)
            if torch:
                torch.default_generator.manual_seed(seed)
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)


def as_seed(given: object) -> int | None:
    """The seed that a caller gave as a whole number of Python or NumPy, or as a `SeedSequence`; None is none.

    Raises:
        UserError: If it is another thing, or negative.
    """
    if given is None:
        return None
    if isinstance(given, np.random.SeedSequence):
        return int(given.generate_state(1, np.uint64)[0])
    if isinstance(given, bool | np.bool_) or not isinstance(given, int | np.integer) or given < 0:
        raise UserError(f"a seed must be a whole number from 0 on, a SeedSequence or None, not {given!r}")
    return int(given)
