"""`nnql-bullet robot`."""

from json import dumps
from pathlib import Path
from shlex import quote
from typing import Annotated

import tyro

from nnql_bullet.cli.console import say
from nnql_bullet.errors import UserError
from nnql_bullet.vehicle.translation import read_robot


def robot(
    file: Annotated[Path, tyro.conf.arg(metavar="FILE.urdf|.xacro")],
    /,
    arg: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME:=VALUE ...")] = (),
    write: Annotated[Path | None, tyro.conf.arg(metavar="robot.toml")] = None,
    json: bool = False,
) -> int:
    """Read the URDF or xacro of a robot that drives by two wheels, and make it drive here.

    Finds the drive axle, the casters, the footprint and the centre of mass by the joints and shapes, wherever the
    frames are, and says what it assumed. A robot that would be driven wrongly is refused, with all that is wrong.

    For example:

        nnql-bullet robot turtlebot3_burger.urdf --write burger.toml
        nnql-bullet drive --robot burger.toml --world empty

    Args:
        file: The description as it is; meshes need not be there.
        arg: Arguments of a xacro in place of its own values, such as arm:=false.
        write: TOML to write; the URDF that it names, NAME.vehicle.urdf, is written beside it.
        json: Print one JSON object instead of text.
    """
    given = dict(one.partition(":=")[::2] for one in arg)
    if wrong := [one for one in arg if not one.partition(":=")[1]]:
        raise UserError(f"--arg: give NAME:=VALUE, not '{wrong[0]}'")
    found = read_robot(file, given)
    if write:
        toml, urdf = found.save(write)
    if json:
        say(dumps(found.record(), indent=1))
        return 0
    say(found.table())
    if write:
        say(f"written: {toml}, {urdf}; drive it with: nnql-bullet drive --robot {quote(str(toml))}")
    return 0
