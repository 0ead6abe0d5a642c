"""`nnql-bullet report`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import say
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.policies import Policy, open_policies
from nnql_bullet.files import write_text
from nnql_bullet.reports import html
from nnql_bullet.reports.html import Results, Verb, open_results
from nnql_bullet.runs import REPORT, load_run
from nnql_bullet.text import shell_line


def report(
    runs: Annotated[list[Path], tyro.conf.arg(metavar="RUN ...")],
    /,
    evaluation: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    gap: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> int:
    """Put all that is known of some runs into one HTML file, which needs no network.

    It shows what was trained and where that departs from the preset `paper`, versions, how learning went, what
    `evaluate` and `gap` found, the failed drives that `failures` sorted, to be played, and the commands that make
    everything again. What is missing is said, with the command that makes it. The same inputs give the same bytes.

    For example:

        nnql-bullet report runs/paper-0
        nnql-bullet report runs/paper-0 runs/paper-1 --evaluation runs/evaluate-test --out paper.html

    Args:
        runs: Run folders.
        evaluation: What `evaluate` left; default runs/evaluate, if one of the runs drives in it.
        gap: What `gap` left; default runs/gap, if one of the runs drives in it.
        out: The file; default report.html in the run's folder, or runs/report.html for several runs.
    """
    path = out or (runs[0] if len(runs) == 1 else Path("runs")) / REPORT
    if path.is_dir():
        raise UserError(f"{path}: is a folder; give --out the name of a file")
    opened = [load_run(folder) for folder in runs]
    policies = open_policies(runs)
    evaluated = _results("evaluate", evaluation, policies)
    measured = _results("gap", gap, policies)
    given = {"--evaluation": evaluation, "--gap": gap, "--out": out}
    flags = [part for flag, value in given.items() if value for part in (flag, str(value))]
    again = shell_line("nnql-bullet", "report", *map(str, runs), *flags)
    page = html.page(opened, policies, evaluated, measured, again)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page)
    say(f"report: {path}")
    return 0


def _results(verb: Verb, given: Path | None, policies: list[Policy]) -> Results | None:
    """What a verb left in a folder, or in the one that it writes to by default.

    Raises:
        UserError: If there is nothing of these policies in a folder that was given, or what is there is damaged.
    """
    found = open_results(verb, given or Path("runs") / verb, policies)
    if given and not found:
        command = shell_line("nnql-bullet", verb, *(policy.path for policy in policies), "--out", str(given))
        raise UserError(f"{given}: holds no results of '{verb}' with one of these runs as it is now; try: {command}")
    return found
