"""Pictures by VTK: things are where the camera's projection says, in their colours, lit as they are there."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from math import radians
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from nnql_bullet.agents.rules.straight import Straight
from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, Pose, as_rows, squared_distance
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.painter import Painter
from nnql_bullet.render.raster import RasterRenderer
from nnql_bullet.render.renderers import make_renderer
from nnql_bullet.render.solids import BOX, MOVING, WALL, Renderer, Solids
from nnql_bullet.render.timeline import Moment, Timeline
from nnql_bullet.rollout import run_episode
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.visuals import upright
from nnql_bullet.worlds.spec import Patrol, WorldSpec

NEEDS_VTK = pytest.mark.skipif(
    find_spec("pyvista") is None, reason="needs the extra: pip install 'nnql-bullet[render]'"
)

CAMERA = Camera((5.0, 6.0, 5.0), (11.0, 10.0, 0.0), radians(60), 320, 180, near=1.0)
FROM_ABOVE = Camera((14.0, 14.0, 60.0), (14.0, 14.0, 0.0), radians(30), 240, 240, near=40.0, far=80.0)
HEIGHT = 1.5


@pytest.fixture(scope="module")
def recording(vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]) -> Recording:
    """Four decisions straight ahead past two boxes, one of which moves."""
    moves = Patrol(OrientedBox(9.0, 13.0, 0.5, 0.7, 0.3), (12.0, 15.0), 1.0, 0.1)
    boxes = OrientedBox(13.0, 8.0, 1.0, 0.6, 0.5), OrientedBox(17.0, 15.0, 1.5, 1.0)
    world = world_of(*boxes, side=28.0, start=Pose(6.0, 9.0, 0.25), target=(25.0, 25.0))
    simulator = contact_simulator("bullet", "fast", vehicle, DriveOptions(), 1)
    recorder = Recorder(vehicle)
    navigation = Navigation(simulator, TaskOptions(max_steps=4))
    run_episode(navigation, replace(world, patrols=(moves,)), Straight(), watcher=recorder)
    simulator.close()
    return recorder.recording(policy="straight")


@pytest.fixture(scope="module")
def timeline(recording: Recording) -> Timeline:
    return Timeline(recording)


@pytest.fixture(scope="module")
def moment(timeline: Timeline) -> Moment:
    return timeline.at(1.7)


@pytest.fixture(scope="module")
def renderer(recording: Recording) -> Iterator[Renderer]:
    made = make_renderer(recording, "vtk")
    yield made
    made.close()


def places(solids: Solids, camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Where the surfaces in pixels are (k, 3), by the inverse of the camera's matrices, and which pixels have any."""
    rows, columns = np.nonzero(solids.depths < 1)
    x, y = (columns + 0.5) / camera.width * 2 - 1, 1 - (rows + 0.5) / camera.height * 2
    device = np.column_stack([x, y, 2.0 * solids.depths[rows, columns] - 1, np.ones(len(x))])
    world = device @ np.linalg.inv(camera.projection @ camera.view).T
    return world[:, :3] / world[:, 3:], solids.depths < 1


def coloured(solids: Solids, colour: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Pixels of a colour, from 0 to 1."""
    return (np.abs(solids.colours[..., :3].astype(float) - 255 * np.array(colour)) < 1.5).all(axis=2)


@NEEDS_VTK
class TestSolids:
    @pytest.mark.parametrize("camera", [CAMERA, FROM_ABOVE], ids=["aslant", "from above"])
    def test_boxes_are_where_they_are(
        self, recording: Recording, moment: Moment, renderer: Renderer, camera: Camera
    ) -> None:
        solids = renderer.draw(moment, camera)
        points, there = places(solids, camera)
        for colour, boxes in ((BOX, recording.obstacles), (MOVING, moment.movers), (WALL, recording.world.walls)):
            seen = coloured(solids, colour)
            assert seen.sum() > 40
            for x, y, z in points[seen[there]].tolist():
                off = min(np.sqrt(squared_distance(x, y, row)) for row in as_rows(boxes))
                assert off < 0.02
                assert -0.02 < z < HEIGHT + 0.02
        assert solids.colours.shape == (camera.height, camera.width, 3)

    @pytest.mark.parametrize("camera", [CAMERA, FROM_ABOVE], ids=["aslant", "from above"])
    def test_corners_appear_where_they_are_projected(
        self, recording: Recording, moment: Moment, renderer: Renderer, camera: Camera
    ) -> None:
        solids = renderer.draw(moment, camera)
        seen = coloured(solids, MOVING)
        corners = np.array([(x, y, z) for x, y in moment.movers[0].corners() for z in (0.0, HEIGHT)])
        pixels, ahead = camera.project(corners)
        assert (ahead > camera.near).all()
        rows, columns = np.nonzero(seen)
        assert columns.min() == pytest.approx(pixels[:, 0].min() - 0.5, abs=1.1)
        assert columns.max() == pytest.approx(pixels[:, 0].max() - 0.5, abs=1.1)
        assert rows.min() == pytest.approx(pixels[:, 1].min() - 0.5, abs=1.1)
        assert rows.max() == pytest.approx(pixels[:, 1].max() - 0.5, abs=1.1)

    def test_the_vehicle_stands_on_the_ground_over_its_footprint(
        self, recording: Recording, moment: Moment, renderer: Renderer
    ) -> None:
        camera = Camera((9.5, 6.0, 1.0), (moment.pose.x, moment.pose.y, 0.2), radians(30), 480, 300, near=0.5)
        solids = renderer.draw(moment, camera)
        points, there = places(solids, camera)
        c, s = np.cos(moment.pose.yaw), np.sin(moment.pose.yaw)
        local = (points[:, :2] - (moment.pose.x, moment.pose.y)) @ np.array([[c, -s], [s, c]])
        near = (np.abs(local) < 2.0).all(axis=1)
        other = (coloured(solids, BOX) | coloured(solids, MOVING) | coloured(solids, WALL))[there]
        local, height = local[near & ~other], points[near & ~other, 2]
        assert len(local) > 3000
        assert height.min() == pytest.approx(0.0, abs=0.01)
        assert height.max() == pytest.approx(0.635, abs=0.01)  # the head of the mast
        box = recording.footprint
        assert local[:, 0].min() > box.x - box.half_length - 0.02
        assert local[:, 0].max() == pytest.approx(box.x + box.half_length, abs=0.02)
        assert local[:, 1].min() == pytest.approx(-box.half_width, abs=0.02)

    def test_it_sees_what_the_rasteriser_sees(self, recording: Recording, moment: Moment, renderer: Renderer) -> None:
        """The vehicle's outline too, but for pixels on edges."""
        close = Camera((9.5, 6.0, 1.0), (moment.pose.x, moment.pose.y, 0.2), radians(30), 480, 300, near=1.0)
        other = RasterRenderer(recording)
        for camera in (CAMERA, close):
            theirs, ours = (each.draw(moment, camera).depths < 1 for each in (other, renderer))
            edges = (theirs != np.roll(theirs, 1, axis=0)) | (theirs != np.roll(theirs, 1, axis=1))
            assert 0.01 < np.mean(theirs) < 0.9
            assert np.sum(theirs != ours) < 0.1 * np.sum(edges)

    def test_the_same_instant_gives_the_same_picture(
        self, moment: Moment, timeline: Timeline, renderer: Renderer
    ) -> None:
        first, _, second = (renderer.draw(m, CAMERA) for m in (moment, timeline.at(0.2), moment))
        for name in ("colours", "depths", "light"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name))

    def test_pictures_of_two_sizes_show_the_same(self, moment: Moment, renderer: Renderer) -> None:
        small = renderer.draw(moment, CAMERA).depths
        large = renderer.draw(moment, replace(CAMERA, width=960, height=540)).depths
        assert np.mean(np.abs(large[1::3, 1::3] - small) > 1e-4) < 0.01


@NEEDS_VTK
class TestLight:
    def test_there_is_shadow_on_the_ground_and_on_the_vehicle(
        self, timeline: Timeline, moment: Moment, renderer: Renderer
    ) -> None:
        solids = renderer.draw(moment, CAMERA)
        ground = solids.depths == 1
        dark, bright = ground & (solids.light < 0.5), ground & (solids.light > 0.99)
        assert solids.light.max() < 1.5
        assert dark.sum() > 100
        assert bright.sum() > 10000
        picture, depths = Painter(timeline, renderer).paint(moment, CAMERA)
        assert picture.shape == (180, 320, 3)
        assert np.mean((depths < 1) == ~ground) > 0.99
        assert picture[dark].mean() < 0.6 * picture[bright].mean()
        deck = _pixels(CAMERA, upright(moment.pose.x, moment.pose.y, 0.125, moment.pose.yaw), 0.26)
        assert solids.light[deck].min() < 0.7 < 0.95 < solids.light[deck].max()  # the mast's shadow lies on it


def _pixels(camera: Camera, frame: NDArray[np.float64], height: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns in which places of the deck appear, at a height over the axle [m]."""
    x, y = np.meshgrid(np.linspace(0.0, 0.8, 40), np.linspace(-0.25, 0.25, 25))
    local = np.stack([x, y, np.full_like(x, height), np.ones_like(x)], axis=-1).reshape(-1, 4)
    pixels, _ = camera.project((local @ frame.T)[:, :3])
    columns, rows = np.floor(pixels).astype(int).T
    return rows, columns


def test_without_the_extra_it_names_it(
    recording: Recording, tmp_path: Path, run_cli: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "nnql_bullet.render.vtk", raising=False)
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(UserError, match=r"nnql-bullet\[render\]"):
        make_renderer(recording, "vtk")
    recording.save(tmp_path / "drive.npz")
    code, out, err = run_cli("render", tmp_path / "drive.npz", "--renderer", "vtk")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "nnql-bullet[render]" in err
    assert [path.name for path in tmp_path.iterdir()] == ["drive.npz"]


def test_a_recording_that_does_not_say_what_the_vehicle_looks_like_is_one_line_and_nothing_written(
    recording: Recording, tmp_path: Path, run_cli: Callable[..., tuple[int, str, str]]
) -> None:
    vehicle = {key: value for key, value in recording.about["vehicle"].items() if key != "urdf"}
    replace(recording, about={**recording.about, "vehicle": vehicle}).save(tmp_path / "old.npz")
    for renderer in ("raster", "vtk") if find_spec("pyvista") else ("raster",):
        code, out, err = run_cli("render", tmp_path / "old.npz", "--renderer", renderer)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "record it again" in err
    assert [path.name for path in tmp_path.iterdir()] == ["old.npz"]
