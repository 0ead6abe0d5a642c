"""`nnql-bullet keys`."""

import json
from typing import Annotated

import tyro

from nnql_bullet.cli.console import say
from nnql_bullet.config import Key, dotted, to_values
from nnql_bullet.config import keys as keys_of
from nnql_bullet.errors import UserError
from nnql_bullet.presets import load_config
from nnql_bullet.reports.tables import text_table
from nnql_bullet.run_config import RunConfig


def keys(
    table: Annotated[str, tyro.conf.arg(metavar="TABLE")] = "",
    /,
    config: Annotated[str, tyro.conf.arg(metavar="PRESET|FILE")] = "paper",
) -> int:
    """List the keys of a configuration: type, value and meaning.

    Each is a key of a TOML file and a flag of `nnql-bullet train`: agent.discount is --agent.discount there. Those that
    begin with agent, conditions, drive, shield or task are flags of `drive`, `evaluate`, `gap`, `ablate` and `render`
    too.

    For example:

        nnql-bullet keys
        nnql-bullet keys conditions
        nnql-bullet keys agent --config double_dqn

    Args:
        table: Only keys that begin like this: agent, conditions, drive, shield, task, training.
        config: Preset or TOML file whose values are shown.
    """
    resolved = load_config(config, {})
    kind = resolved.agent.kind
    values = {name: json.dumps(value) for name, value in dotted(to_values(resolved)).items()}
    shown = [key for key in keys_of(RunConfig) if key.kind in ("", kind) and key.name.startswith(table)]
    if not shown:
        raise UserError(f"no key begins with '{table}'")
    rows = [(key.name, key.type_text, values.get(key.name, _value(key)), key.about) for key in shown]
    say(text_table(("key", "type", config, "meaning"), rows))
    return 0


def _value(key: Key) -> str:
    """The default of a key that is not set."""
    return "-" if key.default is None else f"({json.dumps(key.default)})"
