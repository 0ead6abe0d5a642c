"""The renderers of solid things by name."""

from importlib.util import find_spec
from typing import Literal

from nnql_bullet.errors import UserError
from nnql_bullet.recording import Recording
from nnql_bullet.render.solids import BulletRenderer, Renderer
from nnql_bullet.sim.bullet_scene import NO_EGL, works
from nnql_bullet.vehicle.visuals import Visuals

RendererName = Literal["tiny", "egl", "vtk"]

SMALL = 640 * 360
"""Pixels of a picture up to which films by TinyRenderer take no longer than by EGL in software, and a third of its
memory: 45 and 41 frames a second, 535 and 1146 MB, both on 2 cores without a graphics card."""
NO_VTK = "VTK is not installed; install it with: pip install 'nnql-bullet[render]'"


def make_renderer(recording: Recording, name: RendererName) -> Renderer:
    """The renderer of a name. VTK is imported when it is asked for.

    Raises:
        UserError: If it does not work here, or the recording does not say what the vehicle looks like.
    """
    if name != "vtk":
        return BulletRenderer(recording, name)
    try:
        from nnql_bullet.render.vtk import VtkRenderer
    except ImportError:
        raise UserError(NO_VTK) from None
    return VtkRenderer(recording)


def check_renderer(recording: Recording, name: RendererName) -> None:
    """Sees to it that what a renderer lacks shows before it is needed.

    Raises:
        UserError: If it does not work here, or the recording does not say what the vehicle looks like.
    """
    Visuals(recording.about["vehicle"])
    if name == "vtk" and find_spec("pyvista") is None:
        raise UserError(NO_VTK)
    if name == "egl" and not works("egl"):
        raise UserError(NO_EGL)


def best_renderer(width: int, height: int) -> RendererName:
    """EGL where it works, else TinyRenderer; that too for pictures up to `SMALL`.

    Args:
        width: Of the pictures [pixels].
        height: Likewise.
    """
    return "egl" if width * height > SMALL and works("egl") else "tiny"
