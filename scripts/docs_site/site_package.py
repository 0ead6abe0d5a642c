"""Reads the package for the site: its options, its command line, its modules and its shipped policies.

Nothing is named here that the package can be asked for, so that a renamed key, verb or module needs no change here.
"""

import ast
import inspect
import io
import os
import re
import textwrap
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import MISSING, is_dataclass
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "nnql_bullet"
WIDTH = 240
"""Columns that the command line's help is laid out in, so that few lines are broken."""


def find(*names: str) -> Any:
    """The class or function of the first of these names that some module of the package defines.

    Raises:
        LookupError: If no module defines one.
    """
    for name in names:
        for path in sorted(PACKAGE.rglob("*.py")):
            if re.search(rf"^(class|def) {name}\b", path.read_text(encoding="utf-8"), re.MULTILINE):
                return getattr(import_module(module_name(path)), name)
    raise LookupError(f"nnql_bullet defines none of: {', '.join(names)}")


def module_name(path: Path) -> str:
    """The dotted name of a module file of the package."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


# Options ------------------------------------------------------------------------------------------------------------


def configuration() -> str:
    """Markdown tables of every key of a run's configuration."""
    return _options_section(find("RunConfig"), "", 2)


def world_keys() -> str:
    """Markdown tables of every key of a world file."""
    return _options_section(find("World", "WorldFile"), "", 3)


def robot_keys() -> str:
    """Markdown tables of every key of a robot file."""
    return _options_section(find("RobotFile"), "", 3)


def presets() -> str:
    """A Markdown table of the keys that each preset sets differently from the defaults."""
    run_config, load_config, to_values = find("RunConfig"), find("load_config"), find("to_values")
    defaults = dict(_flat(to_values(run_config())))
    rows = []
    for name in _preset_names():
        values = dict(_flat(to_values(load_config(name, {}))))
        same_agent = values.get("agent.kind") == defaults.get("agent.kind")
        changed = {
            key: value
            for key, value in values.items()
            if defaults.get(key) != value and (same_agent or not key.startswith("agent.") or key == "agent.kind")
        }
        if set(changed) != {"agent.kind"}:  # every kind of agent is a preset, all else being equal
            text = "<br>".join(f"`{key} = {_toml(value)}`" for key, value in changed.items())
            rows.append((f"`{name}`", text or "nothing: these are the defaults"))
    return _table(("preset", "keys that differ from the defaults"), rows)


def _preset_names() -> list[str]:
    try:
        return list(import_module("nnql_bullet.presets").PRESETS)
    except (ModuleNotFoundError, AttributeError):
        return list(import_module("nnql_bullet.experiment").PRESETS)


def _flat(values: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _options_section(cls: type, prefix: str, level: int, kind: str | None = None) -> str:
    """The keys of one options class, then those of the classes inside it, each under a heading of its own."""
    docs, fields = field_docs(cls), cls.__pydantic_fields__  # type: ignore[attr-defined]
    rows, below = [], []
    for name, field in fields.items():
        classes = _classes_in(field.annotation)
        key = f"{prefix}{name}"
        if classes:
            below += [(inner, key, len(classes) > 1) for inner in classes]
        type_text, meaning = _type_text(field.annotation, field.metadata), _sentence(docs.get(name, ""))
        if len(classes) > 1:
            kinds = ", ".join(f"`{_kind_of(inner)}`" for inner in classes)
            meaning = f"{meaning} Kinds: {kinds}.".strip()
        rows.append((f"`{name}`", type_text, _default_text(field), meaning))
    parts = []
    if prefix:
        table = prefix.removesuffix(".")
        title = f"`[{table}]`" + (f' with `kind = "{kind}"`' if kind else "")
        anchor = re.sub(r"[^a-z0-9]+", "-", f"{table} {kind or ''}".lower()).strip("-")
        parts.append(f"{'#' * level} {title} {{ #{anchor} }}")
        summary = _sentence(inspect.cleandoc(cls.__doc__ or "").partition("\n\n")[0])
        if summary:
            parts.append(summary)
    parts.append(_table(("key", "type", "default", "meaning"), rows))
    for inner, key, is_union in below:
        inner_level = level + 1 if prefix else level
        parts.append(_options_section(inner, f"{key}.", min(inner_level, 4), _kind_of(inner) if is_union else None))
    return "\n\n".join(parts)


def field_docs(cls: type) -> dict[str, str]:
    """The strings that stand below the fields of a class and of those it inherits from."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if base is object or not base.__module__.startswith("nnql_bullet"):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        body = tree.body if isinstance(tree, ast.ClassDef) else []
        for one, after in pairwise(body):
            target = one.target if isinstance(one, ast.AnnAssign) else None
            is_text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if isinstance(target, ast.Name) and is_text and isinstance(after.value.value, str):
                found[target.id] = inspect.cleandoc(after.value.value)
    return found


def _classes_in(annotation: Any) -> list[type]:
    if isinstance(annotation, type) and is_dataclass(annotation):
        return [annotation]
    return [found for part in get_args(annotation) for found in _classes_in(part)]


def _kind_of(cls: type) -> str | None:
    field = cls.__pydantic_fields__.get("kind")  # type: ignore[attr-defined]
    return str(get_args(field.annotation)[0]) if field and get_args(field.annotation) else None


_NAMES = {bool: ("true or false", "true or false"), int: ("integer", "integers"), float: ("number", "numbers")}


def _type_text(annotation: Any, metadata: Any = (), plural: bool = False) -> str:
    """A type in words."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type_text(arguments[0], arguments[1:], plural)
    if origin in (Union, UnionType):
        classes = _classes_in(annotation)
        if classes:
            kinds = [kind for kind in map(_kind_of, classes) if kind]
            return "table" + (
                f"; `kind` is one of {', '.join(f'`{kind}`' for kind in kinds)}" if len(kinds) > 1 else ""
            )
        given = [argument for argument in arguments if argument is not type(None)]
        return " or ".join(_type_text(argument, metadata) for argument in given)
    if origin is Literal:
        return " or ".join(f"`{_toml(choice)}`" for choice in arguments)
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return f"list of {_type_text(arguments[0], plural=True)}"
        return f"list of {len(arguments)} {_type_text(arguments[0], plural=True)}"
    if isinstance(annotation, type) and is_dataclass(annotation):
        return "tables" if plural else "table"
    one, many = _NAMES.get(annotation, ("text", "texts"))
    bounds = [_bounds(metadata)] if metadata else []
    return " ".join([many if plural else one, *filter(None, bounds)])


def _bounds(metadata: Any) -> str:
    found: dict[str, Any] = {}
    for item in metadata:
        for part in (item, *getattr(item, "metadata", ())):
            found |= {name: getattr(part, name) for name in ("gt", "ge", "lt", "le") if hasattr(part, name)}
    found = {name: value for name, value in found.items() if value is not None}
    if "ge" in found and "le" in found:
        return f"from {found['ge']:g} to {found['le']:g}"
    signs = {"gt": "&gt;", "ge": "&ge;", "lt": "&lt;", "le": "&le;"}
    return " and ".join(f"{signs[name]} {value:g}" for name, value in found.items())


def _default_text(field: Any) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if default is None:
        return "not set"
    if default is MISSING or is_dataclass(default):
        kind = getattr(default, "kind", None)
        return f'`kind = "{kind}"`' if kind else "see below"
    return f"`{_toml(default)}`"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return f"{value:g}" if abs(value) < 1e-3 and value else repr(round(value, 6))
    return str(value)


def _sentence(text: str) -> str:
    """A docstring as one line of Markdown."""
    return re.sub(r"\s+", " ", text).strip().replace("|", "\\|")


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


# The command line ---------------------------------------------------------------------------------------------------


def command_line() -> str:
    """Every verb with its options, from its own --help."""
    overview = _said("--help")
    verbs = re.findall(r"^ {2}(\w+) +(\S.*)$", overview, re.MULTILINE)
    rows = [(f"[`{verb}`](#{verb})", _sentence(text)) for verb, text in verbs]
    sections = [_verb(verb, _said(verb, "--help")) for verb, _ in verbs]
    return "\n\n".join([_table(("verb", "what it does"), rows), *sections])


def _said(*arguments: str) -> str:
    """What the program prints."""
    from nnql_bullet.cli import main

    os.environ |= {"COLUMNS": str(WIDTH), "NO_COLOR": "1", "TERM": "dumb"}
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # an encoding, so that boxes are drawn in Unicode
    with redirect_stdout(out), redirect_stderr(out):
        try:
            code: Any = main(list(arguments))
        except SystemExit as stop:
            code = stop.code
    out.seek(0)
    text = out.read()
    if code:
        raise RuntimeError(f"nnql-bullet {' '.join(arguments)}: {text}")
    return text


def _verb(verb: str, text: str) -> str:
    """One verb: usage, what it does, examples, and a table for each group of options."""
    before, *boxes = re.split(r"(?m)^╭─", text)
    usage, _, about = before.strip().partition("\n\n")
    lines = [f"## {verb} {{ #{verb} }}", "```text\n" + re.sub(r"\s+", " ", usage) + "\n```", _prose(about)]
    for box in boxes:
        title, *body = box.splitlines()
        rows = _box_rows([line.strip("│╰╯─") for line in body])
        rows = [(flag, meaning) for flag, meaning in rows if flag != "-h, --help"]
        if not rows:
            continue
        head = re.sub(r"[─╮]", "", title).strip()
        table = _table((head, "meaning"), [(f"`{flag}`", _sentence(meaning)) for flag, meaning in rows])
        lines.append(f'<div class="flags" markdown>\n\n{table}\n\n</div>')
    return "\n\n".join(lines)


def _prose(text: str) -> str:
    """Paragraphs as they are; what is indented becomes a block of commands."""
    blocks: list[str] = []
    for block in re.split(r"\n\s*\n", text.strip("\n")):
        if block.startswith("    "):
            blocks.append("```sh\n" + textwrap.dedent(block).strip() + "\n```")
        elif block.strip():
            blocks.append(_sentence(block))
    return "\n\n".join(blocks)


def _box_rows(lines: list[str]) -> list[tuple[str, str]]:
    """The entries of one box of the help: a flag at the left edge, its meaning beside or below it."""
    rows: list[tuple[str, str]] = []
    for line in lines:
        if not line.strip():
            continue
        if not line.startswith("  "):
            flag, _, meaning = line.strip().partition("  ")
            rows.append((flag, meaning.strip()))
        elif rows:
            flag, meaning = rows[-1]
            rows[-1] = (flag, f"{meaning} {line.strip()}".strip())
    return rows


# Modules ------------------------------------------------------------------------------------------------------------

HIDDEN = ("cli", "_data", "__main__", "__init__")


def api_pages() -> dict[str, tuple[str, str, str]]:
    """Of each part of the package a page: by file name its title, its first sentence, and its Markdown."""
    pages = {}
    for path in sorted(PACKAGE.iterdir()):
        name = path.stem
        is_module = path.suffix == ".py" or (path / "__init__.py").is_file()
        if not is_module or name in HIDDEN or name.startswith("_"):
            continue
        modules = [path] if path.suffix == ".py" else sorted(path.rglob("*.py"))
        about = _about(name)
        parts = [f"# `nnql_bullet.{name}`", *(f"::: {place}" for module in modules for place in _places(module))]
        if path.suffix != ".py":
            parts.insert(1, about)
        pages[name] = (name, about, "\n\n".join(parts) + "\n")
    return pages


def _places(path: Path) -> list[str]:
    """What of a module a page shows: all of it; of a package only what it defines itself, not what it passes on."""
    if path.name != "__init__.py":
        return [module_name(path)]
    body = ast.parse(path.read_text(encoding="utf-8")).body
    defined = [part.name for part in body if isinstance(part, (ast.FunctionDef, ast.ClassDef))]
    return [f"{module_name(path)}.{name}" for name in defined if not name.startswith("_")]


def layers() -> str:
    """A table of the layers that import-linter checks, from the top down."""
    import tomlkit

    contracts = tomlkit.parse((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layered,) = [contract["layers"] for contract in contracts if contract["type"] == "layers"]
    pages, rows = api_pages(), []
    for number, layer in enumerate(layered, 1):
        for name in (part.strip(" ()") for part in layer.split("|")):
            if not _source(name).is_file():  # a layer in brackets may be missing
                continue
            module = f"[`{name}`](../reference/api/{name}.md)" if name in pages else f"`{name}`"
            rows.append((str(number), module, _about(name)))
    return _table(("layer", "module", "what it is"), rows)


def _about(name: str) -> str:
    """The first sentence of a module's or folder's docstring."""
    text = ast.get_docstring(ast.parse(_source(name).read_text(encoding="utf-8"))) or ""
    return _sentence(text.partition("\n\n")[0])


def _source(name: str) -> Path:
    path = PACKAGE / f"{name}.py"
    return path if path.is_file() else PACKAGE / name / "__init__.py"


def api_index() -> str:
    """A table of the parts of the package."""
    return _table(("module", "what it holds"), [(f"[`{n}`]({n}.md)", about) for n, about, _ in api_pages().values()])


# Shipped policies ---------------------------------------------------------------------------------------------------


def policy_cards() -> str:
    """The card of every shipped policy, its headings one level down."""
    assets = import_module("nnql_bullet.assets")
    cards = [assets.card(path).read_text(encoding="utf-8").strip() for path in assets.policies().values()]
    return "\n\n".join(_card(card) for card in cards)


def _card(text: str) -> str:
    title, _, body = text.partition("\n")
    name, _, about = title.lstrip("# ").partition(":")
    body = re.sub(r"(?m)^## (.*)$", r"**\1**", body)
    body = re.sub(r"(?s)\*\*Configuration\*\*\n\n(```toml.*?```)", _folded, body)
    return f"## {name}\n\n{about.strip().capitalize()}.\n{body}"


def _folded(match: re.Match[str]) -> str:
    return '??? note "Configuration"\n\n' + textwrap.indent(match[1], "    ")
