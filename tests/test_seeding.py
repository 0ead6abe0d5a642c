import random
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nnql_bullet.seeding import (
    TEST_WORLDS,
    TRAINING_WORLDS,
    VALIDATION_WORLDS,
    Stream,
    fenced,
    rng,
    training_world_seed,
)

seeds = st.integers(0, 2**63)
episodes = st.integers(0, 10**6)


def numbers(*arguments):
    return tuple(rng(*arguments).integers(0, 2**32, 8).tolist())


@given(seeds, st.sampled_from(Stream), episodes)
@settings(max_examples=50, deadline=None)
def test_generator_is_a_function_of_its_arguments_alone(seed, stream, index):
    first = numbers(seed, stream, index)
    rng(seed, stream, index + 1).random(3)
    assert numbers(seed, stream, index) == first


def test_every_seed_stream_and_index_gives_numbers_of_its_own():
    drawn = [numbers(seed, stream, index) for seed in range(8) for stream in Stream for index in range(8)]
    assert len(set(drawn)) == 8 * len(Stream) * 8


def test_streams_are_not_shifted_copies_of_one_another():
    long = {stream: rng(3, stream).integers(0, 2**63, 2000).tolist() for stream in Stream}
    everything = [number for values in long.values() for number in values]
    assert len(set(everything)) == len(everything)


# Worlds, runs and tables depend on these streams. Change these numbers only on purpose.
def test_streams_give_the_numbers_that_they_always_gave():
    first = {
        (0, Stream.LAYOUT): [73979004, 2427222451, 3906231730],
        (0, Stream.WORLD): [2081501252, 4060103576, 4165089906],
        (0, Stream.POLICY): [472184452, 1139465299, 2943609711],
        (0, Stream.WEIGHTS): [856055097, 1142220351, 2654721721],
        (7, Stream.POLICY, 3): [1621067160, 2437928813, 562358361],
    }
    assert {arguments: rng(*arguments).integers(0, 2**32, 3).tolist() for arguments in first} == first


@given(seeds, episodes)
@settings(max_examples=100, deadline=None)
def test_training_worlds_are_neither_validation_nor_test_worlds(seed, episode):
    world = training_world_seed(seed, episode)
    assert world in TRAINING_WORLDS
    assert world not in VALIDATION_WORLDS
    assert world not in TEST_WORLDS


def test_training_validation_and_test_worlds_have_no_seed_in_common():
    ranges = sorted((VALIDATION_WORLDS, TEST_WORLDS, TRAINING_WORLDS), key=lambda seeds: seeds.start)
    assert all(one.stop <= other.start for one, other in pairwise(ranges))
    assert all(len(seeds) >= 100_000 for seeds in ranges)


def test_training_worlds_differ_from_episode_to_episode_and_from_run_to_run():
    drawn = [training_world_seed(seed, episode) for seed in range(5) for episode in range(100)]
    assert len(set(drawn)) == 500


def test_training_worlds_are_reproducible():
    assert [training_world_seed(0, episode) for episode in range(3)] == [485152638, 400741349, 696120742]


def drawn_globally():
    """From Python's, NumPy's and torch's generators."""
    return random.random(), np.random.random(), float(torch.rand(1))


class TestFence:
    def test_what_is_drawn_inside_follows_from_the_generator_alone(self):
        found = []
        for disturbance in (1, 2):
            random.seed(disturbance)
            with fenced(rng(3, Stream.POLICY, 5)):
                found.append((drawn_globally(), drawn_globally()))
        assert found[0] == found[1]
        assert found[0][0] != found[0][1]
        with fenced(rng(3, Stream.POLICY, 6)):
            assert drawn_globally() != found[0][0]

    @pytest.mark.parametrize("raises", [False, True])
    def test_outside_everything_goes_on_as_if_nothing_had_been_drawn(self, raises):
        random.seed(1)
        np.random.seed(1)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(1)
            expected = [drawn_globally(), drawn_globally()]
            random.seed(1)
            np.random.seed(1)
            torch.manual_seed(1)
            found = [drawn_globally()]
            with suppress(ZeroDivisionError), fenced(rng(3, Stream.POLICY)):
                drawn_globally()
                if raises:
                    raise ZeroDivisionError
            found.append(drawn_globally())
        assert found == expected

    def test_fences_stand_inside_one_another(self):
        with fenced(rng(1, Stream.POLICY)):
            expected = [drawn_globally(), drawn_globally()]
        with fenced(rng(1, Stream.POLICY)):
            found = [drawn_globally()]
            with fenced(rng(2, Stream.POLICY)):
                drawn_globally()
            found.append(drawn_globally())
        assert found == expected
