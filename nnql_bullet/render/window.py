"""Shows a recording in PyBullet's window in real time."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

from nnql_bullet.colours import COLLISION, FLOOR, Colour, unit_rgb
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Circle, OrientedBox
from nnql_bullet.recording import Recording
from nnql_bullet.render.camera import chase
from nnql_bullet.render.solids import BOX, MOVING, WALL
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.sim.c_library import silenced
from nnql_bullet.sim.scene_trial import a_window_opens
from nnql_bullet.vehicle.visuals import recorded_urdf

RATE = 60.0
"""Frame rate [Hz]."""
LINGER = 3.0
"""Time for which the window shows the ending [s]."""
THICK = 0.02
"""Half the height of the ground and of the target's disc [m]."""


def check_window(otherwise: str = "leave out --gui (--video leaves a film)") -> None:
    """Checks that a window can open on this machine.

    Args:
        otherwise: What to do without one.

    Raises:
        UserError: If none can.
    """
    if not a_window_opens():  # without a display, the engine ends the process
        raise UserError(f"no window can be opened here; {otherwise}, or set DISPLAY")


def watch(recording: Recording) -> None:
    """Shows a recording until it ends or the window is closed.

    Raises:
        UserError: If no window can open on this machine, or the recording has no shapes of the vehicle.
    """
    check_window()
    with silenced():  # PyBullet's threads print messages while the window is open
        _show(recording)


def _show(recording: Recording) -> None:
    window, duration = Window(recording), Timeline(recording).duration
    begin = time.monotonic()
    try:
        while window.is_open and (now := time.monotonic() - begin) < duration + LINGER:
            window.show(now)
            time.sleep(1 / RATE)
    finally:
        window.close()


class Window:
    """PyBullet's window with one episode in it."""

    def __init__(self, recording: Recording) -> None:
        """Opens the window, which `check_window` has tried."""
        from nnql_bullet.sim.bullet_scene import BulletScene  # here because pictures need no PyBullet

        world, vehicle = recording.world, recording.about["vehicle"]
        self._height, self._axle_height = world.obstacle_height, vehicle["wheel_radius"]
        with TemporaryDirectory(prefix="nnql-bullet-") as folder:
            urdf = recorded_urdf(vehicle, Path(folder))
            self._scene = scene = BulletScene()
            for its in world.obstacles:
                self._add(its, BOX)
            for wall in world.walls:
                self._add(wall, WALL)
            self._movers = [self._add(patrol.box, MOVING) for patrol in world.patrols]
            self._vehicle, joints = scene.add_robot(urdf)
        self._joints = [joints[name] for name in vehicle["joints"].values()]
        ground = scene.add_box((world.width / 2, world.depth / 2, THICK), unit_rgb(FLOOR))
        scene.place(ground, world.width / 2, world.depth / 2, -THICK, 0.0)
        target = scene.add_disc(world.target_radius, THICK, unit_rgb(COLLISION))
        scene.place(target, *world.target, 0.0, 0.0)
        scene.show(True)
        self.follow(recording)

    @property
    def is_open(self) -> bool:
        """Whether nobody has closed it."""
        return self._scene.is_open

    def follow(self, recording: Recording) -> None:
        """Takes up a later recording of the episode, as it has gone on."""
        self._timeline = Timeline(recording)
        self._camera = chase(self._timeline, 1, 1)

    def show(self, time: float) -> None:
        """Shows the episode at a time [s]."""
        moment = self._timeline.at(time)
        pose, (rise, roll, pitch) = moment.pose, moment.tilt
        self._scene.place(self._vehicle, pose.x, pose.y, self._axle_height + rise, pose.yaw, roll, pitch)
        for joint, angle in zip(self._joints, moment.joint_angles, strict=True):
            self._scene.turn(self._vehicle, joint, angle)
        for body, box in zip(self._movers, moment.movers, strict=True):
            self._scene.place(body, box.x, box.y, self._height / 2, box.yaw)
        camera = self._camera(moment)
        self._scene.look(camera.eye, camera.target)

    def close(self) -> None:
        """Closes the window."""
        self._scene.close()

    def _add(self, its: OrientedBox | Circle, colour: Colour) -> int:
        if isinstance(its, Circle):
            body, yaw = self._scene.add_disc(its.radius, self._height / 2, colour), 0.0
        else:
            body = self._scene.add_box((its.half_length, its.half_width, self._height / 2), colour)
            yaw = its.yaw
        self._scene.place(body, its.x, its.y, self._height / 2, yaw)
        return body
