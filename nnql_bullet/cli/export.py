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
    with_shield: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Export a policy for another machine, as C99, ONNX or Structured Text, with its contract and test vectors.

    Writes a folder: the artefact, what goes in and out of it (JSON schema and tables), what it decided in recorded
    drives, an example and a README. A policy that cannot be exported so is refused.

    For example:

        nnql-bullet export paper --to c --out paper-c
        nnql-bullet export runs/first --to onnx
        nnql-bullet export paper --to st --with-shield

    Args:
        policy: What `drive` takes: a run folder, a policy file, a shipped policy, a rule.
        to: C99 that needs no library but math.h, a graph for ONNX Runtime, or Structured Text of IEC 61131-3.
        with_shield: Export it in its shield, or in the usual one, to C or Structured Text.
        out: Folder to write, new or empty; default runs/export and the policy's name.
    """
    say(api.export(policy, to=to, with_shield=with_shield, out=out).text())
    return 0
