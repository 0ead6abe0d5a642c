"""Layouts place obstacles. Each layout is a module with an options class; the key `kind` selects one."""

from typing import Annotated

from pydantic import Field

from nnql_bullet.worlds.layouts.aisles import Aisles
from nnql_bullet.worlds.layouts.base import Arena, Layout
from nnql_bullet.worlds.layouts.boxes import Boxes
from nnql_bullet.worlds.layouts.cells import Cells
from nnql_bullet.worlds.layouts.poles import Poles
from nnql_bullet.worlds.layouts.random_boxes import RandomBoxes
from nnql_bullet.worlds.layouts.rooms import Rooms
from nnql_bullet.worlds.layouts.traps import Traps

AnyLayout = Annotated[Aisles | Boxes | Cells | Poles | RandomBoxes | Rooms | Traps, Field(discriminator="kind")]

__all__ = ["AnyLayout", "Arena", "Layout"]
