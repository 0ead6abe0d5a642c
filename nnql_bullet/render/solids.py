"""Pictures of the solid bodies of a recording (boxes, walls, the vehicle), without the ground."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.colours import SOLID_BOX, SOLID_MOVING, SOLID_WALL, Colour, unit_rgb
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.timeline import Moment

BOX: Colour = unit_rgb(SOLID_BOX)
WALL: Colour = unit_rgb(SOLID_WALL)
MOVING: Colour = unit_rgb(SOLID_MOVING)


@dataclass(frozen=True, slots=True)
class Solids:
    """Picture of the solid bodies that a camera sees."""

    colours: NDArray[np.uint8]
    """Their own colours (height, width, 3)."""
    depths: NDArray[np.float32]
    """OpenGL's depths (height, width); 1 in empty pixels."""
    light: NDArray[np.float32]
    """Light on the surface or ground in each pixel, over that on open ground (height, width)."""


class Renderer(Protocol):
    """Draws solid bodies."""

    lights: bool
    """Whether its light has the shadows on the ground."""
    samples: int
    """Number of pixels that it draws for each pixel of the picture, along each side."""

    def draw(self, moment: Moment, camera: Camera) -> Solids:
        """Draws the camera's picture at a moment."""

    def close(self) -> None:
        """Frees its resources."""
