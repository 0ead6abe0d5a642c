from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nnql_bullet.sensing import FRONT, FRONT_LEFT, FRONT_RIGHT, ray_angles, sector_readings


def wrapped(angles):
    return np.angle(np.exp(1j * np.asarray(angles)))


def test_seventy_two_rays_are_evenly_spaced_over_the_circle():
    angles = ray_angles()
    assert angles.shape == (72,)
    assert np.diff(angles) == pytest.approx(np.full(71, 2 * pi / 72))
    assert angles[0] + 2 * pi - angles[-1] == pytest.approx(2 * pi / 72)


def test_sector_0_is_centred_straight_ahead_with_a_ray_on_its_axis():
    front = ray_angles()[:9]
    assert front == pytest.approx(-front[::-1])
    assert front[4] == pytest.approx(0)


def test_sectors_follow_counter_clockwise_every_45_degrees():
    off = wrapped(ray_angles().reshape(8, 9) - np.arange(8)[:, None] * pi / 4)
    assert off.mean(axis=1) == pytest.approx(np.zeros(8), abs=1e-12)
    assert np.abs(off).max() < pi / 8


def test_front_and_front_sides_are_named_as_they_lie():
    centres = wrapped(ray_angles().reshape(8, 9)[:, 4])
    assert centres[[FRONT, FRONT_LEFT, FRONT_RIGHT]] == pytest.approx([0, pi / 4, -pi / 4], abs=1e-12)


@given(st.lists(st.lists(st.floats(0, 10), min_size=72, max_size=72), min_size=1, max_size=4))
@settings(max_examples=50, deadline=None)
def test_sectors_of_many_vehicles_are_those_of_each(rows):
    expected = [[min(row[9 * k : 9 * k + 9]) for k in range(8)] for row in rows]
    assert sector_readings(np.array(rows)).tolist() == expected


def test_one_near_ray_changes_one_sector_alone():
    distances = np.where(np.eye(72), 1.5, 10.0)
    sectors = np.round(ray_angles() / (pi / 4)) % 8
    expected = np.where(sectors[:, None] == np.arange(8), 1.5, 10.0)
    assert sector_readings(distances).tolist() == expected.tolist()
