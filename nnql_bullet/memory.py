"""Whether this machine has the memory for what is asked of it, before anything is allocated."""

import os

from nnql_bullet.errors import UserError


def installed() -> int:
    """Memory of this machine [bytes]."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def refuse_beyond(needed: int, what: str, remedy: str) -> None:
    """Refuses what needs more memory than the machine has.

    Args:
        needed: Memory that it needs at least [bytes].
        what: Its name.
        remedy: What to do.

    Raises:
        UserError: If the machine has less.
    """
    if needed > installed():
        raise UserError(
            f"{what} needs at least {needed / 1e9:.1f} GB of memory, and this machine has {installed() / 1e9:.1f} GB; "
            f"{remedy}"
        )
