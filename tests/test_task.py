from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nnql_bullet.config import parse
from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.rollout import Tally
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import (
    ENDINGS,
    NO_ENDING,
    REWARD_TERMS,
    RewardTerm,
    StateProperty,
    TaskOptions,
    ending,
    is_safe,
    paper_reward,
    readings_of,
    reward_terms,
    state_property,
)
from nnql_bullet.vehicle.controller import DriveOptions

SS, NS, WS, FS = StateProperty.SAFE, StateProperty.NON_SAFE, StateProperty.WINNING, StateProperty.FAILURE
FREE = np.full(8, 10.0)
DEFAULT = TaskOptions()

readings = st.lists(st.floats(0, 10), min_size=8, max_size=8).map(np.array)
distances = st.floats(0, 10)
properties = st.sampled_from(list(StateProperty))
going_on = st.sampled_from([SS, NS])


def rows_of(*parts):
    """Several vehicles at once, each a tuple of these."""
    return st.lists(st.tuples(*parts), min_size=1, max_size=6)


def reading(sector, value):
    values = FREE.copy()
    values[sector] = value
    return values


def sensed(values, task):
    """The property that the readings alone give."""
    return state_property(values, False, False, task)


@dataclass(frozen=True)
class State:
    """What the paper's terms need of an observation."""

    state_property: int
    readings: np.ndarray


def rewarded(before, after, readings_before, readings_after, task=DEFAULT):
    """The paper's terms of one step or of many."""
    return reward_terms(State(before, readings_before), State(after, readings_after), task, paper_reward(task))


def named(terms):
    """The terms of one step by name."""
    assert terms.shape == (len(REWARD_TERMS),)
    return dict(zip(REWARD_TERMS, terms.tolist(), strict=True))


@pytest.mark.parametrize(
    ("sector", "threshold"), [(0, 5.0), (1, 3.5), (7, 3.5), (2, 0.0), (3, 0.0), (4, 0.0), (5, 0.0), (6, 0.0)]
)
def test_default_thresholds_watch_the_front_and_the_front_sides(sector, threshold):
    assert sensed(reading(sector, threshold), DEFAULT) == SS
    if threshold:
        assert sensed(reading(sector, np.nextafter(threshold, 0)), DEFAULT) == NS


@pytest.mark.parametrize(
    ("sector", "threshold"), [(0, 6.0), (1, 3.0), (2, 1.0), (3, 1.0), (4, 1.0), (5, 1.0), (6, 1.0), (7, 3.0)]
)
def test_each_threshold_holds_in_its_own_sectors(sector, threshold):
    task = TaskOptions(front_distance=6.0, front_side_distance=3.0, other_distance=1.0)
    assert sensed(reading(sector, threshold), task) == SS
    assert sensed(reading(sector, threshold - 0.001), task) == NS


@given(readings, distances, distances, distances)
@settings(max_examples=100, deadline=None)
def test_state_is_non_safe_when_any_sector_is_below_its_threshold(values, front, side, other):
    task = TaskOptions(front_distance=front, front_side_distance=side, other_distance=other)
    below = values[0] < front or min(values[1], values[7]) < side or min(values[2:7]) < other
    assert is_safe(values, task) == (not below)
    assert sensed(values, task) == (NS if below else SS)


@pytest.mark.parametrize(
    ("touching", "at_target", "expected"), [(True, False, FS), (False, True, WS), (True, True, FS), (False, False, SS)]
)
def test_collision_and_target_decide_before_the_readings(touching, at_target, expected):
    assert state_property(FREE, touching, at_target, DEFAULT) == expected
    if expected is not SS:
        assert state_property(np.zeros(8), touching, at_target, DEFAULT) == expected


def test_without_events_as_at_the_start_the_readings_decide():
    assert sensed(FREE, DEFAULT) == SS
    assert sensed(np.zeros(8), DEFAULT) == NS


@given(rows_of(readings, st.booleans(), st.booleans()), distances, distances)
@settings(max_examples=100, deadline=None)
def test_states_of_many_vehicles_are_those_of_each(rows, front, side):
    task = TaskOptions(front_distance=front, front_side_distance=side)
    values, touching, at_target = (np.array(column) for column in zip(*rows, strict=True))
    expected = []
    for one, touches, arrived in rows:
        below = one[0] < front or min(one[1], one[7]) < side
        expected.append(FS if touches else WS if arrived else NS if below else SS)
    assert state_property(values, touching, at_target, task).tolist() == expected
    assert [int(state_property(*row, task)) for row in rows] == expected
    assert is_safe(values, task).tolist() == [bool(is_safe(one, task)) for one in values]


def test_property_is_named_by_the_papers_two_letters():
    assert {state: state.label for state in StateProperty} == {SS: "SS", NS: "NS", WS: "WS", FS: "FS"}


NEAR, FAR = reading(3, 2.0), reading(5, 4.0)


@pytest.mark.parametrize(
    ("before", "after", "readings_before", "readings_after", "term", "value"),
    [
        (NS, SS, NEAR, FAR, "non_safe_to_safe", 0.4),
        (NS, SS, FAR, NEAR, "non_safe_to_safe", 0.4),
        (SS, NS, FAR, NEAR, "safe_to_non_safe", -0.2),
        (SS, NS, NEAR, FAR, "safe_to_non_safe", -0.2),
        (NS, NS, FAR, NEAR, "closer", -0.4),
        (NS, NS, NEAR, FAR, "away", 0.4),
        (NS, NS, NEAR, NEAR, "away", 0.4),
        (NS, NS, reading(0, 2.0), reading(7, 1.999), "closer", -0.4),
        (SS, WS, FAR, NEAR, "winning", 1.0),
        (NS, WS, FAR, NEAR, "winning", 1.0),
        (SS, FS, FAR, NEAR, "failure", -0.6),
        (NS, FS, NEAR, FAR, "failure", -0.6),
        (SS, SS, FAR, NEAR, None, 0.0),
        (SS, SS, NEAR, FAR, None, 0.0),
    ],
)
def test_rewards_are_the_papers(before, after, readings_before, readings_after, term, value):
    terms = rewarded(before, after, readings_before, readings_after)
    assert named(terms) == {name: value if name == term else 0.0 for name in REWARD_TERMS}


def test_reward_terms_are_named_in_the_papers_order():
    assert REWARD_TERMS == ("non_safe_to_safe", "safe_to_non_safe", "closer", "away", "winning", "failure")


@pytest.mark.parametrize("reward", [0.2, 0.4, 1.0, -0.3])
def test_reward_that_the_paper_leaves_illegible_is_an_option(reward):
    task = TaskOptions(reward_non_safe_to_safe=reward)
    assert rewarded(NS, SS, NEAR, FAR, task).tolist() == [reward, 0, 0, 0, 0, 0]


@given(going_on, properties, readings, readings)
@settings(max_examples=100, deadline=None)
def test_at_most_one_reward_term_is_not_zero(before, after, readings_before, readings_after):
    terms = rewarded(before, after, readings_before, readings_after)
    given_terms = [value for value in terms.tolist() if value]
    assert len(given_terms) == (0 if (before, after) == (SS, SS) else 1)
    assert terms.sum() in {-0.6, -0.4, -0.2, 0.0, 0.4, 1.0}


def by_the_table(before, after, readings_before, readings_after):
    """The name of the reward, read off II.C."""
    if after in (WS, FS):
        return "winning" if after == WS else "failure"
    if before != after:
        return "non_safe_to_safe" if after == SS else "safe_to_non_safe"
    if after == SS:
        return None
    return "closer" if min(readings_after) < min(readings_before) else "away"


@given(rows_of(going_on, properties, readings, readings))
@settings(max_examples=100, deadline=None)
def test_rewards_of_many_steps_are_those_of_each(rows):
    terms = rewarded(*(np.array(column) for column in zip(*rows, strict=True)))
    assert terms.shape == (len(rows), 6)
    for row, got in zip(rows, terms, strict=True):
        assert [name for name, value in named(got).items() if value] == list(filter(None, [by_the_table(*row)]))
        assert got.tolist() == rewarded(*row).tolist()


@pytest.mark.parametrize("before", [WS, FS])
@pytest.mark.parametrize("after", list(StateProperty))
def test_there_is_no_reward_after_an_ending(before, after):
    assert rewarded(before, after, FAR, NEAR).tolist() == [0] * 6


def turning(s_tm1, s_t, task):
    return np.abs(s_t.yaw_rate)


def test_a_reward_takes_a_further_term_and_an_episode_sums_it_up(vehicle, empty_world):
    reward = (*paper_reward(DEFAULT), RewardTerm(turning, -0.1))
    navigation = Navigation(KinematicSimulator(vehicle, DriveOptions(), 1), DEFAULT, reward)
    navigation.reset({0: empty_world})
    tally, rewards, turned = Tally(navigation), 0.0, 0.0
    tally.reset(0, 0)
    while not tally.over[0]:
        transition = navigation.step(np.array([1]))
        tally.add(transition)
        rewards, turned = rewards + transition.r_t[0], turned + abs(transition.s_t.yaw_rate[0])
    summary = tally.summary(0)
    assert list(summary.terms) == [*REWARD_TERMS, "turning"]
    assert turned > 1
    assert summary.terms["turning"] == pytest.approx(-0.1 * turned)
    assert summary.episode_return == pytest.approx(rewards)


def ended(after, steps, task=DEFAULT):
    """The name of the ending of one episode, or None."""
    index = int(ending(after, steps, task))
    return None if index == NO_ENDING else ENDINGS[index]


CASES = [
    (SS, 1, None),
    (NS, 499, None),
    (SS, 500, "timeout"),
    (NS, 500, "timeout"),
    (SS, 501, "timeout"),
    (WS, 1, "goal"),
    (WS, 500, "goal"),
    (FS, 1, "collision"),
    (FS, 500, "collision"),
]


@pytest.mark.parametrize(("after", "steps", "expected"), CASES)
def test_episode_ends_at_goal_collision_or_after_500_steps(after, steps, expected):
    assert ended(after, steps) == expected


def test_endings_of_many_episodes_are_those_of_each():
    after, steps, expected = zip(*CASES, strict=True)
    got = ending(np.array(after), np.array(steps), DEFAULT)
    assert [None if index == NO_ENDING else ENDINGS[index] for index in got.tolist()] == list(expected)
    assert NO_ENDING not in range(len(ENDINGS))


@pytest.mark.parametrize(
    ("after", "steps", "staying", "expected"),
    [(SS, 70, 29.9, None), (NS, 70, 30.0, "stuck"), (SS, 500, 30.0, "stuck"), (FS, 70, 30.0, "collision")],
)
def test_who_stays_about_one_place_for_long_is_stuck(after, steps, staying, expected):
    task, never = TaskOptions(stuck_after=30.0), TaskOptions(stuck_after=0.0)
    assert ENDINGS[:3] == ("goal", "collision", "timeout")  # results tell endings by their names and places
    for options, end in ((task, expected), (never, ended(after, steps))):
        index = int(ending(after, steps, options, staying))
        assert (None if index == NO_ENDING else ENDINGS[index]) == end


@pytest.mark.parametrize("after", [SS, WS, FS])
def test_who_tips_over_has_overturned_in_place_of_a_collision(after):
    expected = "overturned" if after == FS else ended(after, 70)
    index = int(ending(after, 70, DEFAULT, overturned=True))
    assert (None if index == NO_ENDING else ENDINGS[index]) == expected
    assert ENDINGS[3:] == ("stuck", "overturned")


def test_steps_of_an_episode_are_an_option():
    task = TaskOptions(max_steps=3)
    assert [ended(SS, steps, task) for steps in (2, 3)] == [None, "timeout"]


@pytest.mark.parametrize(
    ("key", "value"),
    [("front_distance", 100.1), ("front_side_distance", -0.1), ("other_distance", 101.0), ("max_steps", 0)],
)
def test_thresholds_beyond_the_sensors_and_empty_episodes_are_refused(key, value):
    with pytest.raises(UserError, match=f"task: '{key}': input should be"):
        parse(TaskOptions, {key: value}, "task")


class TestReadingsOtherThanTheNearest:
    def test_the_middle_ray_passes_by_what_the_nearest_sees(self):
        rays = np.full(72, 10.0)
        rays[[0, 4, 13]] = 2.0, 6.0, 3.0  # a side ray and the middle of the front sector, the middle of the next
        assert readings_of(rays, TaskOptions()).tolist() == [2.0, 3.0, *[10.0] * 6]
        assert readings_of(rays, TaskOptions(sector_reading="middle")).tolist() == [6.0, 3.0, *[10.0] * 6]

    def test_many_vehicles_read_as_each_does(self):
        rays = np.random.default_rng(0).uniform(0, 10, (5, 72))
        for task in (TaskOptions(), TaskOptions(sector_reading="middle")):
            assert readings_of(rays, task).tolist() == [readings_of(row, task).tolist() for row in rays]


class TestHysteresis:
    TASK = TaskOptions(hysteresis=1.0)

    @pytest.mark.parametrize(
        ("front", "before", "after"),
        [(5.5, SS, SS), (5.5, NS, NS), (4.9, SS, NS), (6.0, NS, SS), (5.999, NS, NS), (4.9, NS, NS)],
    )
    def test_a_non_safe_state_becomes_safe_only_farther_off(self, front, before, after):
        assert state_property(reading(0, front), False, False, self.TASK, before) == after

    def test_sectors_that_are_not_watched_stay_unwatched(self):
        assert state_property(reading(4, 0.1), False, False, self.TASK, NS) == SS

    def test_many_vehicles_have_each_their_own_past(self):
        values = np.stack([reading(0, 5.5)] * 2)
        assert state_property(values, np.zeros(2, bool), np.zeros(2, bool), self.TASK, np.array([SS, NS])).tolist() == [
            SS,
            NS,
        ]


def test_closer_may_mean_the_mean_reading():
    before, after = reading(0, 3.0), reading(0, 3.5)
    after[4] = 8.0  # the smallest rose, the mean fell
    smallest = named(rewarded(NS, NS, before, after))
    mean = named(rewarded(NS, NS, before, after, TaskOptions(closer="mean")))
    assert (smallest["away"], smallest["closer"]) == (0.4, 0.0)
    assert (mean["away"], mean["closer"]) == (0.0, -0.4)
