import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nnql_bullet.config import parse
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Pose
from nnql_bullet.sim.base import Motion
from nnql_bullet.task import REWARD_TERMS, Property, TaskOptions, ending, reward_terms, state_property

SS, NS, WS, FS = Property.SAFE, Property.NON_SAFE, Property.WINNING, Property.FAILURE
FREE = np.full(8, 10.0)
DEFAULT = TaskOptions()

readings = st.lists(st.floats(0, 10), min_size=8, max_size=8).map(np.array)
distances = st.floats(0, 10)


def motion(touching=False, at_target=False):
    return Motion(
        pose=Pose(0, 0, 0),
        speed=2.0,
        yaw_rate=0.0,
        wheel_speeds=(16.0, 16.0),
        duration=0.5,
        path_length=1.0,
        clearance=1.0,
        heading_error=0.0,
        touching=touching,
        at_target=at_target,
    )


def reading(sector, value):
    values = FREE.copy()
    values[sector] = value
    return values


@pytest.mark.parametrize(
    ("sector", "threshold"), [(0, 5.0), (1, 3.5), (7, 3.5), (2, 0.0), (3, 0.0), (4, 0.0), (5, 0.0), (6, 0.0)]
)
def test_default_thresholds_watch_the_front_and_the_front_sides(sector, threshold):
    assert state_property(reading(sector, threshold), None, DEFAULT) is SS
    if threshold:
        assert state_property(reading(sector, np.nextafter(threshold, 0)), None, DEFAULT) is NS


@pytest.mark.parametrize(
    ("sector", "threshold"), [(0, 6.0), (1, 3.0), (2, 1.0), (3, 1.0), (4, 1.0), (5, 1.0), (6, 1.0), (7, 3.0)]
)
def test_each_threshold_holds_in_its_own_sectors(sector, threshold):
    task = TaskOptions(front_distance=6.0, front_side_distance=3.0, other_distance=1.0)
    assert state_property(reading(sector, threshold), motion(), task) is SS
    assert state_property(reading(sector, threshold - 0.001), motion(), task) is NS


@given(readings, distances, distances, distances)
@settings(max_examples=100, deadline=None)
def test_state_is_non_safe_when_any_sector_is_below_its_threshold(values, front, side, other):
    task = TaskOptions(front_distance=front, front_side_distance=side, other_distance=other)
    below = values[0] < front or min(values[1], values[7]) < side or min(values[2:7]) < other
    assert state_property(values, motion(), task) is (NS if below else SS)


@pytest.mark.parametrize(
    ("touching", "at_target", "expected"), [(True, False, FS), (False, True, WS), (True, True, FS), (False, False, SS)]
)
def test_collision_and_target_decide_before_the_readings(touching, at_target, expected):
    assert state_property(FREE, motion(touching, at_target), DEFAULT) is expected


def test_start_is_judged_by_its_readings():
    assert state_property(FREE, None, DEFAULT) is SS
    assert state_property(np.zeros(8), None, DEFAULT) is NS


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
    terms = reward_terms(before, after, readings_before, readings_after, DEFAULT)
    assert tuple(terms) == REWARD_TERMS
    assert terms == {name: value if name == term else 0.0 for name in REWARD_TERMS}


@pytest.mark.parametrize("reward", [0.2, 0.4, 1.0, -0.3])
def test_reward_that_the_paper_leaves_illegible_is_an_option(reward):
    task = TaskOptions(reward_non_safe_to_safe=reward)
    assert sum(reward_terms(NS, SS, NEAR, FAR, task).values()) == reward


@given(st.sampled_from([SS, NS]), st.sampled_from(list(Property)), readings, readings)
@settings(max_examples=100, deadline=None)
def test_at_most_one_reward_term_is_not_zero(before, after, readings_before, readings_after):
    terms = reward_terms(before, after, readings_before, readings_after, DEFAULT)
    given_terms = [value for value in terms.values() if value]
    assert len(given_terms) == (0 if (before, after) == (SS, SS) else 1)
    assert sum(terms.values()) in {-0.6, -0.4, -0.2, 0.0, 0.4, 1.0}


@pytest.mark.parametrize(
    ("after", "steps", "expected"),
    [
        (SS, 1, None),
        (NS, 499, None),
        (SS, 500, "timeout"),
        (NS, 500, "timeout"),
        (SS, 501, "timeout"),
        (WS, 1, "goal"),
        (WS, 500, "goal"),
        (FS, 1, "collision"),
        (FS, 500, "collision"),
    ],
)
def test_episode_ends_at_goal_collision_or_after_500_steps(after, steps, expected):
    assert ending(after, steps, DEFAULT) == expected


def test_steps_of_an_episode_are_an_option():
    task = TaskOptions(max_steps=3)
    assert [ending(SS, steps, task) for steps in (2, 3)] == [None, "timeout"]


@pytest.mark.parametrize(
    ("key", "value"),
    [("front_distance", 10.1), ("front_side_distance", -0.1), ("other_distance", 11.0), ("max_steps", 0)],
)
def test_thresholds_beyond_the_sensors_and_empty_episodes_are_refused(key, value):
    with pytest.raises(UserError, match=f"task: '{key}': input should be"):
        parse(TaskOptions, {key: value}, "task")
