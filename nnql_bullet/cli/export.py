"""`nnql-bullet export`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import export as api
from nnql_bullet.cli.console import say
from nnql_bullet.exports.folder import Form


def export(
    policy: Annotated[Path, tyro.conf.arg(metavar="POLICY")],
    /,
    to: Form,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Export a policy for another machine, as C99 or ONNX, with its contract and test vectors.

    Writes a folder: the artefact, what goes in and out of it (JSON schema and tables), what it decided in recorded
    drives, an example and a README. A policy that cannot be exported so is refused.

    For example:

        nnql-bullet export paper --to c --out paper-c
        nnql-bullet export runs/first --to onnx

    Args:
        policy: What `drive` takes: a run folder, a policy file, a shipped policy, a rule.
        to: C99 that needs no library but math.h, or a graph for ONNX Runtime.
        out: Folder to write, new or empty; default runs/export and the policy's name.
    """
    say(api.export(policy, to=to, out=out).text())
    return 0
