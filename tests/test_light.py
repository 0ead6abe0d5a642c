"""Light as it falls, against closed forms, dense rays in NumPy, and another library's meshes."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from nnql_bullet.geometry import OrientedBox, as_rows
from nnql_bullet.render.light import (
    BOUNCE,
    SUN_RADIUS,
    SUN_SHARE,
    Boxes,
    Parts,
    light_at,
    meets_parts,
    placed_parts,
    sky_directions,
    standing_boxes,
    sun_directions,
    with_movers,
)
from nnql_bullet.render.shading import LEAN
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.visuals import Kind, Shape, upright
from nnql_bullet.worlds.spec import WorldSpec

WorldOf = Callable[..., WorldSpec]

UP = (0.0, 0.0, 1.0)
HEIGHT = 1.5
GREY = (0.5, 0.5, 0.5)
AWAY = Shape("somewhere", "box", (0.1, 0.1, 0.1), np.eye(4), GREY)
NOWHERE = placed_parts([AWAY], [upright(-900.0, 0.0, 0.0, 0.0)])


def light(place: Vector, boxes: Boxes, parts: Parts = NOWHERE, normal: Vector = UP) -> float:
    return float(light_at(place, normal, boxes, parts, np.empty(len(boxes.rows), np.int64), 0, 1))


def sun_of(found: float, sky: float) -> float:
    """What is left for the sun of the light on level ground, if that is its share of the sky."""
    return (found - (1 - SUN_SHARE) * sky) / SUN_SHARE


class TestDirections:
    def test_the_sky_is_covered_evenly(self) -> None:
        directions = sky_directions(2000)
        assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
        assert (directions[:, 2] > 0).all()
        assert directions.mean(axis=0) == pytest.approx([0.0, 0.0, 0.5], abs=0.002)  # centroid of a half sphere

    def test_the_sun_stands_where_shadows_lean_away_from(self) -> None:
        directions = sun_directions(500)
        middle = directions.mean(axis=0)
        assert -middle[:2] / middle[2] == pytest.approx(LEAN, abs=1e-3)
        off = np.arccos(directions @ middle / np.linalg.norm(middle))
        assert off.max() == pytest.approx(SUN_RADIUS, rel=0.01)
        assert (off**2).mean() == pytest.approx(SUN_RADIUS**2 / 2, rel=0.02)  # of an evenly bright disc


class TestOpenGround:
    def test_it_has_all_the_light_there_is(self, empty_world: WorldSpec) -> None:
        assert light((100.0, 90.0, 0.001), standing_boxes(empty_world)) == pytest.approx(1.0, abs=1e-6)

    def test_an_upright_face_sees_half_the_sky_and_half_of_what_the_ground_throws_back(
        self, empty_world: WorldSpec
    ) -> None:
        boxes = standing_boxes(empty_world)
        shaded = (LEAN[0] / np.hypot(*LEAN), LEAN[1] / np.hypot(*LEAN), 0.0)  # it faces away from the sun
        found = light((100.0, 90.0, 1.0), boxes, normal=shaded)
        assert found == pytest.approx((1 - SUN_SHARE) / 2 + BOUNCE / 2, abs=2e-3)
        slant = 1 / np.hypot(*LEAN)  # of the sun: light on an upright face that looks at it, over that on the ground
        lit = light((100.0, 90.0, 1.0), boxes, normal=(-shaded[0], -shaded[1], 0.0))
        assert lit - found == pytest.approx(SUN_SHARE / slant, abs=2e-3)


class TestBoxes:
    @pytest.mark.parametrize("away", [0.2, 0.5, 1.0, 2.0])
    def test_the_sky_at_the_foot_of_a_long_wall(self, world_of: WorldOf, away: float) -> None:
        """An endless wall takes (1 - cos beta) / 2, with beta the elevation of its top (Howell's catalogue)."""
        wall = OrientedBox(100.0 + 0.5, 60.0, 0.5, 30.0)  # its shadow falls to the other side
        found = light((100.0 - away, 60.0, 1e-4), standing_boxes(world_of(wall)))
        assert 1 - found == pytest.approx((1 - SUN_SHARE) * (1 - away / np.hypot(away, HEIGHT)) / 2, abs=0.006)

    def test_the_shadow_is_as_long_as_the_sun_stands_low_and_its_edge_as_soft_as_the_sun_is_large(
        self, world_of: WorldOf
    ) -> None:
        boxes = standing_boxes(world_of(OrientedBox(100.0, 60.0, 2.0, 20.0)))
        end = 102.0 + LEAN[0] * HEIGHT
        slope = 1 + LEAN[0] ** 2 + LEAN[1] ** 2  # from an angle to a way on the ground, for an edge across the lean
        soft = SUN_RADIUS * HEIGHT * slope
        sky = [1 - (1 - (x - 102.0) / np.hypot(x - 102.0, HEIGHT)) / 2 for x in (end - soft, end + soft)]
        dark, bright = (light((x, 60.0, 1e-4), boxes) for x in (end - soft, end + soft))
        assert sun_of(dark, sky[0]) == pytest.approx(0.0, abs=0.02)
        assert sun_of(bright, sky[1]) == pytest.approx(1.0, abs=0.02)
        across = [light((x, 60.0, 1e-4), boxes) for x in np.linspace(end - soft, end + soft, 9)]
        assert (np.diff(across) > -1e-6).all()

    def test_boxes_that_move_count_where_they_are(self, world_of: WorldOf) -> None:
        box = OrientedBox(100.0, 60.0, 1.0, 2.0, 0.4)
        place = (101.6, 60.0, 0.01)
        still, empty = standing_boxes(world_of(box)), standing_boxes(world_of())
        assert light(place, with_movers(empty, (box,))) == pytest.approx(light(place, still))
        assert light(place, with_movers(empty, (OrientedBox(90.0, 60.0, 1.0, 2.0),))) == pytest.approx(1.0, abs=1e-6)
        assert light(place, still) < 0.7

    def test_the_sky_among_boxes_is_what_dense_rays_find(self, world_of: WorldOf) -> None:
        rng = np.random.default_rng(5)
        crowd = tuple(OrientedBox(*row) for row in rng.uniform((98, 58, 0.3, 0.3, -3), (102, 62, 0.8, 0.8, 3), (6, 5)))
        boxes, sky = standing_boxes(world_of(*crowd)), sky_directions(5000)
        checked = 0
        for x, y, z, angle in rng.uniform((97, 57, 0.01, -3), (103, 63, 1.3, 3), (50, 4)):
            if np.hypot(*_outside(x, y, as_rows(crowd))).min() == 0:
                continue
            shaded = np.array([np.cos(angle), np.sin(angle), 0.3]) / np.hypot(1, 0.3)
            if shaded @ (-LEAN[0], -LEAN[1], 1.0) > 0:
                continue  # the sun is for other tests
            facing = np.maximum(sky @ shaded, 0.0)
            free = ~_blocked(np.array([x, y, z]), sky, as_rows(crowd))
            expected = (1 - SUN_SHARE) * (facing * free).sum() / sky[:, 2].sum() + BOUNCE * (1 - shaded[2]) / 2
            found = light((x, y, z), boxes, normal=(shaded[0], shaded[1], shaded[2]))
            assert found == pytest.approx(expected, abs=0.012)
            checked += 1
        assert checked > 5


def _outside(x: float, y: float, rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    dx, dy = x - rows[:, 0], y - rows[:, 1]
    along, across = rows[:, 4] * dx + rows[:, 5] * dy, rows[:, 4] * dy - rows[:, 5] * dx
    return np.maximum(np.abs(along) - rows[:, 2], 0), np.maximum(np.abs(across) - rows[:, 3], 0)


def _blocked(
    place: NDArray[np.float64], directions: NDArray[np.float64], rows: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether rays meet boxes, by marching along them."""
    blocked = np.zeros(len(directions), bool)
    for step in np.arange(0.01, 4.0, 0.03):
        points = place + step * directions
        dx, dy = points[:, :1] - rows[:, 0], points[:, 1:2] - rows[:, 1]
        along, across = rows[:, 4] * dx + rows[:, 5] * dy, rows[:, 4] * dy - rows[:, 5] * dx
        inside = (np.abs(along) < rows[:, 2]) & (np.abs(across) < rows[:, 3])
        blocked |= inside.any(axis=1) & (points[:, 2] < HEIGHT)
    return blocked


class TestVehicle:
    @pytest.mark.parametrize("kind", ["box", "cylinder", "sphere"])
    def test_rays_meet_shapes_where_another_library_meets_their_meshes(self, kind: Kind) -> None:
        rng = np.random.default_rng(2)
        sizes = {"box": (0.3, 0.2, 0.15), "cylinder": (0.3, 0.3, 0.1), "sphere": (0.25, 0.25, 0.25)}[kind]
        meshes = {
            "box": lambda: trimesh.creation.box(2 * np.array(sizes)),
            "cylinder": lambda: trimesh.creation.cylinder(sizes[0], 2 * sizes[2], sections=512),
            "sphere": lambda: trimesh.creation.icosphere(subdivisions=5, radius=sizes[0]),
        }
        frame = trimesh.transformations.euler_matrix(0.5, -0.3, 1.1)
        frame[:3, 3] = 1.0, 2.0, 0.6
        parts = placed_parts([Shape("it", kind, sizes, np.eye(4), GREY)], [frame])
        starts = frame[:3, 3] + rng.normal(size=(2000, 3))
        aims = frame[:3, 3] + rng.uniform(-0.4, 0.4, size=(2000, 3)) - starts
        aims *= rng.choice((1.0, -1.0), size=(2000, 1), p=(0.9, 0.1)) / np.linalg.norm(aims, axis=1, keepdims=True)
        expected = meshes[kind]().apply_transform(frame).ray.intersects_any(starts, aims)
        found = [meets_parts(tuple(p), tuple(d), parts) for p, d in zip(starts.tolist(), aims.tolist(), strict=True)]
        assert 500 < expected.sum() < 1700
        assert np.mean(expected != found) < 0.004  # rays that graze

    def test_under_a_plate_it_is_nearly_dark_and_far_from_it_it_is_not(self, empty_world: WorldSpec) -> None:
        plate = Shape("plate", "box", (1.0, 1.0, 0.01), np.eye(4), GREY)
        parts = placed_parts([plate], [upright(100.0, 60.0, 0.1, 0.3)])
        boxes = standing_boxes(empty_world)
        assert light((100.0, 60.0, 0.001), boxes, parts) < 0.02
        assert light((104.0, 60.0, 0.001), boxes, parts) == pytest.approx(1.0, abs=1e-6)
