from dataclasses import replace
from math import pi
from time import process_time
from unittest.mock import Mock

import numpy as np
import pytest
import shapely
from scipy.stats import kstest, uniform
from shapely import affinity

import nnql_bullet as nb
from nnql_bullet import assets, paper
from nnql_bullet.config import parse
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Circle, OrientedBox, Pose
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.worlds.layouts import Arena, random_boxes
from nnql_bullet.worlds.layouts.base import as_rounded
from nnql_bullet.worlds.source import MOST_ATTEMPTS, World, load_world
from nnql_bullet.worlds.spec import Patrol, WorldSpec

ROOM = 0.8
"""Width of the vehicle that worlds are drawn for [m]."""
PAPERS = ("paper", "empty", "cover_2.5", "cover_7.5", "cover_10", "cover_15", "cover_20")
"""Shipped worlds that differ in nothing but their cover."""
SHIPPED = (*PAPERS, "traps", "aisles", "moving", "poles", "cluttered", "cells", "rooms")
MEAN_BOX = 25.0  # sides from 2 m to 8 m
DRAWN = [("paper", 0), ("paper", 1), ("paper", 100_000), ("cover_10", 0), ("cover_10", 1), ("cover_20", 0)]


PATROL = Patrol(OrientedBox(10.0, 12.0, 1.0, 0.5, 0.2), (30.0, 12.0), 0.5, 0.25)


@pytest.fixture(scope="module")
def drawn():
    """The file and the world of each."""
    return [((source := load_world(name)), source.draw(seed, ROOM)) for name, seed in DRAWN]


def source_of(**values):
    return parse(World, {"name": "test", **values}, "test")


def small_world(*boxes, **values):
    """A 20 m x 10 m arena to be crossed along its middle."""
    layout = {"kind": "boxes", "boxes": list(boxes)}
    return source_of(layout=layout, **{"width": 20.0, "depth": 10.0, "start": [3, 5], "target": [17, 5], **values})


def crowded():
    """Worlds of which most have to be drawn more than once."""
    layout = {"kind": "random_boxes", "cover": 0.3, "min_side": 2.0, "max_side": 6.0, "clear_radius": 2.0}
    return source_of(width=24.0, depth=24.0, start=[5, 5], target=[19, 19], layout=layout)


def box(x, y, length, width, yaw_degrees=0.0):
    return {"x": x, "y": y, "length": length, "width": width, "yaw_degrees": yaw_degrees}


def polygon(box):
    if isinstance(box, Circle):
        return shapely.Point(box.x, box.y).buffer(box.radius, quad_segs=64)
    length, width = box.half_length, box.half_width
    turned = affinity.rotate(shapely.box(-length, -width, length, width), box.yaw, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, box.x, box.y)


def obstacles_of(world):
    return shapely.MultiPolygon([polygon(box) for box in world.obstacles])


def room_to_move(world, room):
    """Where the centre of a disc of this radius may be: an oracle without a grid."""
    arena = shapely.box(room, room, world.width - room, world.depth - room)
    taken = shapely.union_all([polygon(box).buffer(room, quad_segs=64) for box in world.obstacles])
    return arena.difference(taken)


def is_crossable(world, room):
    free = room_to_move(world, room)
    ends = [shapely.Point(world.start.x, world.start.y), shapely.Point(world.target)]
    return any(all(part.covers(end) for end in ends) for part in getattr(free, "geoms", [free]))


# A generator that gives other worlds makes every published number another number. Change these only on purpose.
def test_seeds_give_the_worlds_that_they_always_gave():
    digests = [
        ("paper", 0, "28fd1ec1093fbd66"),
        ("paper", 1, "319ee147c30ea01f"),
        ("paper", 2, "6176fd3ef0a35e19"),
        ("paper", 100_000, "0a3830c12602f347"),
        ("cover_10", 0, "627b59f5c0704236"),
        ("cover_10", 1, "26c25455e7561d4f"),
        ("cover_10", 2, "f10854904a22cffc"),
        ("cover_10", 100_000, "263dcc7021f1c315"),
        ("paper", 1_000_000, "b5a0ea6478b78788"),
        ("cover_2.5", 1, "ca69f98ff128b6d8"),
        ("cover_15", 100_000, "626cd842c88e8eec"),
        ("cover_20", 0, "deb747aa5f27bc37"),
        ("cover_20", 140, "9a2d96d904f88b38"),
        ("cover_20", 100_127, "2f4a34c051aebb41"),
        ("traps", 0, "43c29f62c3b9dc46"),
        ("traps", 1, "f19fa3806b8e3962"),
        ("traps", 100_000, "32eb7f690eb731f9"),
        ("aisles", 0, "85511677436802fc"),
        ("aisles", 1, "bac0eac418d619c9"),
        ("aisles", 78, "f534f08d5eead01d"),  # drawn twice
        ("moving", 0, "f087cace880abd09"),
        ("moving", 1, "c079a8d5e66368f0"),
        ("moving", 100_000, "555551e46a3d51f7"),
    ]
    assert [(name, seed, load_world(name).draw(seed, ROOM).digest) for name, seed, _ in digests] == digests
    assert crowded().draw(2, 2.0).digest == "bd8c43aed64c1ca5"  # of the fifth attempt


def test_same_seed_gives_the_same_world_from_any_source():
    one, other = load_world("paper"), load_world("paper")
    other.draw(5, ROOM)
    assert one.draw(4, ROOM) == other.draw(4, ROOM)


def test_different_seeds_give_different_worlds():
    source = load_world("paper")
    assert len({source.draw(seed, ROOM).digest for seed in range(6)}) == 6


def test_digest_tells_worlds_apart_but_not_by_name_or_seed():
    changes = [
        {"start": Pose(20, 20, 0.1)},
        {"at_rest": True},
        {"target": (90.0, 89.0)},
        {"target_radius": 1.0},
        {"obstacle_height": 2.0},
        {"width": 101.0},
        {"obstacles": (OrientedBox(50, 50, 1, 1, 0.2),)},
        {"obstacles": ()},
        {"patrols": (PATROL,)},
        {"patrols": (PATROL, PATROL)},
        {"patrols": (replace(PATROL, speed=0.6),)},
        {"patrols": (replace(PATROL, phase=0.26),)},
        {"patrols": (replace(PATROL, end=(31.0, 12.0)),)},
        {"patrols": (replace(PATROL, box=replace(PATROL.box, half_width=0.7)),)},
        {"patrols": (PATROL, PATROL, PATROL)},
        {},
    ]
    values = {
        "name": "a",
        "seed": 1,
        "width": 100.0,
        "depth": 100.0,
        "obstacles": (OrientedBox(50, 50, 1, 1, 0.1),),
        "start": Pose(20, 20, 0),
        "target": (90.0, 90.0),
        "target_radius": 2.0,
        "obstacle_height": 1.5,
    }
    assert WorldSpec(**{**values, "name": "b", "seed": 2}).digest == WorldSpec(**values).digest
    assert len({WorldSpec(**{**values, **change}).digest for change in changes}) == len(changes)


def test_boxes_lie_apart_inside_the_arena(drawn):
    for _, world in drawn:
        union = shapely.union_all([polygon(box) for box in world.obstacles])
        assert union.area == pytest.approx(sum(box.area for box in world.obstacles), rel=1e-9)
        assert shapely.box(0, 0, world.width, world.depth).covers(union)


def test_boxes_have_the_sides_asked_for(drawn):
    for file, world in drawn:
        sides = [2 * side for box in world.obstacles for side in (box.half_length, box.half_width)]
        assert file.layout.min_side - 2e-3 <= min(sides)
        assert max(sides) <= file.layout.max_side + 2e-3


def test_boxes_stay_clear_of_start_and_target(drawn):
    for file, world in drawn:
        for point in (shapely.Point(world.start.x, world.start.y), shapely.Point(world.target)):
            assert point.distance(obstacles_of(world)) >= file.layout.clear_radius - 1e-9


def test_boxes_cover_what_is_asked_but_for_the_last_box(drawn):
    for file, world in drawn:
        missing = file.layout.cover * world.width * world.depth - obstacles_of(world).area
        assert missing <= MEAN_BOX / 2
        assert missing > MEAN_BOX / 2 - file.layout.max_side**2
        assert world.cover == pytest.approx(obstacles_of(world).area / (world.width * world.depth))


def test_cover_is_within_half_a_mean_box_of_what_is_asked_on_average():
    source = load_world("cover_2.5")
    cover = np.mean([source.draw(seed, ROOM).cover for seed in range(20)])
    assert abs(cover - 0.025) * 100 * 100 <= MEAN_BOX / 2


def test_boxes_point_every_way():
    yaws = [box.yaw for seed in range(4) for box in load_world("cover_10").draw(seed, ROOM).obstacles]
    assert -pi / 2 <= min(yaws) < -1.4
    assert 1.4 < max(yaws) <= pi / 2
    assert abs(np.mean(yaws)) < 0.3


def test_drawn_worlds_can_be_crossed_even_if_they_had_to_be_drawn_again(drawn):
    for world in [*(world for _, world in drawn), *(crowded().draw(seed, ROOM) for seed in range(3))]:
        assert is_crossable(world, ROOM / 2)


def test_start_faces_the_target_unless_told_otherwise():
    assert load_world("empty").draw(0, ROOM).start == Pose(20.0, 20.0, round(pi / 4, 6))
    assert small_world(start_yaw_degrees=-90).draw(0, ROOM).start.yaw == pytest.approx(-pi / 2, abs=1e-6)


def test_a_vehicle_starts_at_rest_from_a_start_that_was_given():
    world = small_world()
    assert not world.at_rest
    assert not world.between(target=(2.0, 2.0)).at_rest
    assert world.between(start=(2.0, 2.0)).draw(0, ROOM).at_rest


def test_walls_enclose_the_arena_without_reaching_into_it():
    world = small_world().draw(0, ROOM)
    ring = shapely.union_all([polygon(wall) for wall in world.walls])
    arena = shapely.box(0, 0, 20, 10)
    assert ring.intersection(arena).area == pytest.approx(0, abs=1e-9)
    assert ring.union(arena).symmetric_difference(shapely.box(-1, -1, 21, 11)).area == pytest.approx(0, abs=1e-9)


def test_solids_are_obstacles_and_walls():
    assert small_world(box(10, 8, 1, 1)).draw(0, ROOM).solids.shape == (5, 7)
    assert load_world("empty").draw(0, ROOM).solids.shape == (4, 7)


def test_explicit_boxes_stand_where_they_are_given_whatever_the_seed():
    source = small_world(box(10, 8, 2, 1, 30), box(8, 1, 1, 1))
    expected = (OrientedBox(10, 8, 1, 0.5, pytest.approx(pi / 6)), OrientedBox(8, 1, 0.5, 0.5, 0))
    assert source.draw(0, ROOM).obstacles == expected
    assert source.draw(9, ROOM).digest == source.draw(0, ROOM).digest


@pytest.mark.parametrize("thickness", [2.0, 0.3, 0.1, 0.01])
def test_world_with_a_wall_across_is_refused(thickness):
    message = (
        r"world 'test', seed 3: its widest path narrows to 0\.00 m at \(.*\); the vehicle needs 0\.90 m \(its width of "
        r"0\.8 m and 'clearance', 0\.1 m\): move obstacles apart, lower 'clearance', or allow impassable worlds"
    )
    with pytest.raises(UserError, match=message):
        small_world(box(10, 5, thickness, 10)).draw(3, ROOM)


@pytest.mark.parametrize(("gap", "passes"), [(0.7, False), (0.89, False), (0.91, True), (4.0, True)])
def test_gap_is_passable_if_it_is_wide_enough(gap, passes):
    blocks = [box(10, (5 - gap / 2) / 2, 1, 5 - gap / 2), box(10, 10 - (5 - gap / 2) / 2, 1, 5 - gap / 2)]
    if passes:
        assert is_crossable(small_world(*blocks).draw(0, ROOM), ROOM / 2)
    else:
        with pytest.raises(UserError, match=rf"narrows to {gap:.2f} m at \(1\d\.\d\d, 5\.00\)"):
            small_world(*blocks).draw(0, ROOM)
        assert small_world(*blocks, clearance=gap - ROOM).draw(0, ROOM) if gap > ROOM else True
        assert small_world(*blocks).draw(0, ROOM, allow_impassable=True).bottleneck.width == pytest.approx(gap)


def test_random_world_too_crowded_to_cross_is_refused_after_many_attempts():
    layout = {"kind": "random_boxes", "cover": 0.25, "min_side": 3.0, "max_side": 3.0, "clear_radius": 2.1}
    source = source_of(width=16.0, depth=16.0, start=[3, 3], target=[13, 13], layout=layout)
    with pytest.raises(
        UserError,
        match=rf"seed 0: its widest path narrows to .* in {MOST_ATTEMPTS} attempts; the vehicle needs 5\.60 m",
    ):
        source.draw(0, 5.5)


def test_layout_without_room_for_its_cover_is_refused():
    layout = {"kind": "random_boxes", "cover": 0.4, "min_side": 8.0, "max_side": 8.0}
    with pytest.raises(UserError, match="no room for boxes over 40% of the arena; lower 'cover'"):
        source_of(width=22.0, depth=22.0, start=[6, 6], target=[16, 16], layout=layout).draw(0, ROOM)


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({"start": [10, 5]}, r"narrows to 0\.00 m at its start, \(10\.00, 5\.00\)"),
        ({"target": [10, 5]}, r"narrows to 0\.00 m at its target, \(10\.00, 5\.00\)"),
        ({"start": [8.7, 5]}, r"narrows to 0\.60 m at its start, \(8\.70, 5\.00\)"),
        ({"start": [0.4, 5]}, r"narrows to 0\.80 m at its start, \(0\.40, 5\.00\)"),
        ({"start": [30, 5]}, r"its start \(30, 5\) is outside the arena; move it inside"),
        ({"start": [-5, 5]}, r"its start \(-5, 5\) is outside the arena; move it inside"),
        ({"target": [17, -1]}, r"its target \(17, -1\) is outside the arena; move it inside"),
        ({"target": [17, 10.05]}, r"its target \(17, 10\.05\) is outside the arena; move it inside"),
        ({"start": [0, 0]}, r"its start \(0, 0\) is outside the arena; move it inside"),
    ],
)
def test_start_or_target_in_a_box_near_a_wall_or_outside_is_refused(values, what):
    with pytest.raises(UserError, match=what) as refusal:
        small_world(box(10, 5, 2, 2), **values).draw(0, ROOM)
    assert "\n" not in str(refusal.value)


def test_the_papers_worlds_differ_in_their_cover_alone():
    for name in PAPERS:
        world = load_world(name).draw(0, ROOM)
        assert (world.name, world.seed) == (name, 0)
        assert (world.start.x, world.start.y) == paper.START
        assert world.target == paper.TARGET
        assert world.width == world.depth == paper.ARENA_SIDE
        asked = {"paper": 0.05, "empty": 0.0}.get(name)
        assert world.cover == pytest.approx(float(name[6:]) / 100 if asked is None else asked, abs=0.006)


RANGES = {"cells": 1.35, "cluttered": 3.35, "poles": 4.35, "rooms": 2.6}
"""Kinds that are drawn over a range of bottlenecks, and how much wider than the vehicle the widest is [m]."""


@pytest.mark.parametrize("name", RANGES)
def test_each_seed_has_the_bottleneck_that_was_drawn_for_it(name):
    """Whatever the kind, and for each vehicle, to a centimetre."""
    source = load_world(name)
    assert source.max_clearance == RANGES[name]
    for seed, width in ((0, 0.65), (1, 0.5)):
        share = rng(seed, Stream.BOTTLENECK).random()
        wanted = width + 0.1 + share * (RANGES[name] - 0.1)
        world = source.draw(seed, width)
        assert wanted - 0.001 <= world.bottleneck.width <= wanted + 0.011
        assert is_crossable(world, wanted / 2 - 0.005)
        assert not is_crossable(world, wanted / 2 + 0.01)
        assert world == source.draw(seed, width)


@pytest.mark.parametrize(
    ("name", "count"), [("rooms", 200), *(pytest.param(name, 200, marks=pytest.mark.slow) for name in sorted(RANGES))]
)
def test_bottlenecks_are_spread_evenly_over_their_range(name, count):
    widths = [load_world(name).draw(seed, 0.65).bottleneck.width for seed in range(700_000, 700_000 + count)]
    assert min(widths) >= 0.75 - 1e-9
    assert kstest(widths, uniform(0.755, RANGES[name] - 0.1).cdf).pvalue > 0.01


def test_a_denser_layout_keeps_what_stood_there():
    for name in ("cells", "cluttered", "poles"):
        layout, arena = load_world(name).layout, Arena(12.0, 24.0, ((6.0, 3.0), (6.0, 21.0)))
        sparse, dense = (set(layout.denser(share).place(arena, np.random.default_rng(3))) for share in (0.02, 0.06))
        assert sparse < dense


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"max_clearance": 0.05}, "max_clearance 0.05 is less than clearance 0.1"),
        ({"layout": {"kind": "traps", "count": 2}}, "a layout 'traps' cannot be made denser; leave it out"),
        ({"layout": {"kind": "boxes"}}, "a layout 'boxes' cannot be made denser; leave it out"),
    ],
)
def test_a_range_that_cannot_be_had_is_refused(values, message):
    layout = {"kind": "rooms"}
    with pytest.raises(UserError, match=message):
        source_of(**{"layout": layout, "max_clearance": 1.0, **values})


def test_a_bottleneck_that_no_density_gives_is_refused():
    layout = {"kind": "rooms", "min_door": 0.5, "max_door": 0.6}
    source = source_of(layout=layout, max_clearance=1.0, width=24.0, depth=16.0, start=[2, 2], target=[22, 14])
    with pytest.raises(UserError, match=r"in 50 attempts none had a bottleneck of 0\.90 m; make the layout sparser"):
        source.draw(0, 0.65)


def test_the_search_for_a_bottleneck_ends_after_so_many_obstacles(monkeypatch):
    monkeypatch.setattr("nnql_bullet.worlds.source.MOST_DRAWN", 10_000)
    layout = {"kind": "cells", "fill": 0.5, "cell": 0.2}
    source = source_of(layout=layout, max_clearance=1.0, width=20.0, depth=20.0, start=[4, 4], target=[16, 16])
    arena = Arena(20.0, 20.0, ((4.0, 4.0), (16.0, 16.0)))
    counts = np.cumsum([len(source.layout.place(arena, rng(0, Stream.LAYOUT, attempt))) for attempt in range(50)])
    with pytest.raises(UserError, match=rf"in {1 + np.argmax(counts > 10_000)} attempts none had a bottleneck"):
        source.draw(0, 0.65)


def test_poles_without_room_are_refused_soon():
    """A world of the fuzz harness: dense, with ends too free for a narrow place."""
    layout = {"kind": "poles", "count": 40, "spacing": 0.4}
    source = source_of(layout=layout, max_clearance=1.35, width=24.0, depth=24.0, target=[21, 21], target_radius=1.0)
    begin = process_time()
    with pytest.raises(UserError, match=r"as dense as it can be, its bottleneck is 6\.00 m"):
        source.draw(1, 0.65)
    assert process_time() - begin < 5.0


@pytest.mark.parametrize("digits", [3, 4])
def test_numbers_are_rounded_as_python_rounds_them(digits):
    ties = np.arange(-20_001, 20_001, 2) / (2 * 10**digits)
    values = np.concatenate([ties, np.nextafter(ties, np.inf), np.nextafter(ties, -np.inf), ties * np.e, ties * 1e6])
    assert as_rounded(values, digits).tolist() == [round(value, digits) for value in values.tolist()]


def test_a_layout_that_cannot_be_dense_enough_is_refused_at_once():
    layout = {"kind": "poles", "count": 1, "spacing": 4.0}
    source = source_of(layout=layout, max_clearance=0.2, width=16.0, depth=16.0, start=[3, 3], target=[13, 13])
    with pytest.raises(
        UserError, match=r"layout: as dense as it can be, its bottleneck is \d\.\d\d m and not 0\.\d\d m"
    ):
        source.draw(0, 0.65)


@pytest.mark.parametrize("simulator", ["kinematic", "bullet"])
def test_a_drive_measures_no_bottleneck_and_no_path(simulator, monkeypatch):
    """They take seconds among 20 000 shapes; reports, pictures and refusals measure them."""
    monkeypatch.setattr("nnql_bullet.worlds.spec.narrowest_passage", Mock(side_effect=AssertionError))
    monkeypatch.setattr("nnql_bullet.worlds.paths.shortest_path", Mock(side_effect=AssertionError))
    recording = nb.drive("straight", world="cover_10", seed=1, simulator=simulator, shield=True)
    assert recording.summary.duration > 1.0
    with nb.make_env(simulator=simulator, world="cover_10") as env:
        env.reset(seed=1)
        env.step(0)
    with pytest.raises(AssertionError):
        load_world("cover_10").draw(1).bottleneck  # noqa: B018


def test_every_shipped_world_is_tested():
    assert sorted(SHIPPED) == sorted(path.stem for path in assets.folder("worlds").glob("*.toml"))


def test_base_gives_what_a_world_leaves_out(tmp_path):
    (tmp_path / "ground.toml").write_text(
        'width = 50.0\ntarget = [40, 40]\n[layout]\nkind = "random_boxes"\ncover = 0.1\nmin_side = 1.0\n'
    )
    (tmp_path / "middle.toml").write_text('base = "ground"\ndepth = 60.0\n')
    (tmp_path / "top.toml").write_text('base = "middle"\ntarget = [45, 45]\n[layout]\ncover = 0.2\n')
    source = load_world(str(tmp_path / "top.toml"))
    assert source.name == "top"
    assert (source.width, source.depth, source.target) == (50.0, 60.0, (45.0, 45.0))
    assert (source.layout.cover, source.layout.min_side) == (0.2, 1.0)


def test_explicit_boxes_may_replace_the_random_ones_of_a_base(tmp_path):
    boxes = "[{ x = 50.0, y = 50.0, length = 4.0, width = 2.0 }]"
    (tmp_path / "mine.toml").write_text(f'base = "paper"\n[layout]\nkind = "boxes"\nboxes = {boxes}\n')
    world = load_world(str(tmp_path / "mine.toml")).draw(0, 0.8)
    assert world.obstacles == (OrientedBox(50.0, 50.0, 2.0, 1.0, 0.0),)


def test_base_may_be_a_shipped_world(tmp_path):
    (tmp_path / "mine.toml").write_text('base = "cover_10"\ntarget_radius = 3.0\n')
    file = load_world(str(tmp_path / "mine.toml"))
    assert (file.target_radius, file.layout.cover) == (3.0, 0.1)


@pytest.mark.parametrize("bases", [("a",), ("b", "a"), ("b", "c", "a"), ("../worlds/a",), ("../worlds/b", "./a")])
def test_base_that_leads_back_to_itself_is_refused(tmp_path, bases):
    folder = tmp_path / "worlds"
    folder.mkdir()
    for name, base in zip("abc", bases, strict=False):
        (folder / f"{name}.toml").write_text(f'base = "{base}"\n')
    with pytest.raises(UserError, match="its 'base' leads back to itself"):
        load_world(str(folder / "a.toml"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            'widht = 3.0\n[layout]\nkind = "boxes"\nboxes = []\n',
            r"unknown key 'widht' \(did you mean 'width'\?\); valid keys: at_rest, clearance, depth, layout, "
            r"max_clearance, name, obstacle_height, origin, origin_yaw_degrees, patrols, start, "
            r"start_yaw_degrees, target, target_radius, waypoints, width",
        ),
        (
            '[layout]\nkind = "random_boxes"\ncover = 0.1\nsize = 2.0\n',
            r"unknown key 'layout\.size'; valid keys: clear_radius, cover, kind, max_side, min_side$",
        ),
        (
            '[layout]\nkind = "random_boxes"\ncovr = 0.1\n',
            r"unknown key 'layout\.covr' \(did you mean 'layout\.cover'\?\); valid keys: clear_radius, cover",
        ),
        ('[layout]\nkind = "boxes"\nboxs = []\n', r"unknown key 'layout\.boxs'; valid keys: boxes, circles, kind$"),
        (
            '[layout]\nkind = "boxes"\nboxes = [{x = 1, y = 1, length = 1, width = 1, hight = 1}]\n',
            r"unknown key 'layout\.boxes\.0\.hight'; valid keys: length, width, x, y, yaw_degrees$",
        ),
        (
            '[layout]\nkind = "maze"\n',
            r"'layout\.kind' must be one of: aisles, boxes, cells, poles, random_boxes, rooms, traps$",
        ),
        (
            "[layout]\ncover = 0.1\n",
            r"'layout\.kind' must be one of: aisles, boxes, cells, poles, random_boxes, rooms, traps$",
        ),
        ("width = 3.0\n", r"key 'layout' is missing$"),
        ('[layout]\nkind = "random_boxes"\n', r"key 'layout\.cover' is missing$"),
        ('[layout]\nkind = "random_boxes"\ncover = 0.9\n', r"'layout\.cover': input should be less than or equal"),
        (
            '[layout]\nkind = "random_boxes"\ncover = 0.1\nmin_side = 9.0\n',
            r"'layout': min_side 9 is above max_side 8$",
        ),
        ("base = 3\n", r"'base' must be the name of a world$"),
        (
            'base = "atlantis"\n',
            r"there is no file 'atlantis'; give a path .* one of: aisles, cells, cluttered, cover_10",
        ),
        (
            '[layout]\nkind = "traps"\ncount = 3\nmin_depth = 20.0\n',
            r"'layout': min_depth 20 is above max_depth 15$",
        ),
        ('[layout]\nkind = "traps"\ncount = 0\n', r"'layout\.count': input should be greater than or equal to 1"),
        ('[layout]\nkind = "aisles"\nmin_rack = 20.0\n', r"'layout': min_rack 20 is above max_rack 9$"),
        ('[layout]\nkind = "aisles"\ngap_chance = 1.5\n', r"'layout\.gap_chance': input should be less than or equal"),
        (
            'base = "paper"\n[patrols]\nnumber = 3\n',
            r"unknown key 'patrols\.number'; valid keys: clear_radius, count, max",
        ),
        ('base = "paper"\n[patrols]\nmax_side = 2.0\n', r"key 'patrols\.count' is missing$"),
        ('base = "paper"\n[patrols]\ncount = 3\nmax_speed = 1.2\n', r"'patrols\.max_speed': input should be less than"),
        (
            'base = "paper"\n[patrols]\ncount = 3\nmax_track = 5.0\n',
            r"'patrols': min_track 10 is above max_track 5$",
        ),
        ("width = \n", r"cannot be read as TOML"),
    ],
)
def test_mistake_in_a_world_file_is_one_line_that_says_what_is_valid(tmp_path, text, message):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as refusal:
        load_world(str(path))
    assert "\n" not in str(refusal.value)


def test_unknown_world_lists_the_shipped_ones():
    with pytest.raises(UserError, match="there is no file 'atlantis'") as refusal:
        load_world("atlantis")
    assert all(name in str(refusal.value) for name in SHIPPED)


@pytest.mark.parametrize("tries", [2, 33, random_boxes.MOST_TRIES])
def test_boxes_do_not_depend_on_how_many_are_drawn_at_a_time(monkeypatch, tries):
    expected = load_world("cover_10").draw(0, ROOM)
    monkeypatch.setattr(random_boxes, "FIRST_TRIES", tries)
    assert load_world("cover_10").draw(0, ROOM) == expected
