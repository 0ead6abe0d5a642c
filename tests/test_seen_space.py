"""What recent scans have shown to be free, against discs that are put into the world and scanned."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest

from nnql_bullet.geometry import Array, Circle, OrientedBox, as_rows, ray_distances
from nnql_bullet.mapping.seen_space import CERTAIN, RecentScans, meets_unseen, shown_free
from nnql_bullet.sensing import ray_angles

RAYS, RANGE, SENSOR = 72, 10.0, np.array([0.35, 0.0])
FOOTPRINT = as_rows((OrientedBox(0.35, 0.0, 0.55, 0.325),))[0]
FIRST = float(ray_angles(RAYS)[0])
POSES = np.array([[0.0, 0.0, 0.0], [-0.6, 0.1, 0.1], [-1.3, 0.0, 0.3]])


def scanned(*discs: Circle) -> RecentScans:
    """What the vehicle sees of discs from three poses."""
    rays = []
    for x, y, yaw in POSES:
        origin = x + cos(yaw) * SENSOR[0], y + sin(yaw) * SENSOR[0]
        rays.append(ray_distances(origin, ray_angles(RAYS) + yaw, as_rows(discs), RANGE))
    return RecentScans(np.array(rays), POSES, np.zeros(3))


def free(scans: RecentScans, x: float, y: float, width: float) -> bool:
    return bool(shown_free(x, y, 0.0, 0.0, 0.0, width / 2, scans, 0, len(scans.rays), SENSOR, FIRST))


def met_by_any_ray(x: float, y: float, width: float) -> bool:
    """Whether a disc there would shorten a ray of any scan."""
    return bool((scanned(Circle(x, y, width / 2)).rays < RANGE - 2 * CERTAIN).any())


@pytest.mark.parametrize("width", [0.05, 0.1, 0.2])
def test_a_place_is_free_just_where_a_disc_would_have_been_met(width: float) -> None:
    chance, empty, both = np.random.default_rng(1), scanned(), [0, 0]
    for _ in range(200):
        x, y = chance.uniform(-4.0, 6.0), chance.uniform(-4.0, 4.0)
        if all(hypot(x - px - 0.35, y - py) > 0.6 for px, py, _ in POSES):
            met = met_by_any_ray(x, y, width)
            assert free(empty, x, y, width) == met
            both[met] += 1
    assert min(both) > 10


def test_a_disc_that_stands_there_is_never_shown_away() -> None:
    chance = np.random.default_rng(2)
    for _ in range(200):
        x, y, width = chance.uniform(0.9, 5.0), chance.uniform(-3.0, 3.0), chance.uniform(0.1, 0.4)
        assert not free(scanned(Circle(x, y, width / 2)), x, y, width)


def straight(length: float) -> Array:
    return np.array([[x, 0.0, 0.0] for x in np.arange(0.05, length + 1e-9, 0.05)])


def test_no_way_leads_through_a_disc_of_the_width() -> None:
    """Discs of that width everywhere on the way, seen or not: a way that is admitted meets none of them."""
    chance = np.random.default_rng(3)
    for _ in range(150):
        x, y = chance.uniform(1.2, 3.0), chance.uniform(-0.35, 0.35)
        way = straight(x - 0.9)  # into the disc
        assert meets_unseen(way, FOOTPRINT, 0.05, 0.2, scanned(Circle(x, y, 0.1)), SENSOR, FIRST)


def test_how_far_one_scan_leads_is_the_distance_at_which_two_rays_leave_room() -> None:
    width, margin = 0.15, 0.05
    together = width / 2 / sin(pi / RAYS)
    alone = RecentScans(np.full((1, RAYS), RANGE), np.zeros((1, 3)), np.zeros(1))
    farthest = max(
        length
        for length in np.arange(0.1, 2.0, 0.05)
        if not meets_unseen(straight(length), FOOTPRINT, margin, width, alone, SENSOR, FIRST)
    )
    ahead = together - margin - width / 2 - 0.55
    assert ahead - 0.25 < farthest < ahead + 0.05


def test_a_blind_arc_is_not_driven_into() -> None:
    rays = np.full((1, RAYS), RANGE)
    rays[0, np.abs(np.angle(np.exp(1j * (ray_angles(RAYS) - pi)))) < 0.8] = 0.0
    blind = RecentScans(rays, np.zeros((1, 3)), np.zeros(1))
    back = straight(0.4) * [-1.0, 1.0, 1.0]
    assert meets_unseen(back, FOOTPRINT, 0.05, 0.2, blind, SENSOR, FIRST)
    assert not meets_unseen(straight(0.4), FOOTPRINT, 0.05, 0.2, blind, SENSOR, FIRST)
