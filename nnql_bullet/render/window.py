"""Shows a recording in PyBullet's window in real time."""

import time

from nnql_bullet.colours import COLLISION, FLOOR, unit_rgb
from nnql_bullet.errors import UserError
from nnql_bullet.recording import Recording
from nnql_bullet.render.camera import chase
from nnql_bullet.render.solids import BulletRenderer
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.sim.c_library import silenced
from nnql_bullet.sim.scene_trial import works

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
    if not works("window"):  # without a display, the engine ends the process
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
        world = recording.world
        self._renderer = BulletRenderer(recording, "window")
        self._scene = scene = self._renderer.scene
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
        self._renderer.show(moment)
        camera = self._camera(moment)
        self._scene.look(camera.eye, camera.target)

    def close(self) -> None:
        """Closes the window."""
        self._renderer.close()
