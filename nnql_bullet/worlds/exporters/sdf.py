"""Writes SDF, which Gazebo loads."""

from pathlib import Path
from xml.sax.saxutils import quoteattr

from nnql_bullet.files import write_text
from nnql_bullet.geometry import Circle, OrientedBox, Pose, Shape, moved, placed
from nnql_bullet.worlds.spec import WorldSpec

_HEAD = """\
<?xml version="1.0"?>
<sdf version="1.6">
  <world name={name}>
    <light name="sun" type="directional">
      <pose>0 0 10 0 0 0</pose>
      <direction>-0.5 0.5 -1</direction>
    </light>
    <model name="ground_plane">
      <static>1</static>
      <link name="link">
        <collision name="collision">
          <geometry><plane><normal>0 0 1</normal><size>{side:g} {side:g}</size></plane></geometry>
        </collision>
        <visual name="visual">
          <geometry><plane><normal>0 0 1</normal><size>{side:g} {side:g}</size></plane></geometry>
        </visual>
      </link>
    </model>
"""
_MODEL = """\
    <model name="{name}">
      <static>1</static>
      <pose>{pose}</pose>
      <link name="link">
        <collision name="collision"><geometry>{shape}</geometry></collision>
        <visual name="visual"><geometry>{shape}</geometry></visual>
      </link>
    </model>
"""
_TAIL = """\
  </world>
</sdf>
"""


def write_sdf(world: WorldSpec, frame: Pose, path: Path) -> list[Path]:
    """Writes a world: a model for each obstacle, and four for the walls."""
    named = [(f"obstacle_{number}", shape) for number, shape in enumerate(world.obstacles)]
    named += [(f"wall_{number}", wall) for number, wall in enumerate(world.walls)]
    side = 2 * (abs(frame.x) + abs(frame.y) + world.width + world.depth)
    models = [_model(name, shape, frame, world.obstacle_height) for name, shape in named]
    write_text(path, "".join([_HEAD.format(name=quoteattr(world.name), side=side), *models, _TAIL]))
    return [path]


def _model(name: str, shape: Shape, frame: Pose, height: float) -> str:
    if isinstance(shape, Circle):
        (x, y), yaw = placed(frame, shape.x, shape.y), 0.0
        size = f"<cylinder><radius>{shape.radius!r}</radius><length>{height!r}</length></cylinder>"
    else:
        its: OrientedBox = moved(shape, frame)
        x, y, yaw = its.x, its.y, its.yaw
        size = f"<box><size>{2 * its.half_length!r} {2 * its.half_width!r} {height!r}</size></box>"
    pose = " ".join(repr(round(value, 9) + 0.0) for value in (x, y, height / 2, 0.0, 0.0, yaw))
    return _MODEL.format(name=name, pose=pose, shape=size)
