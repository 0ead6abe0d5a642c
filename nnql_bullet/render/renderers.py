"""Makes the renderers of solid bodies by name."""

from importlib.util import find_spec
from typing import Literal

from nnql_bullet.errors import UserError
from nnql_bullet.recording import Recording
from nnql_bullet.render.solids import BulletRenderer, Renderer
from nnql_bullet.sim.scene_trial import NO_EGL, works

RendererName = Literal["tiny", "egl", "vtk"]

SMALL = 640 * 360
"""Number of pixels up to which TinyRenderer is as fast as EGL in software, and needs less memory."""
NO_VTK = "VTK is not installed; install it with: pip install 'nnql-bullet[render]'"


def make_renderer(recording: Recording, name: RendererName) -> Renderer:
    """Makes a renderer. VTK is imported only when it is needed.

    Raises:
        UserError: If the renderer does not work on this machine, or the recording has no shapes of the vehicle.
    """
    if name != "vtk":
        return BulletRenderer(recording, name)
    try:
        from nnql_bullet.render.vtk import VtkRenderer
    except ImportError:
        raise UserError(NO_VTK) from None
    return VtkRenderer(recording)


def check_renderer(name: Literal["auto"] | RendererName) -> None:
    """Checks that a renderer works on this machine.

    Raises:
        UserError: If it does not.
    """
    if name == "vtk" and find_spec("pyvista") is None:
        raise UserError(NO_VTK)
    if name == "egl" and not works("egl"):
        raise UserError(NO_EGL)


def best_renderer(width: int, height: int) -> RendererName:
    """Chooses EGL for pictures larger than `SMALL` if it works, else TinyRenderer; VTK where PyBullet is not installed.

    Args:
        width: Width of the pictures [pixels].
        height: Height of the pictures [pixels].
    """
    if find_spec("pybullet") is None:
        return "vtk"
    return "egl" if width * height > SMALL and works("egl") else "tiny"
