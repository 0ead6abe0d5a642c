"""Makes the renderers of solid bodies by name."""

from importlib.util import find_spec
from typing import Literal

from nnql_bullet.errors import UserError
from nnql_bullet.recording import Recording
from nnql_bullet.render.raster import RasterRenderer
from nnql_bullet.render.solids import Renderer

RendererName = Literal["raster", "vtk"]

NO_VTK = "VTK is not installed; install it with: pip install 'nnql-bullet[render]'"


def make_renderer(recording: Recording, name: RendererName) -> Renderer:
    """Makes a renderer. VTK is imported only when it is needed.

    Raises:
        UserError: If the renderer is not installed, or the recording has no shapes of the vehicle.
    """
    if name == "raster":
        return RasterRenderer(recording)
    try:
        from nnql_bullet.render.vtk import VtkRenderer
    except ImportError:
        raise UserError(NO_VTK) from None
    return VtkRenderer(recording)


def check_renderer(name: RendererName) -> None:
    """Checks that a renderer is installed.

    Raises:
        UserError: If it is not.
    """
    if name == "vtk" and find_spec("pyvista") is None:
        raise UserError(NO_VTK)
