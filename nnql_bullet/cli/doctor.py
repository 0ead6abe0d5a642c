"""`nnql-bullet doctor`."""

import platform

from nnql_bullet.cli.console import say
from nnql_bullet.diagnosis import CHECKS


def doctor() -> int:
    """Check this machine: each line says ok, or what to do.

    Exits 1 if something that is needed fails.
    """
    say(f"ok    {'Python':<11} {platform.python_implementation()} {platform.python_version()}")
    failed = False
    for name, check in CHECKS.items():
        finding = check()
        failed |= finding.needed and not finding.ok
        mark = "ok   " if finding.ok else "FAIL " if finding.needed else "note "
        say(f"{mark} {name:<11} {finding.text}")
    return 1 if failed else 0
