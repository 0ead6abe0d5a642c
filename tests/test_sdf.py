"""SDF and BARN worlds: nested poses, cuts of shapes, what is left out by name, and what is written is read back."""

from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Circle, OrientedBox, Pose, placed
from nnql_bullet.worlds.exporters import write_foreign
from nnql_bullet.worlds.importers import ForeignWorld, Reading, read_foreign
from nnql_bullet.worlds.importers.barn import path_file, read_reference_path
from nnql_bullet.worlds.spec import WorldSpec

BOX = "<box><size>4 2 1.5</size></box>"
PILLAR = "<cylinder><radius>0.5</radius><length>3</length></cylinder>"


def shape(geometry: str, pose: str = "", tag: str = "collision") -> str:
    return f"<{tag} name='c'>{pose and f'<pose>{pose}</pose>'}<geometry>{geometry}</geometry></{tag}>"


def model(inner: str, pose: str = "", name: str = "m") -> str:
    return f"<model name='{name}'>{pose and f'<pose>{pose}</pose>'}<link name='l'>{inner}</link></model>"


def world_file(folder: Path, *parts: str, name: str = "x.world") -> Path:
    path = folder / name
    path.write_text(f"<sdf version='1.6'><world name='w'>{''.join(parts)}</world></sdf>")
    return path


def read(path: Path, **reading: Any) -> ForeignWorld:
    return read_foreign(path, Reading(**reading))


def shapes(found: ForeignWorld) -> list[tuple[float, ...]]:
    """Places and sizes in the frame of the file, rounded."""
    rows = []
    for its in found.shapes:
        size = (its.radius,) if isinstance(its, Circle) else (its.half_length, its.half_width, its.yaw)
        rows.append(tuple(round(value, 6) + 0.0 for value in (*placed(found.frame, its.x, its.y), *size)))
    return rows


class TestShapes:
    def test_boxes_cylinders_and_spheres(self, tmp_path: Path) -> None:
        sphere = "<sphere><radius>2</radius></sphere>"
        path = world_file(
            tmp_path,
            model(shape(BOX), "1 2 0.75 0 0 0.5"),
            model(shape(PILLAR), "10 0 1.5 0 0 0"),
            model(shape(sphere), "20 0 -1 0 0 0"),
            model(shape(sphere), "30 0 3 0 0 0"),
        )
        found = read(path)
        # The spheres are cut at the ground, 1 m over its centre, and at 1.5 m, 1.5 m under it.
        cuts = [(20.0, 0.0, round(sqrt(3), 6)), (30.0, 0.0, round(sqrt(4 - 1.5**2), 6))]
        assert shapes(found) == [(1.0, 2.0, 2.0, 1.0, 0.5), (10.0, 0.0, 0.5), *cuts]

    def test_poses_are_nested_from_model_to_model_to_link_to_collision(self, tmp_path: Path) -> None:
        """Against the product of four turns by a right angle, each with a step of 1 m ahead."""
        turn = f"1 0 0 0 0 {pi / 2}"
        link = f"<link name='l'><pose>{turn}</pose>{shape(BOX, turn)}</link>"
        nested = f"<model name='a'><pose>{turn}</pose><model name='b'><pose>{turn}</pose>{link}</model></model>"
        assert shapes(read(world_file(tmp_path, nested, model(shape(PILLAR), "50 50 0 0 0 0"))))[0] == (
            *(0.0, 0.0, 2.0, 1.0, 0.0),
        )

    def test_shapes_on_their_side_have_the_outline_from_above(self, tmp_path: Path) -> None:
        """A log along y, and a box on its end: 1.5 m x 2 m from above."""
        found = read(
            world_file(
                tmp_path,
                model(shape(PILLAR), f"0 0 0.5 {pi / 2} 0 0"),
                model(shape(BOX), f"9 0 2 0 {pi / 2} 0"),
            )
        )
        log, block = found.shapes
        assert isinstance(log, OrientedBox)
        assert (log.half_length, log.half_width, abs(log.yaw)) == pytest.approx((1.5, 0.5, pi / 2))
        assert isinstance(block, OrientedBox)
        corners = block.corners() - (block.x, block.y)
        assert abs(corners).max(axis=0) == pytest.approx((0.75, 1.0))
        assert not any("tilted: " in note for note in found.notes) or "1 of 2" in "".join(found.notes)

    def test_a_tilted_box_is_the_rectangle_around_its_outline(self, tmp_path: Path) -> None:
        found = read(world_file(tmp_path, model(shape(BOX), "0 0 1 0 0.5 0.3"), model(shape(PILLAR), "9 9 0 0 0 0")))
        (its, _) = found.shapes
        assert isinstance(its, OrientedBox)
        along = 2 * np.cos(0.5) + 0.75 * np.sin(0.5)
        assert (its.half_length, its.half_width, its.yaw) == pytest.approx((along, 1.0, 0.3))
        assert any("1 of 2 shapes are tilted" in note for note in found.notes)

    def test_heights_are_stated(self, tmp_path: Path) -> None:
        over, under = model(shape(BOX), "0 0 9 0 0 0", "lamp"), model(shape(BOX), "0 0 -9 0 0 0", "cellar")
        kerb = model(shape("<box><size>1 1 0.1</size></box>"), "5 5 0.05 0 0 0")
        found = read(world_file(tmp_path, over, under, kerb))
        assert len(found.shapes) == 1
        assert any("begins 8.25 m above the ground" in what and "lamp" in what for what in found.skipped)
        assert any("below the ground" in what and "cellar" in what for what in found.skipped)
        assert any("do not reach from the ground up to 1.5 m" in note for note in found.notes)
        assert len(read(world_file(tmp_path, over, kerb), height=9).shapes) == 2

    def test_degrees_and_quaternions(self, tmp_path: Path) -> None:
        degrees = f"<model name='a'><pose degrees='true'>1 0 1 0 0 90</pose><link name='l'>{shape(BOX)}</link></model>"
        turned = sqrt(0.5)
        quat = f"<model name='b'><pose rotation_format='quat_xyzw'>9 0 1 0 0 {turned} {turned}</pose>"
        found = read(world_file(tmp_path, degrees, f"{quat}<link name='l'>{shape(BOX)}</link></model>"))
        right = round(pi / 2, 6)
        assert shapes(found) == [(1.0, 0.0, 2.0, 1.0, right), (9.0, 0.0, 2.0, 1.0, right)]

    def test_a_state_replaces_the_pose_of_its_model(self, tmp_path: Path) -> None:
        state = "<state world_name='w'><model name='m'><pose>7 8 0 0 0 0</pose></model></state>"
        assert shapes(read(world_file(tmp_path, model(shape(BOX), "1 1 0 0 0 0"), state)))[0][:2] == (7.0, 8.0)


class TestLeftOut:
    def test_what_is_not_read_is_named(self, tmp_path: Path) -> None:
        found = read(
            world_file(
                tmp_path,
                model(shape(BOX)),
                model(shape("<mesh><uri>model://shelf/shelf.dae</uri></mesh>"), name="shelf"),
                "<include><uri>model://ground_plane</uri></include><include><uri>model://sun</uri></include>",
                "<include><uri>model://cafe_table</uri></include>" * 2,
                "<model name='far'><pose relative_to='other'>1 0 0 0 0 0</pose></model>",
                model(shape("<plane><normal>0 0 1</normal></plane>")),
                model(shape(BOX, tag="visual"), name="ghost"),
            )
        )
        assert len(found.shapes) == 1
        assert len(found.skipped) == 3
        for part in ("shelf.dae", "cafe_table: only what the file itself describes is read (2 times)", "'other'"):
            assert any(part in what for what in found.skipped), part
        assert any("1 link without collision" in note for note in found.notes)

    @pytest.mark.parametrize(
        ("text", "match"),
        [
            ("", "cannot be read as SDF"),
            ("<robot name='r'/>", "its root is <robot>"),
            ("<sdf><world name='a'/><world name='b'/></sdf>", "has 2 worlds"),
            ("<sdf><world name='a'/></sdf>", "no obstacle in it"),
            ("<!DOCTYPE sdf [<!ENTITY a 'b'>]><sdf/>", "document type"),
            ("<sdf>" * 60, "50 deep"),
            ("<?xml version='1.0' encoding='none'?><sdf/>", "cannot be read as SDF"),
            (f"<sdf>{model(shape(BOX), '1 2 3')}</sdf>", "<pose> must be 6 finite numbers"),
            (f"<sdf>{model(shape(BOX), 'nan 0 0 0 0 0')}</sdf>", "<pose> must be 6 finite numbers"),
            (f"<sdf>{model(shape('<box><size>1 1</size></box>'))}</sdf>", "<box><size> must be 3 finite numbers"),
            (f"<sdf>{model(shape('<box><size>1 -1 1</size></box>'))}</sdf>", "not of 0 to 1000 m"),
            (f"<sdf>{model(shape('<sphere><radius>1e5</radius></sphere>'))}</sdf>", "radii are 0 to 1000 m"),
            (f"<sdf>{model(shape(BOX), '5e5 0 0 0 0 0')}{model(shape(BOX))}</sdf>", "arenas are up to 1000 m"),
        ],
    )
    def test_what_is_wrong_is_refused_in_one_line(self, tmp_path: Path, text: str, match: str) -> None:
        (tmp_path / "x.sdf").write_text(text)
        with pytest.raises(UserError, match=match) as refusal:
            read(tmp_path / "x.sdf")
        assert "\n" not in str(refusal.value)


class TestWritten:
    def test_a_written_world_is_read_back_in_its_own_walls(self, tmp_path: Path) -> None:
        obstacles = (OrientedBox(3.0, 2.0, 1.0, 0.25, 0.3), Circle(6.0, 4.0, 0.125))
        world = WorldSpec("a <b> & 'c'", 0, 9.0, 7.0, obstacles, Pose(1, 1, 0), (8, 6), 0.5, 1.5)
        write_foreign(world, Pose(-4.0, 10.0, 0.0), tmp_path / "x.sdf")
        found = read(tmp_path / "x.sdf")
        assert (found.shapes, found.width, found.depth) == (obstacles, 9.0, 7.0)
        assert found.frame == Pose(-4.0, 10.0, 0.0)

    @pytest.mark.parametrize("name", ["rooms", "traps", "poles", "aisles"])
    def test_shipped_worlds_go_there_and_back(self, tmp_path: Path, name: str) -> None:
        drawn = nb.World.load(name).draw(3)
        nb.export_world(name, tmp_path / "x.world", seed=3)
        found = read(tmp_path / "x.world")
        assert (found.width, found.depth) == (drawn.width, drawn.depth)
        assert len(found.shapes) == len(drawn.obstacles)
        for one, other in zip(found.shapes, drawn.obstacles, strict=True):
            assert (one.x, one.y, one.area) == pytest.approx((other.x, other.y, other.area))


@pytest.fixture
def barn(tmp_path: Path) -> Path:
    """A world as in BARN: a column of cylinders half buried, and a path."""
    half_buried = "<cylinder><radius>0.075</radius><length>1</length></cylinder>"
    rows = [model(shape(half_buried), f"-4.425 {0.075 + 0.15 * k:.3f} 0 0 0 0", f"c{k}") for k in range(60)]
    (tmp_path / "worlds").mkdir()
    (tmp_path / "path_files").mkdir()
    np.save(tmp_path / "path_files" / "path_7.npy", np.array([[16, 0], [16, 1], [17, 29]]))
    return world_file(tmp_path / "worlds", *rows, name="world_7.world")


class TestBarn:
    def test_start_and_target_are_those_of_the_challenge(self, barn: Path) -> None:
        found = nb.import_world(barn)
        spec, frame = found.world.draw(0), found.world.frame
        assert found.format == "BARN world"
        assert placed(frame, spec.start.x, spec.start.y) == pytest.approx((-2, 3))
        assert placed(frame, *spec.target) == pytest.approx((-2, 13))
        assert (spec.start.yaw, spec.target_radius, found.chosen) == (pytest.approx(pi / 2), 1.0, "")
        assert len(spec.obstacles) == 60
        assert all(isinstance(its, Circle) and its.radius == 0.075 for its in spec.obstacles)

    def test_the_reference_path_is_in_metres(self, barn: Path) -> None:
        """Cells of 0.15 m from (-4.5, 5): the first centre is at (-2.025, 5.075)."""
        file = path_file(barn)
        assert file
        assert read_reference_path(file) == pytest.approx(np.array([[-2.025, 5.075], [-2.025, 5.225], [-1.875, 9.425]]))

    def test_a_world_of_another_name_is_no_world_of_barn(self, barn: Path) -> None:
        assert path_file(barn.with_name("world_8.world")) is None
        assert path_file(barn.with_name("hall.world")) is None

    @pytest.mark.parametrize(
        "array", [np.zeros(3), np.zeros((1, 2)), np.array([["a", "b"]] * 2), np.full((2, 2), np.nan)]
    )
    def test_a_path_that_is_none_is_refused(self, tmp_path: Path, array: Any) -> None:
        np.save(tmp_path / "path_1.npy", array)
        with pytest.raises(UserError, match="columns and rows"):
            read_reference_path(tmp_path / "path_1.npy")

    def test_a_pickle_is_not_opened(self, tmp_path: Path) -> None:
        np.save(tmp_path / "path_1.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
        with pytest.raises(UserError, match="cannot be read as an array"):
            read_reference_path(tmp_path / "path_1.npy")
