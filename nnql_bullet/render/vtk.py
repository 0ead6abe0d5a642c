"""Draws solid bodies with VTK, for pictures in papers (needs the extra `render`).

Curved surfaces are smooth, and `light.py` gives soft shadows and darker corners.
"""

from typing import Any

import numpy as np
import pyvista
from numpy.typing import NDArray
from vtkmodules.vtkCommonCore import vtkFloatArray, vtkLogger, vtkUnsignedCharArray

from nnql_bullet.geometry import Circle, OrientedBox
from nnql_bullet.machine import one_thread_for_mesa
from nnql_bullet.recording import Recording
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.light import SAMPLES, light_in_pixels, placed_parts, standing_boxes, with_movers
from nnql_bullet.render.shading import eye_of
from nnql_bullet.render.solids import BOX, MOVING, WALL, Solids
from nnql_bullet.render.timeline import Moment
from nnql_bullet.vehicle.visuals import Colour, Shape, Visuals, upright

FACETS = 96
"""Number of facets around a cylinder or sphere."""


class VtkRenderer:
    """Draws with VTK without a window."""

    lights = True
    samples = SAMPLES

    def __init__(self, recording: Recording) -> None:
        """Builds the scene.

        Args:
            recording: Recording of the drive.

        Raises:
            UserError: If the recording has no shapes of the vehicle.
        """
        self._visuals = Visuals(recording.about["vehicle"])
        world = recording.world
        self._height = world.obstacle_height
        self._boxes = standing_boxes(world)
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)  # VTK reports each display that it tries
        self._plotter = pyvista.Plotter(off_screen=True, lighting="none")
        self._plotter.disable_anti_aliasing()  # a pixel has one depth
        for solids, colour in ((world.obstacles, BOX), (world.walls, WALL)):
            for its in solids:
                if isinstance(its, Circle):
                    pole = self._add(_cylinder(its.radius, self._height / 2), colour)
                    pole.user_matrix = upright(its.x, its.y, self._height / 2, 0.0)
                else:
                    self._add_box(its, colour)
        self._movers = [self._add_box(patrol.box, MOVING) for patrol in world.patrols]
        self._parts = [self._add(_mesh(shape), shape.colour) for shape in self._visuals.shapes]

    def draw(self, moment: Moment, camera: Camera) -> Solids:
        """Draws the camera's picture at a moment."""
        frames = self._visuals.frames(moment.pose, moment.joint_angles, moment.tilt)
        for part, frame in zip(self._parts, frames, strict=True):
            part.user_matrix = frame
        for mover, box in zip(self._movers, moment.movers, strict=True):
            mover.user_matrix = upright(box.x, box.y, self._height / 2, box.yaw)
        colours, depths = self._picture(camera)
        boxes, parts = with_movers(self._boxes, moment.movers), placed_parts(self._visuals.shapes, frames)
        light = light_in_pixels(depths, eye_of(camera), boxes, parts)
        return Solids(colours, depths, light)

    def close(self) -> None:
        """Frees the resources of VTK."""
        self._plotter.close()

    def _picture(self, camera: Camera) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draws colours (h, w, 3) and OpenGL's depths (h, w)."""
        view = self._plotter.camera
        view.position, view.focal_point, view.up = camera.eye, camera.target, camera.axes[1]
        view.view_angle = np.degrees(camera.field_of_view)
        view.clipping_range = camera.near, camera.far
        self._plotter.window_size = camera.width, camera.height
        window = self._plotter.render_window
        with one_thread_for_mesa():
            window.Render()
        colours, depths = vtkUnsignedCharArray(), vtkFloatArray()
        last = camera.width - 1, camera.height - 1
        window.GetPixelData(0, 0, *last, False, colours, 0)
        window.GetZbufferData(0, 0, *last, depths)
        shape = camera.height, camera.width  # from the lower left corner up
        return (
            np.ascontiguousarray(pyvista.convert_array(colours).reshape(*shape, 3)[::-1]),
            np.ascontiguousarray(pyvista.convert_array(depths).reshape(shape)[::-1]),
        )

    def _add_box(self, box: OrientedBox, colour: Colour) -> Any:
        actor = self._add(_cuboid(box.half_length, box.half_width, self._height / 2), colour)
        actor.user_matrix = upright(box.x, box.y, self._height / 2, box.yaw)
        return actor

    def _add(self, mesh: Any, colour: Colour) -> Any:
        return self._plotter.add_mesh(mesh, color=colour, lighting=False)


def _mesh(shape: Shape) -> Any:
    x, y, z = shape.half_sizes
    if shape.kind == "box":
        return _cuboid(x, y, z)
    if shape.kind == "cylinder":
        return _cylinder(x, z)
    if shape.kind == "mesh":
        corners = shape.triangles.reshape(-1, 3)
        return pyvista.PolyData.from_regular_faces(corners, np.arange(len(corners)).reshape(-1, 3))
    return pyvista.Sphere(radius=x, theta_resolution=FACETS, phi_resolution=FACETS // 2)


def _cylinder(radius: float, half_height: float) -> Any:
    """Makes an upright cylinder around the origin [m]."""
    return pyvista.Cylinder(direction=(0, 0, 1), radius=radius, height=2 * half_height, resolution=FACETS)


def _cuboid(x: float, y: float, z: float) -> Any:
    """Makes a box around the origin with half sizes [m]."""
    return pyvista.Cube(x_length=2 * x, y_length=2 * y, z_length=2 * z)
