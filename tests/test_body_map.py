"""The map at the scale of the body, and the cost of the way left: against SciPy's Dijkstra and closed forms."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from nnql_bullet.mapping.body_map import (
    BARRED,
    CELLS_ACROSS,
    FARTHER,
    FREE,
    LOCAL,
    OCCUPIED,
    PASSED,
    PASSED_THIN,
    SIDE,
    TRIED,
    UNSEEN,
    add_scans,
    cost_at,
    cost_factors,
    costs_to_go,
)

CELL = 0.2


def by_scipy(factors, goal):
    """Costs of the ways to a place in cells, by SciPy, over the graph that `costs_to_go` states."""
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    starts, ends, costs = [], [], []
    for da, db in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a, b = np.mgrid[0 : SIDE - da, max(0, -db) : SIDE - max(0, db)]
        starts.append(number[a, b].ravel())
        ends.append(number[a + da, b + db].ravel())
        costs.append((np.hypot(da, db) / 2 * (factors[a, b] + factors[a + da, b + db])).ravel())
    a, b = np.mgrid[0:SIDE, 0:SIDE]
    away = np.hypot(a - goal[0], b - goal[1])
    edge = (a % (SIDE - 1) == 0) | (b % (SIDE - 1) == 0)
    first = edge | ((abs(a - goal[0]) <= 0.5) & (abs(b - goal[1]) <= 0.5))
    starts.append(np.full(first.sum(), SIDE * SIDE))
    ends.append(number[first])
    costs.append(away[first] + 1e-9)
    graph = csr_matrix((np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends))), (SIDE**2 + 1,) * 2)
    return dijkstra(graph, directed=False, indices=SIDE * SIDE)[:-1].reshape(SIDE, SIDE)


@pytest.mark.parametrize("goal", [(SIDE / 2 + 20.3, SIDE / 2 - 30.1), (SIDE + 60.0, 40.0)])
def test_the_way_left_is_that_of_dijkstra(goal):
    rng = np.random.default_rng(1)
    factors = np.ones((SIDE, SIDE), np.float32)
    for a, b in rng.integers(0, SIDE - 12, (60, 2)):
        factors[a : a + rng.integers(1, 12), b : b + rng.integers(1, 12)] = rng.choice([2.0, 4.0, BARRED])
    corner = np.array([-70, 30])
    here = SIDE // 2
    place, target = (np.array([here, here]) + corner + 0.5) * CELL, (np.array(goal) + corner + 0.5) * CELL
    left = costs_to_go(factors, corner, place, target, CELL)
    expected = by_scipy(factors.astype(float), goal)
    near = slice(here - int(LOCAL), here + int(LOCAL) + 1)
    wanted = expected[near, near] < expected[here, here] + FARTHER - 1
    np.testing.assert_allclose(left[near, near][wanted], expected[near, near][wanted], rtol=1e-4)
    assert (left[near, near] >= expected[near, near] * (1 - 1e-4)).all()
    assert cost_at(left, corner, *place, CELL, np.inf) == pytest.approx(expected[here, here], rel=1e-4)


@pytest.mark.parametrize("yaw", [0.0, 0.3, np.pi / 4, 1.2])
@pytest.mark.parametrize(("gap", "fits"), [(0.9, False), (1.1, True)])
def test_a_gap_is_as_wide_as_it_is_however_the_cells_lie(yaw, gap, fits):
    """Between two rows of posts a way leads through, wherever it lies among the cells, if the vehicle fits."""
    for shift in np.linspace(0.0, 1.0, 7):
        cells, offsets = np.full((SIDE, SIDE), FREE, np.int8), np.zeros((SIDE, SIDE, 2), np.uint8)
        for side in (-1, 1):
            for k in np.arange(0.5 * gap * CELLS_ACROSS, 60.0, 0.4)[::-1]:  # a cell keeps its last point
                place = np.array([-np.sin(yaw), np.cos(yaw)]) * side * k + SIDE / 2 + shift
                a, b = np.floor(place).astype(int)
                cells[a, b] = OCCUPIED
                offsets[a, b] = (256 * (place - (a, b))).astype(int)
        factors = cost_factors(cells, offsets)
        ahead = 12 * np.array([np.cos(yaw), np.sin(yaw)])
        corner, middle = np.zeros(2, np.int64), np.full(2, SIDE / 2 + shift)
        left = costs_to_go(factors, corner, middle - ahead, middle + ahead, 1.0)
        cost = cost_at(left, corner, *(middle - ahead), 1.0, np.inf)
        assert (cost < 70.0) == fits


def scanned(rays, times=1, cells=None, offsets=None, corners=None):
    """A map after scans of rays [m] that lie evenly all round, from the landmark's place."""
    cells = np.zeros((1, SIDE, SIDE), np.int8) if cells is None else cells
    offsets = np.zeros((1, SIDE, SIDE, 2), np.uint8) if offsets is None else offsets
    corners = np.zeros((1, 2), np.int64) if corners is None else corners
    angles = np.arange(len(rays)) * 2 * np.pi / len(rays)
    for _ in range(times):
        add_scans(cells, offsets, corners, np.zeros((1, 3)), np.array([rays]), np.zeros(2), angles, 10.0, CELL)
    return cells[0], offsets[0], corners[0]


def test_scans_tell_what_is_free_what_is_occupied_and_what_was_never_seen():
    cells, offsets, corner = scanned([3.03, 10.0, 10.0, 10.0])
    a, b = int(3.03 / CELL) - corner[0], -corner[1]
    assert cells[a, b] == OCCUPIED
    assert (a + corner[0] + offsets[a, b, 0] / 256) * CELL == pytest.approx(3.03, abs=CELL / 128)
    assert (cells[-corner[0] + 2 : a - 2, b] == FREE).all()
    assert (cells[a + 1 :, b] == UNSEEN).all()
    assert cells[a - 3, b + 3] == UNSEEN


def test_where_a_vehicle_stays_its_way_costs_more_with_every_decision():
    corner = -np.full(2, SIDE // 2)
    costs = []
    for times in (1, 5, 9):
        cells, offsets, _ = scanned([10.0, 10.0, 10.0, 10.0], times)
        left = costs_to_go(cost_factors(cells, offsets), corner, np.zeros(2), np.array([3.0, 0.0]), CELL)
        costs.append(cost_at(left, corner, 0.0, 0.0, CELL, np.inf))
    assert costs[0] > 3.0 / CELL
    assert costs[2] - costs[1] == pytest.approx(costs[1] - costs[0], rel=0.05)
    assert costs[1] - costs[0] > 2 * TRIED


def test_a_point_alone_stays_longer_than_one_of_a_side():
    """A ray that passes it near by would hardly have met it, if it is a thin pole."""
    for beside, stays in ((False, True), (True, False)):
        first = np.zeros((1, SIDE, SIDE), np.int8), np.zeros((1, SIDE, SIDE, 2), np.uint8), np.zeros((1, 2), np.int64)
        scanned([10.0, 10.0, 10.0, 10.0], 1, *first)
        a, b = 10 - first[2][0, 0], -first[2][0, 1]
        first[0][0, a, b : b + 1 + beside] = OCCUPIED
        first[1][0, a, b] = 128, 256 * (PASSED_THIN + PASSED) / 2
        cells, _, _ = scanned([10.0, 10.0, 10.0, 10.0], 2, *first)
        assert (cells[a, b] == OCCUPIED) == stays


def test_only_a_ray_that_would_have_met_a_point_clears_it():
    beside = 0.45 * CELL  # in the same cells as the ray that passes, and too far beside it
    for place, stays in ((0.05 * CELL, False), (beside, True)):
        first = np.zeros((1, SIDE, SIDE), np.int8), np.zeros((1, SIDE, SIDE, 2), np.uint8), np.zeros((1, 2), np.int64)
        scanned([10.0, 10.0, 10.0, 10.0], 1, *first)
        a, b = 10 - first[2][0, 0], -first[2][0, 1]
        first[0][0, a, b] = OCCUPIED
        first[1][0, a, b] = 128, int(256 * place / CELL)
        cells, _, _ = scanned([10.0, 10.0, 10.0, 10.0], 2, *first)
        assert (cells[a, b] == OCCUPIED) == stays
