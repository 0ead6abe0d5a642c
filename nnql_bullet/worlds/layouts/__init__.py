"""Layouts: how obstacles are placed. Each is a module with its own options; `AnyLayout` tells them apart by `kind`."""

from typing import Annotated

from pydantic import Field

from nnql_bullet.worlds.layouts.aisles import Aisles
from nnql_bullet.worlds.layouts.base import Arena, Layout
from nnql_bullet.worlds.layouts.boxes import Boxes
from nnql_bullet.worlds.layouts.random_boxes import RandomBoxes
from nnql_bullet.worlds.layouts.traps import Traps

AnyLayout = Annotated[Aisles | Boxes | RandomBoxes | Traps, Field(discriminator="kind")]

__all__ = ["AnyLayout", "Arena", "Layout"]
