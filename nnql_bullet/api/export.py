"""`export`: a policy for another machine."""

from pathlib import Path

from nnql_bullet.arguments import checked
from nnql_bullet.exports.folder import Export, Form, write_export
from nnql_bullet.runs import PolicyLike, load_policy


@checked
def export(policy: PolicyLike, *, to: Form, with_shield: bool = False, out: Path | str | None = None) -> Export:
    """Exports a policy into a folder: artefact, observation contract, test vectors, example and README.

    Example:
        >>> import nnql_bullet as nb
        >>> exported = nb.export("paper", to="c", out="paper-c")
        >>> sorted(exported.files)[-2:]
        ['policy.h', 'vectors.csv']

    Args:
        policy: A run folder, a policy file, the name of a shipped policy or of a rule, or what `load_policy` returned.
        to: "c" is C99 that needs no library but math.h; "onnx" is a graph for ONNX Runtime; "st" is Structured Text of
            IEC 61131-3, plain and as PLCopen XML.
        with_shield: Whether the policy is exported in its shield, or in the usual one if it has none; to C and
            Structured Text. It does all that the shield does but lead the vehicle.
        out: Folder to write, which must be new or empty; by default runs/export/ and the policy's name.

    Raises:
        UserError: If the policy cannot be exported so, the folder has files in it, or a library is missing.
    """
    loaded = load_policy(policy)
    folder = Path(out) if out is not None else default_folder(loaded.name, to)
    return write_export(loaded, to, folder, with_shield)


def default_folder(name: str, to: Form) -> Path:
    """Where a policy is exported to unless told otherwise."""
    return Path("runs") / "export" / f"{Path(name).stem}-{to}"
