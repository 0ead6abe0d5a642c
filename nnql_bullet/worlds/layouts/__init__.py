"""Layouts: how obstacles are drawn. Each is a module with its own options, registered here by name."""

from nnql_bullet.worlds.layouts import boxes, random_boxes
from nnql_bullet.worlds.layouts.base import Arena, Layout

LAYOUTS: dict[str, type[Layout]] = {
    "boxes": boxes.Boxes,
    "random_boxes": random_boxes.RandomBoxes,
}

__all__ = ["LAYOUTS", "Arena", "Layout"]
