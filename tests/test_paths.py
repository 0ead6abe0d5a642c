"""Shortest paths against a visibility graph around obstacles that Shapely has grown, and what worlds are like."""

from dataclasses import replace
from math import hypot, inf, isnan, sqrt

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.worlds.paths import GRID_CELL, difficulty, path_length, shortest_path
from nnql_bullet.worlds.spec import WorldSpec

SIDE = 30.0
CLEARANCE = 0.8


def world_with(*boxes: OrientedBox, start: Pose = Pose(3, 3, 0), target: tuple[float, float] = (27, 26)) -> WorldSpec:  # noqa: B008
    return WorldSpec("test", 0, SIDE, SIDE, boxes, start, target, 1.0, 1.5)


def scattered(seed: int, count: int = 7) -> WorldSpec:
    drawn = np.random.default_rng(seed).uniform((6, 6, 0.5, 0.5, -1.5), (24, 24, 3, 3, 1.5), (count, 5))
    return world_with(*(OrientedBox(*row) for row in drawn.tolist()))


def exact_length(world: WorldSpec, clearance: float) -> float:
    """Length of the shortest way of a disc's centre, infinite if there is none."""
    grown = shapely.union_all(
        [shapely.Polygon(box.corners()).buffer(clearance, quad_segs=16) for box in world.obstacles]
    )
    inner = shapely.box(clearance, clearance, SIDE - clearance, SIDE - clearance)
    free = inner.difference(grown)
    corners = shapely.get_coordinates(free)
    inside = (corners > clearance + 1e-9).all(axis=1) & (corners < SIDE - clearance - 1e-9).all(axis=1)
    points: NDArray[np.float64] = np.vstack([(world.start.x, world.start.y), world.target, corners[inside]])
    n = len(points)
    i, j = np.triu_indices(n, 1)
    lines = shapely.linestrings(np.stack([points[i], points[j]], axis=1))
    roomy = free.buffer(1e-6)
    shapely.prepare(roomy)
    seen = shapely.covers(roomy, lines)
    lengths = np.zeros((n, n))
    lengths[i[seen], j[seen]] = shapely.length(lines[seen])
    return float(dijkstra(lengths, directed=False, indices=0)[1])


def test_with_nothing_in_the_way_it_is_straight() -> None:
    path, _ = shortest_path(world_with(), CLEARANCE)
    assert path.tolist() == [[3, 3], [27, 26]]
    assert path_length(path) == pytest.approx(hypot(24, 23))


def test_it_is_as_long_as_that_of_the_visibility_graph_and_keeps_the_disc_off_everything() -> None:
    lengths, play = [], GRID_CELL / sqrt(2)  # a free cell may be nearer to things by this
    for world in map(scattered, range(8)):
        path, _ = shortest_path(world, CLEARANCE)
        if world.bottleneck.width < 2 * (CLEARANCE - play) - GRID_CELL:
            assert len(path) == 0
            continue
        assert len(path) > 0 or world.bottleneck.width < 2 * CLEARANCE
        if world.bottleneck.width < 2 * CLEARANCE:
            continue
        shortest, longest = exact_length(world, CLEARANCE - 2 * play), exact_length(world, CLEARANCE)
        lengths.append(path_length(path))
        assert 0.998 * shortest - 0.05 <= lengths[-1] <= 1.005 * longest + 0.1
        line = shapely.LineString(path)
        assert min(line.distance(shapely.Polygon(box.corners())) for box in world.obstacles) >= CLEARANCE - 2 * play
    assert len(lengths) >= 5, "most can be crossed"
    assert sum(length > 1.01 * hypot(24, 23) for length in lengths) >= 3, "some have something in the way"


@pytest.mark.parametrize("world", [world_with(OrientedBox(15, 15, 0.5, 15)), world_with(target=(31.0, 5.0))])
def test_without_a_path_there_are_no_corners_and_difficulty_says_so(world: WorldSpec) -> None:
    """A wall across, and a target outside."""
    assert len(shortest_path(world, CLEARANCE)[0]) == 0
    found = difficulty(world, 2 * CLEARANCE)
    assert (found.bottleneck, found.shortest_path) == (0.0, inf)
    assert isnan(found.closest_obstacle)


def test_a_passage_that_a_disc_just_fits_is_taken() -> None:
    for gap in (0.66, 0.8, 1.1):
        walls = [OrientedBox(15, 15 + side * (10 + gap / 2), 0.5, 10) for side in (-1, 1)]
        world = world_with(*walls, start=Pose(5, 15, 0), target=(25, 15))
        assert world.bottleneck.width == pytest.approx(gap)
        assert shortest_path(world, gap / 2)[1] == pytest.approx(20.0, abs=0.05)


class TestDifficulty:
    def test_of_an_empty_arena_along_its_middle(self) -> None:
        found = difficulty(world_with(start=Pose(10, 15, 0), target=(20, 15)), 2 * CLEARANCE)
        assert found.cover == 0.0
        assert found.shortest_path == pytest.approx(10.0 - 1.0)  # up to the target's edge
        assert found.tortuosity == pytest.approx(1.0)
        # Looked at 10, 12, ..., 18 m along the arena: the nearest wall is beside or behind.
        assert found.closest_obstacle == pytest.approx(np.mean([10, 12, 14, 14, 12]))

    def test_visibility_in_the_middle_of_a_square_is_the_mean_distance_to_its_sides(self) -> None:
        found = difficulty(world_with(start=Pose(15, 15, 0), target=(16, 15)), 2 * CLEARANCE)
        angles = np.arange(100_000) * 2 * np.pi / 100_000
        expected = np.mean(15.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles))))
        assert found.visibility == pytest.approx(expected, rel=0.01)

    def test_a_detour_shows_as_tortuosity(self) -> None:
        world = world_with(OrientedBox(15, 10, 0.2, 10), start=Pose(10, 5, 0), target=(20, 5))
        found = difficulty(world, 2 * CLEARANCE)
        play = GRID_CELL * sqrt(2)
        shortest, longest = exact_length(world, CLEARANCE - play), exact_length(world, CLEARANCE + play)
        assert shortest / 10 <= found.tortuosity <= longest / 10
        assert found.cover == pytest.approx(4 * 0.2 * 10 / SIDE**2)


@pytest.mark.parametrize(("radius", "expected"), [(1.5, 1.3), (0.5, None)])
def test_a_target_is_reached_at_its_edge_even_through_a_wall(radius: float, expected: float | None) -> None:
    """The wall between start and target is thinner than the target's radius; else the way leads round its end."""
    wall = OrientedBox(5.0, 10.0, 0.1, 10.0)
    world = replace(world_with(wall, start=Pose(3, 3, 0), target=(5.8, 3.0)), target_radius=radius)
    if expected is None:
        expected = exact_length(world, 0.3) - radius
    assert difficulty(world, 0.6).shortest_path == pytest.approx(expected, abs=0.2)
