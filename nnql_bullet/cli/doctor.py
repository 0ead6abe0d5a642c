"""`nnql-bullet doctor`."""

from nnql_bullet.cli.console import err, out, say
from nnql_bullet.diagnosis import CHECKS, Finding, examined


def doctor() -> int:
    """Check this machine: each line says ok, or what to do.

    Exits 1 if something that is needed fails.
    """
    failed = False
    for name, check in {"terminal": _check_terminal, **CHECKS}.items():
        finding = examined(check)
        failed |= finding.needed and not finding.ok
        mark = "ok   " if finding.ok else "FAIL " if finding.needed else "note "
        say(f"{mark} {name:<11} {finding.text}")
    return 1 if failed else 0


def _check_terminal() -> Finding:
    """Checks that what is printed can have any characters."""
    text = f"output in {out.encoding}, errors in {err.encoding}"
    well = {out.encoding, err.encoding} == {"utf-8"}
    return Finding(well, text if well else f"{text}; other characters are shown as \\x...", needed=False)
