"""Every generator of random numbers in the package is made here."""

import random
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What a generator is used for. Streams never share numbers, so a change in one leaves the others as they were."""

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


VALIDATION_WORLDS = range(0, 100_000)
TEST_WORLDS = range(100_000, 200_000)
TRAINING_WORLDS = range(1_000_000, 1_000_000_000)
"""World seeds: choices are made on validation worlds, tables on test worlds, and training draws from neither.
The seeds from 200 000 to 999 999 belong to users."""


def rng(seed: int, stream: Stream, index: int = 0) -> np.random.Generator:
    """A generator that is a function of its arguments alone.

    Args:
        seed: The seed of the run, or of the world for `Stream.LAYOUT`, `Stream.PATROLS`, `Stream.SENSOR_NOISE` and
            `Stream.CHANCE`.
        stream: What the numbers are for.
        index: Counts within the stream: the episode, or the attempt at a world.
    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(int(stream), index))))


def training_world_seed(seed: int, episode: int) -> int:
    """The world that episode number `episode` of the run `seed` is driven in."""
    return int(rng(seed, Stream.WORLD, episode).integers(TRAINING_WORLDS.start, TRAINING_WORLDS.stop))


@contextmanager
def fenced(generator: np.random.Generator) -> Iterator[None]:
    """A fence around libraries that take no generator, but draw from the global ones of Python, NumPy and torch.

    Inside, these are seeded from `generator`; afterwards they go on as if nothing had been drawn.
    """
    import torch  # not at the top: processes that only simulate import this module too

    python, numpy = random.getstate(), np.random.get_state()
    seed = int(generator.integers(2**32))
    try:
        with torch.random.fork_rng(devices=[]):
            random.seed(seed)
            np.random.seed(seed)
            torch.default_generator.manual_seed(seed)
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)
