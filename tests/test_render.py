"""Recordings as moving pictures: instants, cameras, renderers, the ground, the overlay, and files of frames."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import atan2, cos, pi, radians, sin, tan
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from nnql_bullet import colours, diagnosis
from nnql_bullet.agents.learning.nnql import Nnql
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.env import SLOW, STOP, Navigation, Observation
from nnql_bullet.errors import UserError, WorkFailed
from nnql_bullet.executors import Executor, InlineExecutor, ProcessExecutor, ThreadExecutor
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, as_rows, clearance_at
from nnql_bullet.recording import Recorder, Recording, load_recording
from nnql_bullet.render import shading
from nnql_bullet.render.camera import PATHS, Camera
from nnql_bullet.render.film import Film, frame_times, frames, studio_of
from nnql_bullet.render.painter import Painter, tint
from nnql_bullet.render.raster import RasterRenderer
from nnql_bullet.render.sheet import contact_sheet, key_moments
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.render.video import write_pictures, write_video
from nnql_bullet.render.window import Window
from nnql_bullet.rollout import run_episode
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sim.bullet import bullet, load_text
from nnql_bullet.sim.bullet_scene import _one_visual_per_link
from nnql_bullet.sim.c_library import silenced
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.payload import deck_load, loaded
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import Patrol, WorldSpec

SIZE = 320, 180
Run = Callable[..., tuple[int, str, str]]


def record(vehicle: VehicleSpec, world: WorldSpec, action: int, max_steps: int = 500, **about: object) -> Recording:
    """A drive of one action over and over, by an ideal vehicle."""
    simulator = KinematicSimulator(vehicle, DriveOptions(), 1)
    recorder = Recorder(vehicle)

    class Scripted(Nnql):
        """Takes the action, whatever its network says."""

        def act(self, observations: Observation, state: None) -> tuple[NDArray[np.int64], None]:
            return np.full(len(observations.state_property), action), None

    navigation = Navigation(simulator, TaskOptions(max_steps=max_steps))
    run_episode(navigation, world, Scripted(NnqlOptions(), 0), watcher=recorder)
    simulator.close()
    return recorder.recording(policy="script", simulator="kinematic", **about)


@pytest.fixture(scope="module")
def drive(vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]) -> Recording:
    """Straight ahead past a box, then a collision after 9 s with another."""
    boxes = OrientedBox(12.0, 13.0, 2.0, 1.0, 0.3), OrientedBox(25.0, 10.0, 1.0, 4.0)
    return record(vehicle, world_of(*boxes, side=40.0, start=Pose(5.0, 10.0, 0.0), target=(36.0, 36.0)), 0)


@pytest.fixture(scope="module")
def drive_file(drive: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.npz"
    drive.save(path)
    return path


@pytest.fixture(scope="module")
def circles(vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]) -> Recording:
    """Left turns, among them some over the angle where yaws jump, with a box that moves."""
    patrol = Patrol(OrientedBox(10.0, 30.0, 0.5, 0.5), (30.0, 30.0), 1.0, 0.25)
    world = world_of(side=40.0, start=Pose(20.0, 15.0, 3.0), target=(3.0, 36.0))
    return record(vehicle, replace(world, patrols=(patrol,)), 2, max_steps=20)


def camera_over(x: float, y: float, up: float = 20.0) -> Camera:
    """Straight down."""
    return Camera((x, y, up), (x, y, 0.0), radians(40), *SIZE, near=up - 5.0, far=up + 5.0)


# Instants


def test_between_samples_a_straight_drive_is_where_constant_speed_takes_it(drive: Recording) -> None:
    timeline = Timeline(drive)
    for time in np.linspace(0.0, timeline.duration, 97):
        moment = timeline.at(time)
        assert moment.pose.x == pytest.approx(5.0 + 2.0 * time, abs=1e-6)
        assert (moment.pose.y, moment.pose.yaw) == (10.0, 0.0)
        assert moment.speed == pytest.approx(2.0)
        rolled = 2.0 * max(time, 1 / 30) / 0.125  # the first sample is what is known of the joints at the start
        assert moment.joint_angles[:2] == (pytest.approx(rolled), pytest.approx(rolled))
        assert moment.step == min(int(time / 0.5), len(drive.action) - 1)
        assert moment.over == (time >= timeline.duration)


def test_yaws_are_interpolated_the_short_way_round(circles: Recording, vehicle: VehicleSpec) -> None:
    timeline = Timeline(circles)
    assert np.ptp(circles.sample_pose[:, 2]) > 6.0  # it jumps from pi to -pi
    turned = np.unwrap([timeline.at(time).pose.yaw for time in np.arange(0.0, timeline.duration, 1 / 480)])
    assert np.abs(np.diff(turned)).max() <= vehicle.limits.yaw_rate / 480 + 1e-9  # never faster than the vehicle turns
    assert turned[-1] - turned[0] > 2 * pi


def test_moving_boxes_are_where_their_tracks_say(circles: Recording) -> None:
    (box,) = Timeline(circles).at(3.0).movers
    assert (box.x, box.y) == (pytest.approx(10.0 + 40.0 * 0.25 + 3.0), 30.0)


def test_the_path_grows_with_time_and_knows_safe_states(drive: Recording) -> None:
    timeline = Timeline(drive)
    assert len(timeline.path(0.0)) == 1
    assert len(timeline.path(1.0)) == 31
    assert len(timeline.path(timeline.duration)) == len(drive.sample_time) + 1 == len(timeline.safe()) + 1
    states = drive.state_property[np.clip(((np.arange(len(timeline.safe())) + 0.5) / 15).astype(int), 0, None)]
    assert timeline.safe().tolist() == (states != "NS").tolist()


# Cameras


@pytest.mark.parametrize("eye", [(3.0, -2.0, 2.5), (-4.0, 1.0, 6.0)])
def test_a_camera_has_the_matrices_that_pybullet_computes(eye: tuple[float, float, float]) -> None:
    camera = Camera(eye, (1.0, 0.5, 0.2), radians(50), 640, 360, near=0.3, far=90.0)
    view = bullet.computeViewMatrix(eye, camera.target, (0, 0, 1))
    projection = bullet.computeProjectionMatrixFOV(50.0, 640 / 360, 0.3, 90.0)
    assert np.allclose(camera.view.T.ravel(), view, atol=1e-6)
    assert np.allclose(camera.projection.T.ravel(), projection, atol=1e-6)


def test_what_is_in_the_middle_appears_there_and_what_is_behind_nowhere() -> None:
    camera = Camera((0.0, 0.0, 2.0), (10.0, 0.0, 0.0), radians(50), 640, 360, near=0.3, far=90.0)
    pixels, distances = camera.project(np.array([[10.0, 0.0, 0.0], [-10.0, 0.0, 0.0], [10.0, 1.0, 0.0]]))
    assert pixels[0] == pytest.approx((320.0, 180.0))
    assert distances[0] == pytest.approx(np.hypot(10.0, 2.0))
    assert np.isnan(pixels[1]).all()
    assert pixels[2, 0] < 320.0  # the left of somebody who looks along x


def test_from_above_a_metre_is_as_many_pixels_as_the_pinhole_model_says() -> None:
    camera = camera_over(5.0, 7.0)
    pixels, _ = camera.project(np.array([[5.0, 7.0, 0.0], [6.0, 7.0, 0.0], [5.0, 8.0, 0.0]]))
    metre = SIZE[1] / 2 / tan(radians(20)) / 20.0
    assert pixels - pixels[0] == pytest.approx(np.array([[0, 0], [metre, 0], [0, -metre]]))


@pytest.mark.parametrize("name", PATHS)
def test_every_camera_keeps_the_vehicle_in_the_picture(name: str, circles: Recording) -> None:
    timeline = Timeline(circles)
    path = PATHS[name](timeline, *SIZE)
    for time in np.linspace(0.0, timeline.duration, 40):
        moment = timeline.at(time)
        (pixel,), _ = path(moment).project(np.array([[moment.pose.x, moment.pose.y, 0.2]]))
        assert 0 < pixel[0] < SIZE[0]
        assert 0 < pixel[1] < SIZE[1]


# Solid things


def test_the_vehicle_is_drawn_where_its_pose_says(circles: Recording) -> None:
    """From above it covers the union of its footprint and of its wheels, which stick out."""
    timeline, renderer = Timeline(circles), RasterRenderer(circles)
    for time in (0.0, 2.2, 6.1):
        moment = timeline.at(time)
        camera = camera_over(moment.pose.x, moment.pose.y, 6.0)
        seen = np.argwhere(renderer.draw(moment, camera).depths < 1.0)[:, ::-1] + 0.5
        c, s = cos(moment.pose.yaw), sin(moment.pose.yaw)
        metre = SIZE[1] / 2 / tan(radians(20)) / (6.0 - 0.3)  # at about the height of the deck
        offset = (seen - (SIZE[0] / 2, SIZE[1] / 2)) * (1, -1) / metre
        ahead, left = offset @ (c, s), offset @ (-s, c)
        assert (ahead.min(), ahead.max()) == (pytest.approx(-0.20, abs=0.06), pytest.approx(0.90, abs=0.06))
        assert (left.min(), left.max()) == (pytest.approx(-0.325, abs=0.06), pytest.approx(0.325, abs=0.06))


@pytest.mark.parametrize("name", ["chase", "orbit"])
def test_pybullet_sees_the_same_bodies(name: str, drive: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its window's scene by TinyRenderer: which pixels are of a box or of the vehicle, and their depths."""
    monkeypatch.setattr(bullet, "GUI", bullet.DIRECT)
    window, timeline = Window(drive), Timeline(drive)
    client = window._scene.client
    bodies = len(drive.obstacles) + len(drive.world.walls) + 1  # then come the ground and the target
    for time in (1.0, 6.0):
        moment = timeline.at(time)
        camera = PATHS[name](timeline, *SIZE)(moment)
        window.show(time)
        view, lens = camera.view.T.ravel().tolist(), camera.projection.T.ravel().tolist()
        tiny = bullet.getCameraImage(*SIZE, view, lens, renderer=bullet.ER_TINY_RENDERER, physicsClientId=client)
        theirs, mask = (np.reshape(tiny[k], SIZE[::-1]) for k in (3, 4))
        ours = RasterRenderer(drive).draw(moment, camera).depths
        solid = (mask >= 0) & (mask < bodies)
        edges = (mask != np.roll(mask, 1, axis=0)) | (mask != np.roll(mask, 1, axis=1))
        assert np.sum(solid != (ours < 1.0)) < 0.7 * np.sum(edges)
        both = solid & (ours < 1.0)
        assert both.sum() > 1000
        assert np.quantile(np.abs(theirs - ours)[both], 0.9) < 5e-3  # half a pixel apart
    window.close()


def test_triangles_that_meet_leave_no_gap_and_nothing_is_lost_beside_the_camera(drive: Recording) -> None:
    """Between two walls of the arena, close to one of them, the whole lower part of the picture is a wall."""
    wall = max(drive.world.walls, key=lambda wall: wall.x)
    eye = wall.x - wall.half_length - wall.half_width - 0.5, 20.0, 0.5
    camera = Camera(eye, (wall.x, 22.0, 0.5), radians(60), *SIZE, near=0.05, far=100.0)
    solids = RasterRenderer(drive).draw(Timeline(drive).at(0.0), camera)
    assert (solids.depths[SIZE[1] // 2, :] < 1.0).all()
    rows = np.flatnonzero(solids.depths[:, SIZE[0] // 2] < 1.0)
    assert (np.diff(rows) == 1).all()


def test_depths_lead_back_to_the_surfaces(drive: Recording) -> None:
    """Every pixel of a solid thing is, in the world, on a box or on the vehicle."""
    timeline, renderer = Timeline(drive), RasterRenderer(drive)
    moment = timeline.at(3.0)
    camera = PATHS["chase"](timeline, *SIZE)(moment)
    depths, eye = renderer.draw(moment, camera).depths.astype(np.float64), shading.eye_of(camera)
    rows, columns = np.nonzero(depths < 1.0)
    x, y = (2 * columns + 1) / SIZE[0] - 1, 1 - (2 * rows + 1) / SIZE[1]
    rays = np.array(eye.ahead) + np.outer(x, eye.right) + np.outer(y, eye.up)
    near, far = camera.near, camera.far
    ahead = 2 * near * far / (far + near - (2 * depths[rows, columns] - 1) * (far - near))
    places = np.array(camera.eye) + ahead[:, None] * rays
    pixel = 2 * ahead * tan(camera.field_of_view / 2) / SIZE[1]
    assert (places[:, 2] > -0.02 - pixel).all()
    assert (places[:, 2] < drive.world.obstacle_height + 0.02 + pixel).all()
    vehicle = OrientedBox(moment.pose.x + 0.35, moment.pose.y, 0.56, 0.34, moment.pose.yaw)
    boxes = as_rows((*drive.obstacles, *drive.world.walls, vehicle))
    point = as_rows((OrientedBox(0.0, 0.0, 1e-6, 1e-6),))[0]
    off = [clearance_at(*place, 0.0, point, boxes) for place in places[::37, :2].tolist()]
    assert (np.array(off) < 0.02 + 3 * pixel[::37]).all()


def test_faces_have_their_colour_and_the_light_of_their_direction(
    vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]
) -> None:
    """A turned box and a cylinder, whose normals are known, at places that the camera sees from several sides."""
    box, post = OrientedBox(20.0, 20.0, 1.5, 0.5, 0.4), Circle(24.0, 20.0, 0.8)
    world = replace(world_of(side=40.0, start=Pose(5.0, 5.0, 0.0), target=(36.0, 36.0)), obstacles=(box, post))
    recording = record(vehicle, world, 0, max_steps=1)
    renderer, moment = RasterRenderer(recording), Timeline(recording).at(0.0)
    to_sun = np.array([-shading.LEAN[0], -shading.LEAN[1], 1.0])
    sides = [(box.yaw + k * pi / 2, (1.5, 0.5)[k % 2], box) for k in range(4)]
    sides += [(k * pi / 6, post.radius, post) for k in range(12)]
    faces = [((its.x + r * cos(a), its.y + r * sin(a), 1.0), (cos(a), sin(a), 0.0)) for a, r, its in sides]
    faces += [((its.x, its.y, world.obstacle_height), (0.0, 0.0, 1.0)) for its in (box, post)]
    for angle in 0.2 + np.arange(8) * pi / 4:
        eye = 22.0 + 12.0 * cos(angle), 20.0 + 12.0 * sin(angle), 6.0
        camera, seen = Camera(eye, (22.0, 20.0, 0.7), radians(40), *SIZE, near=1.0), 0
        solids = renderer.draw(moment, camera)
        for place, normal in faces:
            (column, row), ahead = (its[0] for its in camera.project(np.array([place])))
            row, column = int(row), int(column)
            hidden = shading.distance_ahead(float(solids.depths[row, column]), shading.eye_of(camera)) < ahead - 0.3
            way = np.subtract(eye, place)
            if hidden or way @ normal < 0.3 * np.linalg.norm(way):
                continue
            sunny = max(to_sun @ normal, 0.0) / np.linalg.norm(to_sun)
            assert solids.light[row, column] == pytest.approx(0.62 + 0.14 * normal[2] + 0.34 * sunny, abs=0.02)
            assert (solids.colours[row, column] == colours.rgb(colours.SOLID_BOX)).all()
            seen += 1
        assert seen >= 4


def test_a_payload_is_seen(vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]) -> None:
    world = world_of(side=40.0, start=Pose(5.0, 10.0, 0.0), target=(36.0, 36.0))
    nearest = []
    for carried in (vehicle, loaded(vehicle, deck_load(vehicle, 40.0))):
        recording = record(carried, world, 0, max_steps=2)
        renderer = RasterRenderer(recording)
        depths = renderer.draw(Timeline(recording).at(0.0), camera_over(5.35, 10.0, 6.0)).depths
        nearest.append(2 * 1.0 * 11.0 / (12.0 - (2 * depths.min() - 1) * 10.0))
    mast, cube = 6.0 - np.array(nearest)
    assert (mast, cube) == (pytest.approx(0.635, abs=0.005), pytest.approx(0.75, abs=0.005))


def test_a_recording_without_the_look_of_the_vehicle_is_refused(drive: Recording) -> None:
    about = {**drive.about, "vehicle": {k: v for k, v in drive.about["vehicle"].items() if k != "urdf"}}
    old = replace(drive, about=about)
    with pytest.raises(UserError, match="record it again"):
        RasterRenderer(old)


# Ground and light


def test_shadows_fall_where_the_light_throws_them() -> None:
    """A box's shadow is its foot and all that lies between it and its top's, a metre up."""
    layer = np.zeros((200, 200), np.uint8)
    box = OrientedBox(5.0, 5.0, 1.0, 0.5, 0.4)
    shading.paint_shadow(layer, shading.blocks_of(layer), 0.05, as_rows((box,))[0], 1.0)
    centres = (np.arange(200) + 0.5) * 0.05
    x, y = np.meshgrid(centres, centres)
    inside = np.zeros_like(layer, dtype=bool)
    for up in np.linspace(0.0, 1.0, 101):
        dx, dy = x - 5.0 - up * shading.LEAN[0], y - 5.0 - up * shading.LEAN[1]
        along, across = cos(0.4) * dx + sin(0.4) * dy, cos(0.4) * dy - sin(0.4) * dx
        inside |= (np.abs(along) <= 1.0) & (np.abs(across) <= 0.5)
    assert layer[inside].min() > 200
    assert layer[~inside].mean() < 5.0
    assert layer[(np.hypot(x - 5, y - 5) > 3.0)].max() == 0


def test_a_line_of_the_path_covers_its_area() -> None:
    layer = np.zeros((100, 100), np.uint8)
    shading.paint_line(layer, shading.blocks_of(layer), 0.05, np.array([1.0, 1.0]), np.array([4.0, 3.0]), 0.1)
    area = layer.sum() / 255 * 0.05**2
    assert area == pytest.approx(np.hypot(3.0, 2.0) * 0.2 + pi * 0.1**2, rel=0.03)


def test_the_ground_shows_target_path_and_sectors_at_their_places(circles: Recording) -> None:
    timeline = Timeline(circles)
    painter = Painter(timeline, RasterRenderer(circles))
    moment = timeline.at(5.0)  # round once in 4 s: opposite to where it was at 3 s

    def colour_at(x: float, y: float) -> NDArray[np.int64]:
        picture, _ = painter.paint(moment, camera_over(x, y, 8.0))
        return np.asarray(picture[SIZE[1] // 2, SIZE[0] // 2], dtype=np.int64)

    floor = colour_at(37.1, 3.1)
    assert np.ptp(floor) < 10  # grey
    target = colour_at(3.0, 36.0)
    assert target[0] > 150 > 100 > target[1]  # red
    x, y = timeline.path(3.0)[-1]
    states = np.array([colours.rgb(colours.SAFE), colours.rgb(colours.NON_SAFE)])
    assert np.abs(colour_at(x, y) - states).sum(axis=1).min() < 120
    ahead = circles.state_pose[moment.step]
    free = colour_at(ahead[0] + 4 * cos(ahead[2] + 0.2), ahead[1] + 4 * sin(ahead[2] + 0.2))
    assert free[1] > free[0] + 10  # green, for the reading is far


def test_tints_go_from_red_over_yellow_to_green() -> None:
    near, middle, far = tint(np.array([0.0, 5.0, 10.0]), 10.0)
    assert near.argmax() == 0
    assert middle.argmin() == 2
    assert far.argmax() == 1
    steps = tint(np.linspace(0, 10, 1001), 10.0)
    assert np.abs(np.diff(steps, axis=0)).max() < 1.0  # without a jump


def test_a_film_may_go_back_in_time(drive: Recording) -> None:
    """What is painted depends on the instant alone, not on what was painted before."""
    timeline = Timeline(drive)
    path = PATHS["top"](timeline, *SIZE)
    first, second = (Painter(timeline, RasterRenderer(drive)) for _ in range(2))
    for time in (6.0, 2.0):
        painted, _ = first.paint(timeline.at(time), path(timeline.at(time)))
    fresh, _ = second.paint(timeline.at(2.0), path(timeline.at(2.0)))
    assert (painted == fresh).all()


@pytest.mark.parametrize("camera", ["chase", "top"])
def test_ground_that_is_left_out_as_empty_shows_nothing(drive: Recording, camera: str) -> None:
    timeline = Timeline(drive)
    moment = timeline.at(4.0)
    view = PATHS[camera](timeline, *SIZE)(moment)
    short, whole = (Painter(timeline, RasterRenderer(drive)) for _ in range(2))
    whole._busy[:] = 1  # nothing is left out
    pictures = [painter.paint(moment, view)[0] for painter in (short, whole)]
    assert (pictures[0] == pictures[1]).all() and not short._busy.all()


# What is written over it


def has(picture: NDArray[np.uint8], colour: str) -> int:
    """How many pixels have a colour."""
    return int((picture == np.array(colours.rgb(colour), dtype=np.uint8)).all(axis=2).sum())


def test_the_overlay_tells_values_states_and_the_ending(drive_file: Path) -> None:
    studio = studio_of(Film(drive_file, "chase", 640, 360, "raster"))
    recording = load_recording(drive_file)
    asked = int(np.flatnonzero(np.isfinite(recording.q_values).all(axis=1))[0])
    before, during = studio.frame(0.1), studio.frame(float(recording.state_time[asked]) + 0.2)
    end = studio.frame(float(recording.state_time[-1]))
    panel = np.s_[220:345, 6:120]  # lower left: values and the action
    assert has(during[panel], colours.NON_SAFE) > 10  # the bar of the action taken
    assert has(during[panel], colours.TIMEOUT) > 100  # the other bars
    assert has(before[panel], colours.TIMEOUT) == 0  # it did not ask itself yet
    state = np.s_[310:346, 540:634]
    assert has(before[state], colours.SAFE) > 300
    assert has(during[state], colours.NON_SAFE) > 300
    banner = np.s_[44:76, 200:440]
    assert has(before[banner], colours.COLLISION) == 0
    assert has(end[banner], colours.COLLISION) > 2000


def test_readings_are_not_written_over_what_hides_their_place(drive_file: Path) -> None:
    studio = studio_of(Film(drive_file, "chase", 640, 360, "raster"))
    timeline = Timeline(load_recording(drive_file))
    moment = timeline.at(timeline.duration)
    camera = PATHS["chase"](timeline, 640, 360)(moment)
    picture, depths = studio._painter.paint(moment, camera)
    hidden = studio._overlay.write(picture, np.zeros_like(depths), moment, [camera])
    shown = studio._overlay.write(picture, np.ones_like(depths), moment, [camera])
    assert (hidden != shown).any()


def test_a_sensor_off_the_middle_is_where_it_is(
    drive: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sectors on the ground begin at the sensor, and readings stand at their rims."""
    ahead, left, yaw = 1.0, 2.5, drive.state_pose[0, 2]
    vehicle = {**drive.about["vehicle"], "sensor": [ahead, left, 0.4]}
    replace(drive, about={**drive.about, "vehicle": vehicle}).save(tmp_path / "aside.npz")
    studio = studio_of(Film(tmp_path / "aside.npz", "chase", 640, 360, "raster"))
    moment = studio._timeline.at(0.0)
    sensor = drive.state_pose[0, :2] + (ahead * cos(yaw) - left * sin(yaw), ahead * sin(yaw) + left * cos(yaw))
    assert studio._painter._ground(moment).scan == pytest.approx((*sensor, yaw))
    written: list[Array] = []

    def project(_: Camera, points: Array) -> tuple[Array, None]:
        written.append(points)
        return np.full((len(points), 2), np.nan), None

    monkeypatch.setattr(Camera, "project", project)
    studio._overlay._mark_readings(None, None, moment, 0, PATHS["chase"](studio._timeline, 640, 360)(moment))  # type: ignore[arg-type]
    angles = yaw + np.arange(8) * pi / 4
    rims = sensor + (drive.readings[0] - 0.45)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    assert written[0][:, :2] == pytest.approx(rims)


def test_the_doctor_casts_rays_from_a_sensor_off_the_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    class Aside(Experiment):
        def __init__(self, config: RunConfig) -> None:
            super().__init__(config)
            ahead, _, up = self.vehicle.sensor.position
            aside = replace(self.vehicle.sensor, position=(ahead, 0.3, up))
            self.vehicle = replace(self.vehicle, sensor=aside)

    monkeypatch.setattr("nnql_bullet.experiment.Experiment", Aside)
    assert diagnosis.check_rays().ok


def test_what_a_shield_does_is_named(drive: Recording, tmp_path: Path) -> None:
    """Where the choice was the agent's own, the pictures are the same."""
    alone, overridden = tmp_path / "alone.npz", tmp_path / "overridden.npz"
    drive.save(alone)
    decided = np.arange(len(drive.action)) >= 4
    replace(drive, overridden=decided, action=np.where(decided, drive.action + STOP, drive.action)).save(overridden)
    one, other = (studio_of(Film(path, "chase", 640, 360, "raster")) for path in (alone, overridden))
    assert (one.frame(1.9) == other.frame(1.9)).all()
    rows, columns, _ = np.nonzero(one.frame(2.1) != other.frame(2.1))
    assert rows.min() > 200
    assert columns.max() < 160


def test_a_manoeuvre_beyond_the_five_turns_is_named_and_none_of_their_bars_is_marked(
    drive: Recording, tmp_path: Path
) -> None:
    asked = int(np.flatnonzero(np.isfinite(drive.q_values).all(axis=1))[0])
    marked, names = [], []
    for name, more in (("turn", 0), ("slow", SLOW)):
        replace(drive, action=drive.action + more).save(tmp_path / f"{name}.npz")
        picture = studio_of(Film(tmp_path / f"{name}.npz", "chase", 640, 360, "raster")).frame(
            drive.state_time[asked] + 0.2
        )
        marked.append(has(picture[220:345, 6:120], colours.NON_SAFE) > 10)
        names.append(picture[258:275, 6:120])
    assert marked == [True, False]
    assert (names[0] != names[1]).any()


# Films


@pytest.mark.parametrize(("speed", "count"), [(1.0, 91), (2.0, 46), (0.5, 181)])
def test_a_film_has_as_many_frames_as_time_and_speed_say(speed: float, count: int) -> None:
    times = frame_times(2.0, 5.0, 30.0, speed, hold=0.0)
    assert len(times) == count
    assert (times[0], times[-1]) == (2.0, pytest.approx(5.0))
    assert len(frame_times(2.0, 5.0, 30.0, speed, hold=1.5)) == count + 45


@pytest.mark.parametrize("executor", [ProcessExecutor(2), ThreadExecutor(3)], ids=["processes", "threads"])
def test_frames_are_the_same_by_any_number_of_workers(
    executor: Executor, drive_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film, times = Film(drive_file, "split", 160, 90, "raster"), frame_times(0.0, 3.0, 10.0, 1.0, hold=0.2)
    monkeypatch.setattr("nnql_bullet.render.film.PIECE", 4 * 160 * 90 * 3)
    alone = np.stack(list(frames(film, times, InlineExecutor())))
    shared = np.stack(list(frames(film, times, executor)))
    assert alone.shape == (33, 90, 160, 3)
    assert (alone == shared).all()
    assert (alone[-1] == alone[-2]).all()  # the ending stays
    assert (alone[0] != alone[10]).any()


def test_frames_that_cannot_be_drawn_are_told(tmp_path: Path) -> None:
    film = Film(tmp_path / "gone.npz", "chase", 160, 90, "raster")
    with pytest.raises(WorkFailed, match=r"frame 1: .*gone\.npz"):
        list(frames(film, [0.0], InlineExecutor()))


@pytest.fixture(scope="module")
def some_frames() -> list[NDArray[np.uint8]]:
    ramp = np.linspace(0, 255, 64).astype(np.uint8)
    return [np.stack([np.tile(ramp, (36, 1))] * 3, axis=2) // (1 + k) for k in range(12)]


def test_a_video_has_the_asked_size_rate_frames_and_codec(tmp_path: Path, some_frames: list[NDArray[np.uint8]]) -> None:
    path = tmp_path / "a.mp4"
    write_video(path, some_frames, (64, 36), 24.0, "mp4")
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    reader.close()
    assert (count, seconds) == (12, pytest.approx(0.5, abs=0.01))
    assert about["codec"] == "h264"
    assert about["pix_fmt"].startswith("yuv420p")
    assert (about["source_size"], about["fps"]) == ((64, 36), 24.0)
    assert path.read_bytes().find(b"moov") < path.read_bytes().find(b"mdat")  # plays while it is being loaded
    assert [child.name for child in tmp_path.iterdir()] == ["a.mp4"]


def test_the_same_frames_make_the_same_video(tmp_path: Path, some_frames: list[NDArray[np.uint8]]) -> None:
    for name in ("a.mp4", "b.mp4"):
        write_video(tmp_path / name, some_frames, (64, 36), 24.0, "mp4")
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_an_animation_holds_every_frame(tmp_path: Path, some_frames: list[NDArray[np.uint8]]) -> None:
    write_video(tmp_path / "a.gif", some_frames, (64, 36), 10.0, "gif")
    with Image.open(tmp_path / "a.gif") as animation:
        assert (animation.size, animation.n_frames) == ((64, 36), 12)
        animation.seek(3)
        assert np.abs(np.asarray(animation.convert("RGB")).astype(int) - some_frames[3]).mean() < 6


@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_what_is_interrupted_leaves_nothing_and_spares_what_was_there(
    kind: str, tmp_path: Path, some_frames: list[NDArray[np.uint8]]
) -> None:
    path = tmp_path / f"a.{kind}"
    path.write_bytes(b"old")

    def interrupted() -> Iterator[NDArray[np.uint8]]:
        yield from some_frames[:5]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(path, interrupted(), (64, 36), 24.0, kind)  # type: ignore[arg-type]
    assert [child.name for child in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == b"old"


def test_pictures_are_numbered_and_never_mixed_with_others(
    tmp_path: Path, some_frames: list[NDArray[np.uint8]]
) -> None:
    passed = list(write_pictures(tmp_path / "frames", some_frames))
    names = sorted(child.name for child in (tmp_path / "frames").iterdir())
    assert (len(passed), names[0], names[-1]) == (12, "frame_00001.png", "frame_00012.png")
    with Image.open(tmp_path / "frames" / "frame_00004.png") as picture:
        assert (np.asarray(picture) == some_frames[3]).all()
    with pytest.raises(UserError, match="holds frames already"):
        list(write_pictures(tmp_path / "frames", some_frames))


def test_a_sheet_shows_start_end_and_the_closest_passes(drive: Recording) -> None:
    timeline = Timeline(drive)
    moments = key_moments(timeline)
    times = [moment.time for moment in moments]
    assert (times[0], times[-1]) == (0.0, timeline.duration)
    assert np.diff(times).min() >= timeline.duration / 12
    closest = float(drive.clearance[:-2].min())
    assert any(f"{closest:.2f} m" in moment.caption or "collision" in moment.caption for moment in moments)
    pictures = [np.full((90, 160, 3), 40 * k, np.uint8) for k in range(len(moments))]
    sheet = contact_sheet(moments, pictures)
    for k in range(len(moments)):
        assert (sheet == 40 * k).all(axis=2).sum() >= 90 * 160 * 0.9


# The command


def test_render_leaves_a_whole_video(run_cli: Run, drive_file: Path, tmp_path: Path) -> None:
    options = "--size", "160x90", "--fps", "10", "--end", "2", "--renderer", "raster", "--workers", "1"
    code, out, err = run_cli("render", drive_file, *options, "--out", tmp_path / "a.mp4", "--sheet", tmp_path / "s.png")
    assert (code, out) == (0, f"video: {tmp_path / 'a.mp4'}\nsheet: {tmp_path / 's.png'}\n")
    assert "36/36" in err
    assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))[0] == 21 + 15
    assert sorted(child.name for child in tmp_path.iterdir()) == ["a.mp4", "s.png"]


def test_frames_alone_make_no_video(run_cli: Run, drive_file: Path, tmp_path: Path) -> None:
    options = "--size", "160x90", "--fps", "2", "--end", "1", "--renderer", "raster", "--workers", "1"
    before = set(drive_file.parent.iterdir())
    code, out, _ = run_cli("render", drive_file, *options, "--frames", tmp_path / "f")
    assert (code, out) == (0, f"frames: {tmp_path / 'f'}\n")
    assert len(list((tmp_path / "f").iterdir())) == 3 + 3
    assert set(drive_file.parent.iterdir()) == before


def test_a_policy_is_driven_first(
    run_cli: Run, tmp_path: Path, small_world: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    options = "--size", "64x64", "--fps", "1", "--speed", "10", "--renderer", "raster", "--workers", "1"
    code, out, _ = run_cli("render", "hand_rule", "--world", small_world, "--seed", 3, *options)
    folder = Path("runs/hand_rule/drives/small-3")
    assert (code, out) == (0, f"video: {folder / 'trajectory.mp4'}\n")
    driven = load_recording(folder / "trajectory.npz")
    assert (driven.world.seed, driven.about["policy"]) == (3, "hand_rule")


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--size", "161x90"], "size: give width and height as even numbers from 64 to 7680, not 161x90"),
        (["--size", "big"], "not 'big'"),
        (["--fps", "0"], "fps: must be between 1 and 240"),
        (["--speed", "-1"], "speed: must be above 0"),
        (["--workers", "0"], "workers must be at least 1"),
        (["--begin", "20"], "nothing is between"),
        (["--world", "paper"], "this is a recording"),
        (["--out", "a.avi"], "ends in .mp4 or .gif"),
        (["--out", "a.mp4", "--format", "gif"], "ends in .gif"),
        (["--camera", "drone"], "give one of: chase, orbit, split, top"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_one_line(
    options: list[str], line: str, run_cli: Run, drive_file: Path, snapshot: Callable[[Path], dict[str, bytes]]
) -> None:
    before = snapshot(drive_file.parent)
    code, out, err = run_cli("render", drive_file, *options)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert line in err
    assert snapshot(drive_file.parent) == before


def test_a_truncated_recording_is_refused_in_one_line(run_cli: Run, drive_file: Path, tmp_path: Path) -> None:
    half = tmp_path / "half.npz"
    half.write_bytes(drive_file.read_bytes()[: drive_file.stat().st_size // 2])
    code, out, err = run_cli("render", half, "--out", tmp_path / "a.mp4")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "not a whole recording" in err
    assert not (tmp_path / "a.mp4").exists()


def test_drive_leaves_a_video_when_asked(
    run_cli: Run, tmp_path: Path, small_world: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []
    monkeypatch.setattr("nnql_bullet.render.filming.render", lambda *paths, **more: drawn.append(paths))
    options = "--world", small_world, "--sim", "kinematic", "--video", "--json", "--out", tmp_path
    code, out, _ = run_cli("drive", "hand_rule", *options)
    assert (code, json.loads(out)["video"]) == (0, str(tmp_path / "trajectory.mp4"))
    assert drawn == [(tmp_path / "trajectory.npz", tmp_path / "trajectory.mp4")]


@pytest.mark.parametrize("verb", [("drive", "hand_rule", "--video"), ("render", "hand_rule")])
def test_a_missing_encoder_is_told_before_the_drive(
    run_cli: Run, tmp_path: Path, small_world: Path, monkeypatch: pytest.MonkeyPatch, verb: tuple[str, ...]
) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "nowhere"))
    monkeypatch.chdir(tmp_path)
    code, out, err = run_cli(*verb, "--world", small_world, "--out", tmp_path / "a.mp4")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"ffmpeg at {tmp_path / 'nowhere'} does not work" in err
    assert not list(tmp_path.rglob("trajectory.*"))


# The window

SHORT_WORLD = """\
width = 20.0
depth = 20.0
start = [4.0, 4.0]
target = [9.0, 9.0]

[layout]
kind = "boxes"
boxes = [{ x = 15.0, y = 6.0, length = 2.0, width = 1.0 }]
"""


def test_without_a_display_no_window_is_promised(run_cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    (tmp_path / "short.toml").write_text(SHORT_WORLD)
    code, out, err = run_cli("drive", "straight", "--world", tmp_path / "short.toml", "--gui", "--out", tmp_path)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "no window can be opened here" in err
    assert not (tmp_path / "trajectory.npz").exists()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="Xvfb is not installed (Debian: xvfb, xauth)")
def test_the_window_opens_where_there_is_a_display(tmp_path: Path) -> None:
    """Under a display that nobody sees."""
    (tmp_path / "short.toml").write_text(SHORT_WORLD)
    navigate = ["drive", "straight", "--world", "short.toml", "--gui", "--out", "out", "--json"]
    command = ["xvfb-run", "-a", "-s", "-screen 0 640x480x24", sys.executable, "-m", "nnql_bullet", *navigate]
    path = os.pathsep.join(sys.path)
    answer = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=120
    )
    assert (answer.returncode, answer.stderr) == (0, "")
    assert json.loads(answer.stdout)["ending"] == "goal"


def test_the_window_gives_every_part_of_the_vehicle_its_colour(vehicle: VehicleSpec) -> None:
    """A link for every visual shape, where it was: the picture is the same as of the robot as it is."""
    text = vehicle.urdf.read_text()
    split = _one_visual_per_link(text)
    camera = Camera((2.0, -1.5, 1.5), (0.3, 0.0, 0.1), radians(40), *SIZE, near=0.5, far=10.0)
    view, lens = camera.view.T.ravel().tolist(), camera.projection.T.ravel().tolist()
    pictures = []
    for urdf in (text, split):
        client = bullet.connect(bullet.DIRECT)
        with silenced():
            load_text(urdf, client, useFixedBase=True)
        tiny = bullet.getCameraImage(*SIZE, view, lens, renderer=bullet.ER_TINY_RENDERER, physicsClientId=client)
        pictures.append([np.asarray(part, np.float64) for part in tiny[2:4]])
        bullet.disconnect(client)
    assert (pictures[0][0] == pictures[1][0]).all()
    assert np.allclose(pictures[0][1], pictures[1][1], atol=1e-6)
    assert split.count("<link") == split.count("<visual") > 10


def test_the_window_looks_from_where_the_camera_is() -> None:
    """Yaw and pitch as PyBullet's own window understands them, against its view matrix."""
    eye, target = (3.0, -2.0, 2.5), (1.0, 0.5, 0.2)
    ahead = np.subtract(target, eye)
    distance = float(np.linalg.norm(ahead))
    yaw, pitch = np.degrees(atan2(ahead[1], ahead[0])) - 90.0, np.degrees(np.arcsin(ahead[2] / distance))
    by_angles = bullet.computeViewMatrixFromYawPitchRoll(target, distance, yaw, pitch, 0.0, 2)
    assert np.allclose(by_angles, bullet.computeViewMatrix(eye, target, (0, 0, 1)), atol=1e-5)
