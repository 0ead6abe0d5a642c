"""The command line: one verb a module. The only place that prints, and that decides exit codes."""

import sys

from nnql_bullet.cli.console import UNSUPPORTED, complain, streams

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> int:
    """Runs one verb.

    Args:
        arguments: Of the command line, without the program's name.

    Returns:
        The exit code: 0 done, 1 a check or a piece of work failed, 2 bad input, 130 interrupted, 141 nobody
            reads what is printed.
    """
    if UNSUPPORTED:
        return complain(UNSUPPORTED)
    try:
        from nnql_bullet.cli.parser import run  # after the check: its imports need what other Pythons cannot install

        with streams():
            return run(sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt:
        complain("interrupted")
        return 130
