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


def check_window() -> None:
    """Checks that a window can open on this machine.

    Raises:
        UserError: If none can.
    """
    if not works("window"):  # without a display, the engine ends the process
        raise UserError("no window can be opened here; leave out --gui (--video leaves a film), or set DISPLAY")


def watch(recording: Recording) -> None:
    """Shows a recording until it ends or the window is closed.

    Raises:
        UserError: If no window can open on this machine, or the recording has no shapes of the vehicle.
    """
    check_window()
    with silenced():  # PyBullet's threads print messages while the window is open
        _show(recording)


def _show(recording: Recording) -> None:
    timeline, world = Timeline(recording), recording.world
    renderer = BulletRenderer(recording, "window")
    scene, follow = renderer.scene, chase(timeline, 1, 1)
    ground = scene.add_box((world.width / 2, world.depth / 2, THICK), unit_rgb(FLOOR))
    scene.place(ground, world.width / 2, world.depth / 2, -THICK, 0.0)
    target = scene.add_disc(world.target_radius, THICK, unit_rgb(COLLISION))
    scene.place(target, *world.target, 0.0, 0.0)
    scene.show(True)
    begin = time.monotonic()
    try:
        while scene.is_open and (now := time.monotonic() - begin) < timeline.duration + LINGER:
            moment = timeline.at(now)
            renderer.show(moment)
            camera = follow(moment)
            scene.look(camera.eye, camera.target)
            time.sleep(1 / RATE)
    finally:
        renderer.close()
