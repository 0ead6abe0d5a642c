from math import cos, hypot, inf, isclose, nextafter, pi, radians, sin, sqrt

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from shapely import affinity

from nnql_bullet.blocks import bounds_of, cast_rays
from nnql_bullet.geometry import (
    Circle,
    OrientedBox,
    Pose,
    as_rows,
    bearing,
    clearance,
    closest_points,
    distance,
    moved,
    ray_distances,
    squared_distance,
    wrap_angle,
)

RANGE = 10.0

coordinates = st.floats(-15, 15, allow_subnormal=False)
angles = st.floats(-7, 7, allow_subnormal=False)
sides = st.floats(0.05, 6, allow_subnormal=False)
poses = st.builds(Pose, coordinates, coordinates, angles)
boxes = st.builds(OrientedBox, coordinates, coordinates, sides, sides, angles)
several_boxes = st.lists(boxes, min_size=1, max_size=6).map(tuple)


def polygon(box, grown=0.0):
    """The box as shapely makes it, with its half extents grown."""
    length, width = box.half_length + grown, box.half_width + grown
    turned = affinity.rotate(shapely.box(-length, -width, length, width), box.yaw, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, box.x, box.y)


def rays_by_shapely(origin, directions, polygons):
    start = shapely.Point(origin)
    ends = [(origin[0] + RANGE * cos(a), origin[1] + RANGE * sin(a)) for a in directions]
    rays = np.array([shapely.LineString([origin, end]) for end in ends])
    met = shapely.intersection(rays[:, None], np.array(polygons)[None, :])
    return np.nanmin(np.c_[shapely.distance(start, met), np.full(len(rays), RANGE)], axis=1)


@given(st.floats(-100, 100))
@example(pi)
@example(-pi)
@example(nextafter(pi, 4))
@example(nextafter(-pi, -4))
@example(nextafter(-pi, 0))
@example(3 * pi)
@example(0.0)
@settings(max_examples=100, deadline=None)
def test_wrapped_angle_is_the_same_direction_in_the_half_open_interval(angle):
    wrapped = wrap_angle(angle)
    assert -pi < wrapped <= pi
    assert cos(wrapped) == pytest.approx(cos(angle), abs=1e-12)
    assert sin(wrapped) == pytest.approx(sin(angle), abs=1e-12)


def test_wrap_angle_keeps_plus_pi_and_turns_minus_pi_around():
    angles = {pi: pi, -pi: pi, 3 * pi: pi, 1.5 * pi: -0.5 * pi, -1.5 * pi: 0.5 * pi, 0.0: 0.0}
    assert [wrap_angle(angle) for angle in angles] == pytest.approx(list(angles.values()), abs=1e-12)


@pytest.mark.parametrize(
    ("pose", "point", "expected"),
    [
        (Pose(0, 0, 0), (1, 0), 0),
        (Pose(0, 0, 0), (0, 1), pi / 2),
        (Pose(0, 0, 0), (0, -1), -pi / 2),
        (Pose(0, 0, 0), (-1, 0), pi),
        (Pose(0, 0, pi / 2), (0, 5), 0),
        (Pose(0, 0, pi / 2), (-5, 0), pi / 2),
        (Pose(20, 20, pi / 4), (90, 90), 0),
        (Pose(1, 2, -pi), (0, 2), 0),
        (Pose(0, 0, radians(170)), (-1, -1), radians(55)),
    ],
)
def test_bearing_is_positive_to_the_left_of_the_vehicle(pose, point, expected):
    assert bearing(pose, *point) == pytest.approx(expected, abs=1e-12)


@given(poses, coordinates, coordinates)
@settings(max_examples=50, deadline=None)
def test_driving_along_the_bearing_over_the_distance_arrives(pose, x, y):
    heading, way = pose.yaw + bearing(pose, x, y), distance(pose, x, y)
    assert pose.x + way * cos(heading) == pytest.approx(x, abs=1e-9)
    assert pose.y + way * sin(heading) == pytest.approx(y, abs=1e-9)


@given(boxes)
@settings(max_examples=50, deadline=None)
def test_corners_are_those_of_the_turned_rectangle_counter_clockwise(box):
    ring = shapely.Polygon(box.corners())
    assert ring.exterior.is_ccw
    assert shapely.hausdorff_distance(ring, polygon(box)) < 1e-9
    assert box.area == pytest.approx(polygon(box).area)


@given(boxes, poses)
@settings(max_examples=50, deadline=None)
def test_moved_box_is_carried_along_rigidly_with_the_pose(box, pose):
    turned = affinity.rotate(polygon(box), pose.yaw, origin=(0, 0), use_radians=True)
    carried = affinity.translate(turned, pose.x, pose.y)
    result = moved(box, pose)
    assert shapely.hausdorff_distance(carried, polygon(result)) < 1e-9
    assert -pi < result.yaw <= pi


@given(boxes, several_boxes)
@settings(max_examples=100, deadline=None)
def test_clearance_is_shapelys_distance_to_the_nearest_box(footprint, others):
    expected = min(polygon(footprint).distance(polygon(other)) for other in others)
    assert clearance(as_rows((footprint,))[0], as_rows(others)) == pytest.approx(expected, abs=1e-7)


@given(coordinates, coordinates, boxes)
@settings(max_examples=100, deadline=None)
def test_squared_distance_of_a_point_is_that_of_shapely(x, y, box):
    expected = polygon(box).distance(shapely.Point(x, y))
    assert squared_distance(x, y, as_rows((box,))[0]) == pytest.approx(expected**2, abs=1e-7)


@given(boxes, boxes)
@settings(max_examples=50, deadline=None)
def test_clearance_is_symmetric(one, other):
    there = clearance(as_rows((one,))[0], as_rows((other,)))
    back = clearance(as_rows((other,))[0], as_rows((one,)))
    assert there == pytest.approx(back, abs=1e-9)


def test_clearance_is_zero_where_one_box_lies_within_the_other():
    small, large = OrientedBox(0.1, 0.2, 0.3, 0.1, 1.0), OrientedBox(0, 0, 5, 4, 0.3)
    assert clearance(as_rows((small,))[0], as_rows((large,))) == 0
    assert clearance(as_rows((large,))[0], as_rows((small,))) == 0


def test_clearance_is_zero_for_crossing_boxes_with_no_corner_in_the_other():
    assert clearance(as_rows((OrientedBox(0, 0, 5, 0.1),))[0], as_rows((OrientedBox(0, 0, 0.1, 5),))) == 0


def test_clearance_between_parallel_sides_and_corners_is_exact():
    box = as_rows((OrientedBox(0, 0, 1, 1),))
    assert clearance(as_rows((OrientedBox(4, 0.5, 1, 1),))[0], box) == pytest.approx(2.0, abs=1e-12)
    assert clearance(as_rows((OrientedBox(5, 6, 1, 1),))[0], box) == pytest.approx(5.0, abs=1e-12)


def test_clearance_of_a_point_is_its_distance_to_the_box():
    box = as_rows((OrientedBox(0, 0, 1, 1, pi / 4),))
    assert clearance(as_rows((OrientedBox(3, 0, 0, 0),))[0], box) == pytest.approx(3 - hypot(1, 1), abs=1e-12)


def test_clearance_in_an_empty_world_is_infinite():
    assert clearance(as_rows((OrientedBox(0, 0, 1, 1),))[0], as_rows(())) == inf


def test_no_boxes_are_an_array_of_no_rows():
    assert as_rows(()).shape == (0, 7)


@given(coordinates, coordinates, st.lists(angles, min_size=1, max_size=12), several_boxes)
@settings(max_examples=100, deadline=None)
def test_rays_end_where_shapely_cuts_them(x, y, directions, obstacles):
    measured = ray_distances((x, y), np.array(directions), as_rows(obstacles), RANGE)
    # A ray that grazes a corner may go either way: boxes a micrometre larger and smaller enclose the answer.
    soonest = rays_by_shapely((x, y), directions, [polygon(box, 1e-6) for box in obstacles])
    latest = rays_by_shapely((x, y), directions, [polygon(box, -1e-6) for box in obstacles])
    assert np.all(measured >= soonest - 1e-9)
    assert np.all(measured <= latest + 1e-9)


def test_rays_end_where_shapely_cuts_them_on_a_full_circle():
    generator = np.random.default_rng(5)
    obstacles = tuple(
        OrientedBox(r * cos(a), r * sin(a), *generator.uniform(0.3, 1.2, 2), generator.uniform(-pi, pi))
        for r, a in zip(generator.uniform(3, 11, 12), generator.uniform(-pi, pi, 12), strict=True)
    )
    directions = np.linspace(-pi, pi, 144)
    measured = ray_distances((0.3, -0.2), directions, as_rows(obstacles), RANGE)
    expected = rays_by_shapely((0.3, -0.2), directions, [polygon(box) for box in obstacles])
    assert measured == pytest.approx(expected, abs=1e-9)
    assert 0.2 < np.mean(measured < RANGE) < 0.9
    assert measured.min() > 0


def test_rays_in_an_empty_world_read_the_sensor_range():
    assert ray_distances((1, 2), np.linspace(0, 6, 7), as_rows(()), RANGE).tolist() == [RANGE] * 7


def test_no_rays_give_no_distances():
    assert ray_distances((0, 0), np.array([]), as_rows((OrientedBox(3, 0, 1, 1),)), RANGE).shape == (0,)


def test_rays_from_inside_a_box_read_zero():
    measured = ray_distances((3.2, 0.1), np.linspace(0, 6, 9), as_rows((OrientedBox(3, 0, 1, 1, 0.4),)), RANGE)
    assert measured.tolist() == [0.0] * 9


@pytest.mark.parametrize(
    ("origin", "angle", "expected"),
    [
        ((0, 0), 0.0, 4.0),  # parallel to two sides, between them
        ((0, 0.999), 0.0, 4.0),
        ((0, 1.001), 0.0, RANGE),  # parallel to two sides, just outside
        ((0, -1.001), 0.0, RANGE),
        ((0, 0), pi, RANGE),  # away from the box
        ((10, 0), pi, 4.0),
        ((5, -8), pi / 2, 7.0),
        ((3.999, -8), pi / 2, RANGE),
    ],
)
def test_rays_parallel_to_the_sides_of_a_box(origin, angle, expected):
    measured = ray_distances(origin, np.array([angle]), as_rows((OrientedBox(5, 0, 1, 1),)), RANGE)
    assert measured == pytest.approx([expected], abs=1e-9)


def test_a_ray_along_a_face_reads_the_face_or_nothing():
    (measured,) = ray_distances((0, 1), np.array([0.0]), as_rows((OrientedBox(5, 0, 1, 1),)), RANGE)
    assert isclose(measured, 4.0) or measured == RANGE


def test_the_nearest_of_several_boxes_stops_a_ray():
    row = tuple(OrientedBox(x, 0, 0.5, 0.5) for x in (8, 3, 6))
    assert ray_distances((0, 0), np.array([0.0]), as_rows(row), RANGE) == pytest.approx([2.5])


def test_a_box_beyond_the_range_is_not_seen():
    assert ray_distances((0, 0), np.array([0.0]), as_rows((OrientedBox(12, 0, 1, 1),)), RANGE).tolist() == [RANGE]


class TestCircles:
    """Shapely's circles are polygons of 4000 corners; a vehicle, rays and the closest points see the same."""

    @staticmethod
    def scene(seed):
        rng = np.random.default_rng(seed)
        shapes = [OrientedBox(*rng.uniform(0, 20, 2), *rng.uniform(0.1, 2, 2), rng.uniform(0, 3)) for _ in range(4)]
        shapes += [Circle(*rng.uniform(0, 20, 2), rng.uniform(0.01, 1.5)) for _ in range(8)]
        areas = [
            shapely.Point(s.x, s.y).buffer(s.radius, quad_segs=1000) if isinstance(s, Circle) else polygon(s)
            for s in shapes
        ]
        return rng, shapes, areas

    @pytest.mark.parametrize("seed", range(10))
    def test_distances_are_shapelys(self, seed):
        rng, shapes, areas = self.scene(seed)
        rows = as_rows(shapes)
        footprint = OrientedBox(*rng.uniform(0, 20, 2), 0.55, 0.33, rng.uniform(0, 3))
        expected = [polygon(footprint).distance(area) for area in areas]
        assert clearance(as_rows((footprint,))[0], rows) == pytest.approx(min(expected), abs=1e-5)
        x, y = rng.uniform(0, 20, 2)
        far = [shapely.Point(x, y).distance(area) for area in areas]
        assert [sqrt(squared_distance(x, y, row)) for row in rows] == pytest.approx(far, abs=1e-5)
        for i, j in rng.integers(0, len(shapes), (20, 2)):
            if i != j:
                ax, ay, bx, by = closest_points(rows[i], rows[j])
                assert np.hypot(ax - bx, ay - by) == pytest.approx(areas[i].distance(areas[j]), abs=1e-5)
                assert areas[i].distance(shapely.Point(ax, ay)) < 1e-5
                assert areas[j].distance(shapely.Point(bx, by)) < 1e-5

    @pytest.mark.parametrize("seed", range(10))
    def test_rays_end_where_shapely_says_in_both_kernels(self, seed):
        rng, shapes, areas = self.scene(seed)
        (x, y), angles = rng.uniform(0, 20, 2), rng.uniform(-pi, pi) + np.arange(40) * pi / 20
        found = ray_distances((x, y), angles, as_rows(shapes), 10.0)
        everything = shapely.union_all(areas)
        for angle, reading in zip(angles, found, strict=True):
            ray = shapely.LineString([(x, y), (x + 10 * cos(angle), y + 10 * sin(angle))])
            hit = ray.intersection(everything)
            assert reading == pytest.approx(10.0 if hit.is_empty else shapely.Point(x, y).distance(hit), abs=1e-3)
        cast = np.empty(len(angles))
        directions = np.column_stack([np.cos(angles - 0.3), np.sin(angles - 0.3)])
        cast_rays(x, y, 0.3, directions, as_rows(shapes), bounds_of(as_rows(shapes)), 10.0, cast)
        assert cast == pytest.approx(found, abs=1e-9)
