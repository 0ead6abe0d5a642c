"""The narrowest passage of a world, against polygons of shapely grown by a disc."""

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Circle, OrientedBox, Pose, Shape, as_rows
from nnql_bullet.worlds import passages
from nnql_bullet.worlds.passages import ROUNDING, Passage, narrowest_passage
from nnql_bullet.worlds.spec import WorldSpec

CLOSE = 0.005
"""Shapely draws a disc as a polygon: its radius is right to this [m]."""


def scattered(seed: int, side: float = 30.0) -> WorldSpec:
    """A world of up to 60 boxes and 20 circles, which may overlap and may hold the start."""
    rng = np.random.default_rng(seed)
    boxes: list[Shape] = [
        OrientedBox(*rng.uniform(0, side, 2), *rng.uniform(0.1, 2.5, 2), rng.uniform(0, np.pi))
        for _ in range(rng.integers(1, 60))
    ]
    boxes += [Circle(*rng.uniform(0, side, 2), rng.uniform(0.05, 1.5)) for _ in range(rng.integers(0, 20))]
    start, target = rng.uniform(1, side - 1, (2, 2)).tolist()
    return WorldSpec("scattered", seed, side, side, tuple(boxes), Pose(*start, 0.0), tuple(target), 1.0, 1.5)


def passes(world: WorldSpec, radius: float) -> bool:
    """Whether one piece of the room for the centre of a disc holds the start and the target."""
    shapes = [
        shapely.Point(its.x, its.y).buffer(its.radius + radius, quad_segs=64)
        if isinstance(its, Circle)
        else shapely.Polygon(its.corners()).buffer(radius, quad_segs=64)
        for its in world.obstacles
    ]
    taken = shapely.union_all(shapes)
    free = shapely.box(radius, radius, world.width - radius, world.depth - radius).difference(taken)
    ends = [shapely.Point(world.start.x, world.start.y), shapely.Point(*world.target)]
    return any(all(piece.distance(end) < 1e-9 for end in ends) for piece in shapely.get_parts(free))


@pytest.mark.parametrize("seed", range(40))
def test_a_disc_passes_exactly_if_it_is_no_wider(seed: int) -> None:
    world = scattered(seed)
    found = narrowest_passage(world.solids, (world.start.x, world.start.y), world.target)
    assert not passes(world, found.width / 2 + CLOSE)
    assert found.width <= 2 * CLOSE or passes(world, found.width / 2 - CLOSE)
    for width in (0.0, 0.75, found.width - 1e-6, found.width, found.width + ROUNDING / 2, found.width + 1e-6, 9.0):
        assert world.admits(width) == found.admits(width)


@pytest.mark.parametrize(("gap", "yaw"), [(2.2, 0.0), (0.72, 0.3), (0.05, 1.2)])
def test_it_is_the_gap_between_two_boxes_that_reach_the_walls(gap: float, yaw: float) -> None:
    """A wall right across the arena, turned by `yaw`, with a gap in its middle."""
    middle, half = np.array([15.0, 15.0]), 40.0
    along = np.array([np.cos(yaw), np.sin(yaw)])
    boxes = tuple(OrientedBox(*(middle + side * (half + gap / 2) * along), half, 0.5, yaw) for side in (-1, 1))
    across = 8 * np.array([-along[1], along[0]])
    ends: NDArray[np.float64] = np.array([middle - across, middle + across])
    world = WorldSpec("gap", 0, 30.0, 30.0, boxes, Pose(*ends[0].tolist(), 0.0), tuple(ends[1].tolist()), 1.0, 1.5)
    found = narrowest_passage(world.solids, *(tuple(end) for end in ends.tolist()))
    assert found.width == pytest.approx(gap, abs=1e-9)
    assert np.hypot(found.x - 15.0, found.y - 15.0) <= 0.5 + 1e-9  # the boxes are 1 m thick


def test_ends_count_and_an_end_inside_a_box_leaves_no_path() -> None:
    box = OrientedBox(20.0, 15.0, 1.0, 1.0)
    world = WorldSpec("ends", 0, 30.0, 30.0, (box,), Pose(5.0, 15.0, 0.0), (15.0, 29.5), 1.0, 1.5)
    found = narrowest_passage(world.solids, (5.0, 15.0), (15.0, 29.5))
    assert (found.width, found.x, found.y) == pytest.approx((1.0, 15.0, 29.5))
    assert narrowest_passage(world.solids, (20.0, 15.5), (5.0, 5.0)).width == 0.0


def test_twenty_thousand_boxes_take_no_longer_than_their_neighbours() -> None:
    """Only pairs that are near each other are measured; a full table would hold two hundred million."""
    rng = np.random.default_rng(0)
    places = np.stack(np.meshgrid(np.arange(142), np.arange(142)), axis=-1).reshape(-1, 2) * 4.0 + 4.0
    rows = np.column_stack(
        [places, *rng.uniform(0.1, 0.9, (2, len(places))), np.ones(len(places)), *np.zeros((2, len(places)))]
    )
    side = 572.0
    walls = WorldSpec("grid", 0, side, side, (), Pose(2.0, 2.0, 0.0), (570.0, 570.0), 1.0, 1.5).solids
    found = narrowest_passage(np.concatenate([rows, walls]), (2.0, 2.0), (570.0, 570.0))
    assert 2.2 < found.width < 3.9


def test_a_passage_of_the_needed_width_is_wide_enough_whatever_is_rounded() -> None:
    """Five cells of 0.15 m are 0.75 m; in the middle of a world they are 0.7499999999999991."""
    assert Passage(0.7499999999999991, 0, 0).admits(0.75)
    assert not Passage(0.749999, 0, 0).admits(0.75)


def test_obstacles_that_overlap_again_and_again_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their pairs would fill the memory."""
    monkeypatch.setattr(passages, "MOST_PAIRS", 1000)
    boxes = as_rows([OrientedBox(5.0, 5.0, 1.0, 1.0)] * 50)
    with pytest.raises(UserError, match="more than 1000 pairs of obstacles"):
        narrowest_passage(boxes, (1.0, 1.0), (9.0, 9.0))
