"""Traps and aisles: what they are made of, that they bar the straight way, and that there is a way all the same."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import pairwise
from math import cos, pi, radians
from typing import Any

import numpy as np
import pytest
import shapely
from helpers import Alone
from shapely import LineString, Point, Polygon

from nnql_bullet.agents.rules.straight import Straight
from nnql_bullet.config import parse
from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, Pose, wrap_angle
from nnql_bullet.rollout import run_episode
from nnql_bullet.sim.base import Simulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.layouts import Arena
from nnql_bullet.worlds.layouts.aisles import Aisles
from nnql_bullet.worlds.layouts.traps import Traps
from nnql_bullet.worlds.source import World, load_world
from nnql_bullet.worlds.spec import WorldSpec

ROOM = 0.8
MILLIMETRE = 1e-3
"""Centres, halves of sides and what is between them are rounded to this [m]."""


@pytest.fixture(scope="module")
def kinematic(vehicle: VehicleSpec) -> Iterator[KinematicSimulator]:
    with closing(KinematicSimulator(vehicle, DriveOptions(), 1)) as simulator:
        yield simulator


def source_of(**values: Any) -> World:
    return parse(World, {"name": "test", **values}, "test")


def polygons(boxes: Sequence[OrientedBox]) -> list[Polygon]:
    return [Polygon(box.corners()) for box in boxes]


def straight_way(world: WorldSpec) -> LineString:
    return LineString([(world.start.x, world.start.y), world.target])


def overlap(boxes: Sequence[OrientedBox]) -> float:
    """Area that is covered more than once [m2]."""
    return float(sum(box.area for box in boxes) - shapely.union_all(polygons(boxes)).area)


def ends_straight_on(simulator: Simulator, world: WorldSpec) -> str:
    return run_episode(Navigation(simulator, TaskOptions()), world, Straight()).ending


@pytest.fixture(scope="module")
def traps() -> tuple[Traps, list[WorldSpec]]:
    """The layout, and worlds that it gave."""
    source = load_world("traps")
    assert isinstance(source.layout, Traps)
    return source.layout, [source.draw(seed, ROOM) for seed in (*range(8), 100_000, 1_000_000)]


def traps_of(world: WorldSpec) -> list[tuple[OrientedBox, OrientedBox, OrientedBox]]:
    """Back, left and right wall of each."""
    return list(zip(world.obstacles[::3], world.obstacles[1::3], world.obstacles[2::3], strict=True))


def in_the_frame_of(back: OrientedBox, box: OrientedBox) -> tuple[float, float]:
    """The centre of a box, seen along the yaw of a back wall from its centre."""
    c, s = np.cos(back.yaw), np.sin(back.yaw)
    dx, dy = box.x - back.x, box.y - back.y
    return float(c * dx + s * dy), float(c * dy - s * dx)


class TestTraps:
    def test_each_is_a_u_of_the_sizes_asked_for(self, traps: tuple[Traps, list[WorldSpec]]) -> None:
        layout, worlds = traps
        for world in worlds:
            assert len(world.obstacles) == 3 * layout.count
            for back, left, right in traps_of(world):
                thickness, depth = 2 * back.half_length, 2 * left.half_length
                width = 2 * (back.half_width - thickness)
                for value, what in ((thickness, "thickness"), (depth, "depth"), (width, "width")):
                    low, high = getattr(layout, f"min_{what}"), getattr(layout, f"max_{what}")
                    assert low - 0.01 <= value <= high + 0.01, what
                assert left.yaw == right.yaw == back.yaw
                assert (right.half_length, right.half_width) == (left.half_length, left.half_width)
                assert left.half_width == pytest.approx(thickness / 2)
                for wall, side in ((left, 1), (right, -1)):
                    expected = (-(depth + thickness) / 2, side * (width + thickness) / 2)
                    # A millimetre in each place, and 5e-5 rad over 15 m.
                    assert in_the_frame_of(back, wall) == pytest.approx(expected, abs=3 * MILLIMETRE)

    def test_walls_meet_and_traps_keep_off_one_another(self, traps: tuple[Traps, list[WorldSpec]]) -> None:
        _, worlds = traps
        for world in worlds:
            assert overlap(world.obstacles) < 0.05  # corners are rounded to a millimetre, each
            hulls = [shapely.union_all(polygons(walls)).convex_hull for walls in traps_of(world)]
            for walls in traps_of(world):
                back, *sides = polygons(walls)
                assert max(back.distance(side) for side in sides) < 3 * MILLIMETRE
            for k, hull in enumerate(hulls):
                assert min((hull.distance(other) for other in hulls[:k]), default=1.0) > 0

    def test_they_stay_in_the_arena_and_off_start_and_target(self, traps: tuple[Traps, list[WorldSpec]]) -> None:
        layout, worlds = traps
        for world in worlds:
            hulls = [shapely.union_all(polygons(walls)).convex_hull for walls in traps_of(world)]
            arena = shapely.box(0, 0, world.width, world.depth).buffer(2 * MILLIMETRE)
            assert all(arena.covers(hull) for hull in hulls)
            for end in straight_way(world).boundary.geoms:
                assert min(end.distance(hull) for hull in hulls) >= layout.clear_radius - 2 * MILLIMETRE

    def test_the_straight_way_goes_into_the_first_and_ends_at_its_back_wall(
        self, traps: tuple[Traps, list[WorldSpec]]
    ) -> None:
        _, worlds = traps
        for world in worlds:
            walls = traps_of(world)[0]
            back, left, right = polygons(walls)
            way = straight_way(world)
            hull = shapely.union_all([back, left, right]).convex_hull
            assert way.crosses(back)
            assert not way.intersects(left) and not way.intersects(right)
            inside = way.intersection(hull.difference(back))
            begin = Point(world.start.x, world.start.y)
            assert inside.distance(begin) < back.distance(begin)
            # In the frame of the trap: in by the opening, and through the middle half of it.
            enters = min(
                map(Point, inside.geoms[0].coords if inside.geom_type == "MultiLineString" else inside.coords),
                key=begin.distance,
            )
            depth, width = 2 * walls[1].half_length, 2 * (walls[0].half_width - 2 * walls[0].half_length)
            along, across = in_the_frame_of(walls[0], OrientedBox(enters.x, enters.y, 0.0, 0.0))
            assert along == pytest.approx(-depth - walls[0].half_length, abs=0.02)
            assert abs(across) < width / 4 + 0.02

    def test_whoever_drives_straight_on_does_not_get_through(
        self, traps: tuple[Traps, list[WorldSpec]], kinematic: KinematicSimulator
    ) -> None:
        assert {ends_straight_on(kinematic, world) for world in traps[1]} == {"collision"}

    def test_they_face_every_way(self) -> None:
        yaws = [back.yaw for seed in range(10) for back, _, _ in traps_of(load_world("traps").draw(seed, ROOM))[1:]]
        assert min(yaws) < -0.8 * pi
        assert max(yaws) > 0.8 * pi
        assert abs(np.mean(np.exp(1j * np.array(yaws)))) < 0.3

    @pytest.mark.parametrize("offset", [-3.2, 0.0, 3.2])
    def test_the_smallest_has_room_to_turn_round_and_drive_out_again(
        self, kinematic: KinematicSimulator, offset: float
    ) -> None:
        """It comes in anywhere, sees the back wall, turns away from the nearer side wall, and is out."""
        layout = Traps(kind="traps", count=1)
        width, depth = layout.min_width, layout.min_depth
        back = OrientedBox(100.5, 50.0, 0.5, width / 2 + 1)
        sides = (OrientedBox(100 - depth / 2, 50 + side * (width / 2 + 0.5), depth / 2, 0.5) for side in (1, -1))
        start = Pose(100 - depth - 2.0, 50.0 + offset, 0.0)
        world = WorldSpec("t", 0, 200.0, 100.0, (back, *sides), start, (150.0, 50.0), 1.0, 1.5)
        alone = Alone(kinematic)
        alone.reset(world)
        deepest, turn = 0.0, radians(-60) if offset > 0 else radians(60)
        for decision in range(16):
            yaw = alone.pose.yaw
            motion = alone.advance(0.0 if decision < 5 else turn if cos(yaw) > -0.9 else wrap_angle(pi - yaw))
            assert not motion.touching
            deepest = max(deepest, motion.pose.x - (100 - depth))
        assert deepest > 3.0
        assert motion.pose.x < 100 - depth - 1.0

    def test_one_without_room_is_refused(self) -> None:
        layout = {"kind": "traps", "count": 40}
        with pytest.raises(UserError, match="no room for 40 traps; lower 'count', 'max_width'"):
            source_of(layout=layout, width=60.0, depth=60.0, start=[10, 10], target=[50, 50]).draw(0, ROOM)


@pytest.fixture(scope="module")
def halls() -> tuple[Aisles, list[WorldSpec]]:
    """The layout, and worlds that it gave."""
    source = load_world("aisles")
    assert isinstance(source.layout, Aisles)
    return source.layout, [source.draw(seed, ROOM) for seed in (*range(8), 78, 100_000, 1_000_000)]


def regular(seed: int, **changes: Any) -> tuple[Aisles, list[OrientedBox]]:
    """A hall of 60 m by 40 m with nothing left to chance but its measures."""
    layout = Aisles(**{"kind": "aisles", "gap_chance": 0.0, "block_chance": 0.0, **changes})
    arena = Arena(60.0, 40.0, ((4.0, 20.0), (56.0, 20.5)))
    return layout, list(layout.place(arena, np.random.default_rng(seed)))


class TestAisles:
    def test_nothing_overlaps_and_all_is_inside(self, halls: tuple[Aisles, list[WorldSpec]]) -> None:
        _, worlds = halls
        for world in worlds:
            assert overlap(world.obstacles) == pytest.approx(0.0, abs=1e-6)
            assert shapely.box(0, 0, world.width, world.depth).covers(shapely.union_all(polygons(world.obstacles)))

    def test_start_and_target_are_at_opposite_ends_and_free(self, halls: tuple[Aisles, list[WorldSpec]]) -> None:
        layout, worlds = halls
        for world in worlds:
            assert world.start.x < layout.dock
            assert world.target[0] > world.width - layout.dock
            for end in straight_way(world).boundary.geoms:
                assert end.distance(shapely.union_all(polygons(world.obstacles))) >= layout.clear_radius - 1e-9

    def test_racks_stand_across_the_straight_way(
        self, halls: tuple[Aisles, list[WorldSpec]], kinematic: KinematicSimulator
    ) -> None:
        _, worlds = halls
        for world in worlds:
            assert any(straight_way(world).crosses(polygon) for polygon in polygons(world.obstacles))
            assert ends_straight_on(kinematic, world) == "collision"

    @pytest.mark.parametrize(("seed", "rack_depth"), [(0, 2.4), (1, 2.4), (2, 2.4), (3, 1.25), (4, 0.8)])
    def test_a_regular_hall_has_rows_from_wall_to_wall(self, seed: int, rack_depth: float) -> None:
        layout, boxes = regular(seed, rack_depth=rack_depth)
        lefts = sorted({round(box.x - box.half_length, 3) for box in boxes})
        assert {round(2 * box.half_length, 3) for box in boxes} == {layout.rack_depth}
        aisles = [after - before - layout.rack_depth for before, after in pairwise(lefts)]
        assert lefts[0] == layout.dock
        assert 60.0 - layout.dock - layout.rack_depth - layout.max_aisle < lefts[-1] + layout.rack_depth
        assert lefts[-1] + layout.rack_depth <= 60.0 - layout.dock
        assert layout.min_aisle - 0.006 <= min(aisles) <= max(aisles) <= layout.max_aisle + 0.006
        spans = {
            tuple((b.y - b.half_width, b.y + b.half_width) for b in boxes if round(b.x - b.half_length, 3) == left)
            for left in lefts
        }
        (row,) = spans  # cross aisles go straight through
        crossings = [after[0] - before[1] for before, after in pairwise(row)]
        assert row[0][0] == 0.0
        assert layout.min_aisle - 0.006 <= min(crossings) <= max(crossings) <= layout.max_aisle + 0.006
        assert all(layout.min_rack - 0.006 <= high - low <= layout.max_rack + 0.006 for low, high in row[:-1])
        assert row[-1][1] > 40.0 - layout.max_aisle

    def test_racks_are_missing_as_often_as_asked(self) -> None:
        there, left = (sum(len(regular(seed, gap_chance=gap)[1]) for seed in range(40)) for gap in (0.0, 0.3))
        assert left / there == pytest.approx(0.7, abs=0.05)

    def test_where_everything_is_blocked_nothing_is_open(self) -> None:
        for seed in range(5):
            _, boxes = regular(seed, block_chance=1.0)
            whole = shapely.union_all([polygon.buffer(0.006) for polygon in polygons(boxes)])
            assert whole.geom_type == "Polygon"
            assert (whole.bounds[1], whole.bounds[3]) == pytest.approx((0.0, 40.0), abs=0.007)

    def test_a_hall_with_every_aisle_blocked_is_refused(self) -> None:
        layout = {"kind": "aisles", "block_chance": 1.0}
        with pytest.raises(UserError, match=r"its widest path narrows to .* attempts; the vehicle needs"):
            source_of(layout=layout, width=60.0, depth=40.0, start=[4, 6], target=[56, 34]).draw(0, ROOM)

    def test_a_hall_with_no_rack_between_start_and_target_is_refused(self) -> None:
        layout = {"kind": "aisles"}
        with pytest.raises(UserError, match="no rack stands between start and target"):
            source_of(layout=layout, width=60.0, depth=40.0, start=[4, 6], target=[4, 34]).draw(0, ROOM)

    def test_what_blocks_an_aisle_is_seen_before_it_is_in(self, halls: tuple[Aisles, list[WorldSpec]]) -> None:
        """An aisle along a rack is no longer than the sensors see."""
        assert halls[0].max_rack < 10.0


@pytest.mark.parametrize("name", ["traps", "aisles"])
def test_every_world_can_be_crossed_and_is_another(name: str) -> None:
    """Of free space, grown by the radius of the vehicle's circle, start and target are in one piece."""
    digests = set()
    for seed in range(12):
        world = load_world(name).draw(seed, ROOM)
        radius = ROOM / 2
        taken = shapely.union_all([polygon.buffer(radius, quad_segs=64) for polygon in polygons(world.obstacles)])
        free = shapely.box(radius, radius, world.width - radius, world.depth - radius).difference(taken)
        ends = list(straight_way(world).boundary.geoms)
        assert any(all(part.covers(end) for end in ends) for part in getattr(free, "geoms", [free]))
        digests.add(world.digest)
    assert len(digests) == 12
