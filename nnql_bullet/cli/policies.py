"""`nnql-bullet policies`."""

from typing import Annotated

import tyro

from nnql_bullet import assets
from nnql_bullet.cli.console import say
from nnql_bullet.errors import UserError


def policies(
    name: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    /,
) -> int:
    """List the trained policies that are shipped, or show the card of one.

    A card says how the policy was trained, how good it is, and where its limits are. Their names stand where a run
    folder may: with `drive`, `evaluate`, `render` and `gap`.

    For example:

        nnql-bullet policies
        nnql-bullet policies double_dqn

    Args:
        name: Whose card to show; without it, all are listed.
    """
    shipped = assets.policies()
    if name is None:
        for path in shipped.values():
            title, _, _ = assets.card(path).read_text(encoding="utf-8").partition("\n")
            say(title.removeprefix("# "))
        return 0
    if name not in shipped:
        raise UserError(f"there is no shipped policy '{name}'; there are: {', '.join(shipped)}")
    say(assets.card(shipped[name]).read_text(encoding="utf-8").rstrip())
    return 0
