"""Films by the whole command, also against PyBullet's bare `getCameraImage` of about the same scene in one process.

The bare loop draws a floor, 40 boxes and the vehicle with TinyRenderer, from the same cameras; the film has its ground,
light and overlay besides, and is encoded. Opening the recording counts.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from nnql_bullet.executors import ProcessExecutor
from nnql_bullet.experiment import Experiment
from nnql_bullet.recording import Recorder, load_recording
from nnql_bullet.render.camera import chase
from nnql_bullet.render.film import frame_times
from nnql_bullet.render.filming import FPS, SIZE, render
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.rollout import run_episode
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sim.bullet import bullet as pybullet
from nnql_bullet.sim.bullet import load_text
from nnql_bullet.sim.c_library import silenced
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.visuals import recorded_urdf

SMALL = 640, 360
BARE_FRAMES, WARM = 60, 5


@dataclass(frozen=True)
class BareTask:
    """The bare loop."""

    recording: Path
    seed: int = 0


def film_over_bare(seconds: float) -> float:
    """A film's frames a second over the bare loop's.

    Args:
        seconds: Length of the film [s].
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drive.npz"
        _record(path)
        before, film = _bare(path), _film(path, SMALL, seconds)
        return film / ((before + _bare(path)) / 2)


def film_frames_per_second(seconds: float) -> float:
    """A film's frames a second at the default size; its length is given [s]."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drive.npz"
        _record(path)
        return _film(path, SIZE, seconds)


def _record(path: Path) -> None:
    experiment = Experiment(RunConfig(simulator="kinematic", world="cover_10"))
    recorder = Recorder(experiment.vehicle)
    world = max((experiment.world(seed) for seed in range(6)), key=lambda world: len(world.obstacles))
    run_episode(experiment.navigation, world, experiment.agent, watcher=recorder)
    recorder.recording(policy="untrained", simulator="kinematic").save(path)


def _film(path: Path, size: tuple[int, int], seconds: float) -> float:
    """Frames a second."""
    duration = Timeline(load_recording(path)).duration
    speed = duration / seconds
    begin = time.perf_counter()
    render(path, path.with_suffix(".mp4"), size=size, speed=speed, hold=0.0, workers=None)
    return len(frame_times(0.0, duration, FPS, speed, hold=0.0)) / (time.perf_counter() - begin)


def _bare(path: Path) -> float:
    """Frames a second."""
    (outcome,) = ProcessExecutor(1).map(_draw_bare, [BareTask(path)])
    if outcome.value is None:
        raise RuntimeError(outcome.error)
    return outcome.value


def _draw_bare(task: BareTask) -> float:
    recording = load_recording(task.recording)
    timeline, world, vehicle = Timeline(recording), recording.world, recording.about["vehicle"]
    client = pybullet.connect(pybullet.DIRECT)
    _add_box(client, (world.width / 2, world.depth / 2, 0.05), (world.width / 2, world.depth / 2, -0.05), 0.0)
    for box in (*recording.obstacles, *world.walls):
        half_sizes = box.half_length, box.half_width, world.obstacle_height / 2
        _add_box(client, half_sizes, (box.x, box.y, world.obstacle_height / 2), box.yaw)
    with silenced():
        body = load_text(recorded_urdf(vehicle), client, useFixedBase=True)
    follow = chase(timeline, *SMALL)
    begin = 0.0
    for frame in range(BARE_FRAMES + WARM):
        if frame == WARM:
            begin = time.perf_counter()
        moment = timeline.at(frame / 30)
        camera, pose = follow(moment), moment.pose
        turned = pybullet.getQuaternionFromEuler((0.0, 0.0, pose.yaw))
        pybullet.resetBasePositionAndOrientation(body, (pose.x, pose.y, vehicle["wheel_radius"]), turned, client)
        view, lens = camera.view.T.ravel().tolist(), camera.projection.T.ravel().tolist()
        with silenced():
            tiny = pybullet.ER_TINY_RENDERER
            pybullet.getCameraImage(*SMALL, view, lens, shadow=0, renderer=tiny, physicsClientId=client)
    return BARE_FRAMES / (time.perf_counter() - begin)


def _add_box(client: int, half_sizes: Vector, place: Vector, yaw: float) -> None:
    shape = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=half_sizes, physicsClientId=client)
    turned = pybullet.getQuaternionFromEuler((0.0, 0.0, yaw))
    pybullet.createMultiBody(0.0, -1, shape, -1, place, turned, physicsClientId=client)
