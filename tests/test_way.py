"""The shortest way through what a vehicle has seen, against Dijkstra's algorithm on a graph and in plain cases."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from nnql_bullet.geometry import OrientedBox, as_rows, ray_distances
from nnql_bullet.mapping.way import (
    BARRED,
    BESIDE,
    CELLS_ACROSS,
    SIDE,
    TIGHT,
    Surroundings,
    first_surroundings,
    moved_on,
    way_ahead,
    with_scan,
)
from nnql_bullet.vehicle.scale import turning_radius
from nnql_bullet.vehicle.spec import VehicleSpec

VEHICLE = VehicleSpec.load("tricycle")
CELL = 2 * VEHICLE.footprint.half_width / CELLS_ACROSS
MARGIN, REACH = 0.06, turning_radius(VEHICLE.footprint)
START = -12.0, 0.0, 0.0
"""A pose in the target's frame; the target is 12 m ahead."""


def scanned(*boxes: OrientedBox, pose: tuple[float, float, float] = START) -> Surroundings:
    """What a vehicle knows after one scan; the boxes are in the target's frame."""
    x, y, yaw = pose
    at = first_surroundings(hypot(x, y), float(np.arctan2(-y, -x)) - yaw)
    assert at.pose == pytest.approx(START)
    origin = x + cos(yaw) * VEHICLE.sensor.position[0], y + sin(yaw) * VEHICLE.sensor.position[0]
    rays = ray_distances(origin, VEHICLE.sensor.angles + yaw, as_rows(boxes), VEHICLE.sensor.range)
    return with_scan(at, rays, VEHICLE)


def ahead(surroundings: Surroundings) -> float:
    return way_ahead(surroundings, VEHICLE, MARGIN, REACH, np.zeros(2))


def test_in_the_open_the_way_is_straight() -> None:
    """As straight as steps from cell to neighbouring cell can be."""
    assert ahead(scanned()) == pytest.approx(0.0, abs=0.1)
    aside = moved_on(scanned(), np.array([0.0, 3.0, 0.0]), hypot(12.0, 3.0), -np.arctan2(3.0, 12.0))
    assert aside.pose == pytest.approx([-12.0, 3.0, 0.0])
    assert ahead(aside) == pytest.approx(-np.arctan2(3.0, 12.0), abs=pi / 8 + 0.1)


@pytest.mark.parametrize("side", [1, -1])
def test_it_leads_round_the_nearer_end_of_a_wall(side: int) -> None:
    wall = OrientedBox(-8.0, -side * 2.0, 0.3, 4.0)
    assert side * ahead(scanned(wall)) > 0.4


def test_it_leads_out_of_a_dead_end() -> None:
    end = OrientedBox(-8.0, 0.0, 0.3, 2.3)
    sides = [OrientedBox(-10.5, side * 2.0, 2.8, 0.3) for side in (1, -1)]
    assert abs(ahead(scanned(end, *sides))) > pi / 2


def test_what_went_away_is_forgotten() -> None:
    before = scanned(OrientedBox(-8.0, -2.0, 0.3, 4.0))
    nothing = np.full(VEHICLE.sensor.rays, VEHICLE.sensor.range)
    for _ in range(3):
        before = with_scan(before, nothing, VEHICLE)
    assert not before.cells.any()


@pytest.mark.parametrize("seed", range(3))
def test_the_place_ahead_is_on_a_shortest_path(seed: int) -> None:
    """By Dijkstra's algorithm on the grid's graph, with clearances by an exact distance transform."""
    chance, middle = np.random.default_rng(seed), SIDE // 2
    cells = np.zeros((SIDE, SIDE), np.int8)
    for a, b in chance.integers(middle - 25, middle + 25, (25, 2)):
        cells[a : a + 4, b : b + 4] = 3
    pose, corner = np.array([-3.0, 0.7, 0.0]), np.array([-18 - middle, 4 - middle])
    heading = ahead(Surroundings(cells, corner, pose))

    room = np.minimum(distance_transform_edt(cells == 0), REACH / CELL + 1)
    half, fits, radius = CELLS_ACROSS / 2, CELLS_ACROSS / 2 + MARGIN / CELL, REACH / CELL
    costs = np.where(room <= fits, TIGHT, 1 + BESIDE * np.maximum(radius - room, 0) / (radius - half))
    costs[room <= half] = BARRED
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    edges = []
    for da, db in ((1, 0), (0, 1), (1, 1), (1, -1)):
        here = slice(0, SIDE - da), slice(max(-db, 0), SIDE - max(db, 0))
        there = slice(da, SIDE), slice(max(db, 0), SIDE - max(-db, 0))
        edges.append((number[here], number[there], hypot(da, db) * (costs[here] + costs[there]) / 2))
    start, end, weight = (np.concatenate([part.ravel() for part in parts]) for parts in zip(*edges, strict=True))
    graph = csr_array((weight, (start, end)), (SIDE * SIDE, SIDE * SIDE))
    x, y = ((np.indices((SIDE, SIDE)) + 0.5 + corner[:, None, None]) * CELL).reshape(2, -1)
    goals = np.flatnonzero(np.hypot(x + CELL / 2, y + CELL / 2) <= CELL * 1.001)
    first = int(np.argmin(np.hypot(x - pose[0], y - pose[1])))
    reached = dijkstra(graph, directed=False, indices=first)
    onward = dijkstra(graph, directed=False, indices=goals).min(axis=0)
    apart = np.hypot(x - pose[0], y - pose[1])
    seen_there = (apart <= REACH + CELL) & (apart > 0) & (abs(np.arctan2(y - pose[1], x - pose[0]) - heading) < 1e-6)
    assert (reached + onward)[seen_there].min() == pytest.approx(onward[first], rel=0.01)
