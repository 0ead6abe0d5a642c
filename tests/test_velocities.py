"""The velocities of what three scans show: against boxes that are moved by a known velocity."""

import numpy as np
import pytest

from nnql_bullet.geometry import OrientedBox, as_rows, ray_distances
from nnql_bullet.mapping.velocities import velocities
from nnql_bullet.vehicle.spec import VehicleSpec

PERIOD, FASTEST, RANGE = 0.5, 1.2, 10.0


def found(speed, direction, moved, away=3.0):
    """What is found of a box ahead, in the fixed frame, and how many points move, beside one that stands."""
    angles = VehicleSpec.load("tricycle").sensor.angles
    poses, scans = np.stack([np.zeros(3), moved / 2, moved]), []
    for k in range(3):
        way = k * PERIOD * speed
        box = OrientedBox(away + way * np.cos(direction), way * np.sin(direction), 0.6, 0.6, direction)
        shapes = as_rows((box, OrientedBox(-3.0, 0.0, 0.6, 0.6, 0.3)))
        scans.append(ray_distances((poses[k, 0], poses[k, 1]), poses[k, 2] + angles, shapes, RANGE))
    now, before = scans[2][None], np.stack(scans[1::-1])[None]
    v = velocities(now, before, poses[None, 2], poses[None, 1::-1], np.zeros(2), angles, RANGE, PERIOD, FASTEST, 1.0)[0]
    c, s = np.cos(moved[2]), np.sin(moved[2])
    v = v @ np.array([[c, s], [-s, c]])
    ahead = np.cos(moved[2] + angles) > 0.0
    assert not v[~ahead].any()
    return v[v.any(axis=-1)]


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (0.5, 0.1, 0.4)])
@pytest.mark.parametrize("speed", [0.6, 1.0])
@pytest.mark.parametrize("direction", [np.pi, np.pi / 2, -2.0, 0.3], ids=["comes", "crosses", "nears", "leaves"])
def test_an_obstacle_that_moves_has_its_velocity(direction, speed, moved):
    v = found(speed, direction, np.array(moved))
    assert len(v) > 2
    assert (v == v[0]).all()
    assert v[0] == pytest.approx([speed * np.cos(direction), speed * np.sin(direction)], abs=0.3)


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (0.5, 0.1, 0.4)])
def test_what_stands_has_none(moved):
    assert len(found(0.0, 0.2, np.array(moved))) == 0
