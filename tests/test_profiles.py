from math import cos, pi, radians, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import linprog

from nnql_bullet.vehicle.profiles import plan_turn, rolled_path, sample_turn, turn_headings, wheel_speeds
from nnql_bullet.vehicle.spec import Limits

TRICYCLE = Limits(yaw_rate=1.5708, yaw_acceleration=7.4, acceleration=2.5)

limits = st.builds(Limits, yaw_rate=st.floats(0.3, 3), yaw_acceleration=st.floats(0.5, 20), acceleration=st.just(2.5))
changes = st.floats(-pi, pi, allow_subnormal=False)
shares = st.floats(-1, 1, allow_subnormal=False)


@given(shares, changes, limits)
@settings(max_examples=100, deadline=None)
def test_turn_reaches_exactly_the_heading_change_and_ends_running_straight(share, change, limits):
    turn = plan_turn(share * limits.yaw_rate, change, limits)
    rate, heading = sample_turn(turn, np.array([turn.duration, turn.duration + 1.0]))
    assert heading == pytest.approx([change, change], abs=1e-9)
    assert rate == pytest.approx([0, 0], abs=1e-9)


@given(shares, changes, limits)
@settings(max_examples=100, deadline=None)
def test_turn_starts_at_the_present_yaw_rate(share, change, limits):
    start = share * limits.yaw_rate
    rate, heading = sample_turn(plan_turn(start, change, limits), np.array([0.0]))
    assert rate == pytest.approx([start], abs=1e-9)
    assert heading.tolist() == [0.0]


@given(shares, changes, limits)
@settings(max_examples=100, deadline=None)
def test_turn_keeps_within_the_limits(share, change, limits):
    turn = plan_turn(share * limits.yaw_rate, change, limits)
    assert min(turn.rise, turn.hold, turn.fall) >= 0
    times = np.linspace(0, turn.duration + 0.1, 2001)
    rate, _ = sample_turn(turn, times)
    assert np.abs(rate).max() <= limits.yaw_rate * (1 + 1e-12)
    assert np.abs(np.diff(rate)).max() <= limits.yaw_acceleration * times[1] * (1 + 1e-6) + 1e-12


@given(shares, changes, limits)
@settings(max_examples=50, deadline=None)
def test_heading_is_the_integral_of_the_rate(share, change, limits):
    turn = plan_turn(share * limits.yaw_rate, change, limits)
    times = np.linspace(0, turn.duration, 2001)
    rate, heading = sample_turn(turn, times)
    kinks = 3 * limits.yaw_acceleration * times[1] ** 2  # the trapezoidal rule is exact but where the rate bends
    assert heading == pytest.approx(cumulative_trapezoid(rate, times, initial=0), abs=kinks + 1e-9)


@given(shares, changes, limits)
@settings(max_examples=50, deadline=None)
def test_turn_to_the_right_mirrors_the_turn_to_the_left(share, change, limits):
    start = share * limits.yaw_rate
    one, other = plan_turn(start, change, limits), plan_turn(-start, -change, limits)
    assert one.duration == pytest.approx(other.duration, abs=1e-9)
    times = np.linspace(0, one.duration + 0.1, 101)
    (rate, heading), (mirrored_rate, mirrored_heading) = sample_turn(one, times), sample_turn(other, times)
    assert rate == pytest.approx(-mirrored_rate, abs=1e-9)
    assert heading == pytest.approx(-mirrored_heading, abs=1e-9)


@given(changes, limits)
@settings(max_examples=100, deadline=None)
def test_turn_from_rest_takes_the_least_time(change, limits):
    rate, acceleration, way = limits.yaw_rate, limits.yaw_acceleration, abs(change)
    triangle = way <= rate**2 / acceleration
    least = 2 * sqrt(way / acceleration) if triangle else way / rate + rate / acceleration
    assert plan_turn(0.0, change, limits).duration == pytest.approx(least, abs=1e-9)


def is_feasible(duration, start, change, limits, pieces=200):
    """Whether some piecewise constant yaw acceleration makes the turn in this time, by linear programming."""
    step = duration / pieces
    rates = np.tril(np.full((pieces, pieces), step))  # the rate after each piece is start + rates @ acceleration
    heading = step**2 * (pieces - 0.5 - np.arange(pieces))
    result = linprog(
        np.zeros(pieces),
        A_ub=np.vstack([rates, -rates]),
        b_ub=np.concatenate([np.full(pieces, limits.yaw_rate - start), np.full(pieces, limits.yaw_rate + start)]),
        A_eq=np.vstack([rates[-1], heading]),
        b_eq=[-start, change - start * duration],
        bounds=(-limits.yaw_acceleration, limits.yaw_acceleration),
    )
    return result.status == 0


@pytest.mark.parametrize(
    ("start", "degrees"), [(0.0, 60), (0.0, 10), (1.5, 60), (1.5, 5), (1.5, -60), (-1.0, 30), (-0.5, -3), (0.7, 0)]
)
def test_no_turn_from_any_rate_is_quicker(start, degrees):
    duration = plan_turn(start, radians(degrees), TRICYCLE).duration
    assert is_feasible(1.02 * duration, start, radians(degrees), TRICYCLE)
    assert not is_feasible(0.98 * duration, start, radians(degrees), TRICYCLE)


@given(shares, changes, st.floats(0, 1))
@settings(max_examples=50, deadline=None)
def test_turn_cut_short_and_planned_again_goes_on_as_before(share, change, cut):
    turn = plan_turn(share * TRICYCLE.yaw_rate, change, TRICYCLE)
    (rate,), (heading,) = sample_turn(turn, np.array([cut * turn.duration]))
    rest = plan_turn(float(rate), change - float(heading), TRICYCLE)
    assert rest.duration == pytest.approx((1 - cut) * turn.duration, abs=1e-6)


def test_no_change_from_rest_is_no_turn():
    turn = plan_turn(0.0, 0.0, TRICYCLE)
    rate, heading = sample_turn(turn, np.linspace(0, 1, 5))
    assert turn.duration == 0
    assert rate.tolist() == [0.0] * 5
    assert heading.tolist() == [0.0] * 5


def test_ending_a_turn_at_once_has_no_hold_and_no_rise():
    turn = plan_turn(1.48, 1.48**2 / (2 * 7.4), TRICYCLE)
    assert turn.duration == pytest.approx(0.2)
    assert turn.fall == pytest.approx(0.2)


def test_sixty_degrees_from_rest_fit_into_0_88_seconds_of_the_tricycle():
    assert plan_turn(0.0, radians(60), TRICYCLE).duration == pytest.approx(0.88, abs=0.005)


def test_thirty_five_degrees_are_reached_in_half_a_second():  # PHYSICS: "about 35 degrees in the first half second"
    _, heading = sample_turn(plan_turn(0.0, radians(60), TRICYCLE), np.array([0.5]))
    assert np.degrees(heading[0]) == pytest.approx(35, abs=1)


@given(st.floats(0.1, 3), st.floats(-2, 2), st.floats(0.2, 1.5), st.floats(0.05, 0.3))
@settings(max_examples=50, deadline=None)
def test_wheel_speeds_invert_the_kinematics_of_a_differential_drive(speed, yaw_rate, track, radius):
    left, right = wheel_speeds(speed, yaw_rate, track, radius)
    assert (left + right) * radius / 2 == pytest.approx(speed)
    assert (right - left) * radius / track == pytest.approx(yaw_rate, abs=1e-12)


def test_wheels_drive_an_arc_of_the_commanded_radius():
    left, right = wheel_speeds(2.0, 1.0, 0.6, 0.125)  # 2 m/s at 1 rad/s: radius 2 m, wheels at 1.7 m and 2.3 m
    assert (left * 0.125, right * 0.125) == pytest.approx((1.7, 2.3))


@given(st.lists(st.tuples(shares, changes), min_size=1, max_size=4), limits)
@settings(max_examples=50, deadline=None)
def test_headings_of_many_turns_are_those_of_each(turns, limits):
    times = np.linspace(0, 2, 9)
    rates, wanted = (np.array(column) for column in zip(*turns, strict=True))
    rates *= limits.yaw_rate
    found = turn_headings(rates[:, None], wanted[:, None] * [1.0, -0.5], limits, times)
    assert found.shape == (len(turns), 2, 9)
    for i, rate in enumerate(rates.tolist()):
        for j, share in enumerate((1.0, -0.5)):
            assert np.array_equal(found[i, j], sample_turn(plan_turn(rate, share * wanted[i], limits), times)[1])


def test_paths_of_many_are_those_of_each():
    ways, turns = np.array([0.2, 0.1, 0.3]), np.array([[0.1, 0.0, -0.3], [0.0, 0.5, 0.5]])
    found = rolled_path(0.7, ways, turns)
    assert found.shape == (2, 3, 2)
    for path, row in zip(found, turns, strict=True):
        x = y = 0.0
        heading = 0.7
        for place, way, turn in zip(path, ways, row, strict=True):
            x, y = x + way * cos(heading + turn / 2), y + way * sin(heading + turn / 2)
            heading += turn
            assert place == pytest.approx([x, y], abs=1e-12)
