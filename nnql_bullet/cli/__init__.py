"""The command line: one verb a module. The only place that prints, and that decides exit codes."""

import signal
import sys

from nnql_bullet.cli.console import UNSUPPORTED, complain, streams
from nnql_bullet.cli.signals import handled, interrupt

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> int:
    """Runs one verb.

    Args:
        arguments: Of the command line, without the program's name.

    Returns:
        The exit code: 0 done, 1 a check or a piece of work failed, 2 bad input, 130 interrupted by Ctrl-C, SIGTERM or
            SIGHUP, 141 nobody reads what is printed.
    """
    if UNSUPPORTED:
        return complain(UNSUPPORTED)
    last = arguments is None
    with handled(interrupt, last):
        try:
            from nnql_bullet.cli.parser import run  # after the check: it imports what other Pythons cannot install

            with streams():
                return run(sys.argv[1:] if arguments is None else arguments)
        except KeyboardInterrupt:
            with handled(signal.SIG_IGN, last):
                complain("interrupted")
                return 130
