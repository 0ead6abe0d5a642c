"""The renderers of solid things by name."""

from typing import Literal

from nnql_bullet.errors import UserError
from nnql_bullet.recording import Recording
from nnql_bullet.render.solids import BulletRenderer, Renderer
from nnql_bullet.sim.bullet_scene import works

RendererName = Literal["tiny", "egl", "vtk"]


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
        raise UserError("VTK is not installed; install it with: pip install 'nnql-bullet[render]'") from None
    return VtkRenderer(recording)


def best_renderer() -> RendererName:
    """EGL where it works, else TinyRenderer."""
    return "egl" if works("egl") else "tiny"
