"""Mutators that every class of input shares: of bytes, of trees of values, of arrays. Each takes a generator."""

import io
import json
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from random import Random
from typing import Any

import numpy as np
import tomlkit

Tree = dict[str, Any]
DEEP = 3000
NUMBERS = (
    0,
    -1,
    1,
    2,
    7,
    255,
    4096,
    10**5,
    10**6,
    2**31,
    2**63 - 1,
    2**63,
    2**64,
    10**20,
    10**400,
    -(10**30),
    10**5000,
)
FLOATS = (0.0, -0.0, -1.0, 0.5, 1e-320, 1e-300, 1e-9, 1e9, 1e300, -1e300, float("nan"), float("inf"), -float("inf"))
TEXTS = (
    *("", " ", "x" * 100_000, "a\0b", "\x1b[31m\x07", "a\nb\r\nc", "<script>alert(1)</script>", "[red]|`$(x)`"),
    *("../../../etc/passwd", "/dev/zero", "/", ".", "nan", "-1", "true", "é\u202e\ufeff", "9" * 5000, "package://a/b"),
)
OTHERS: tuple[Any, ...] = (True, False, [], {}, [[]], [{}], [1, "a", None], {"": 0}, {"kind": "boxes"}, {"kind": []})
NASTY_BYTES = (
    b"\xef\xbb\xbf",
    b"\xff\xfe",
    b"\0" * 64,
    b"\n" * 1000,
    b"[" * DEEP,
    b"{" * DEEP,
    b'"',
    b"'''",
    b"9" * 6000,
)


def nasty(random: Random) -> Any:
    """A value that nobody expects."""
    return random.choice(random.choice((NUMBERS, FLOATS, TEXTS, OTHERS)))


def bytes_changed(data: bytes, random: Random) -> bytes:
    """Bytes flipped, cut off, cut out, doubled, put in, or in another encoding."""
    at, to = sorted(random.randrange(len(data) + 1) for _ in range(2))
    match random.randrange(9):
        case 0:
            changed = bytearray(data)
            for _ in range(random.choice((1, 1, 2, 8, 64))):
                if changed:
                    changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
            return bytes(changed)
        case 1:
            return data[:at]
        case 2:
            return data[:at] + data[to:]
        case 3:
            return data[:to] + data[at:]
        case 4:
            return data[:at] + random.choice(NASTY_BYTES) + data[at:]
        case 5:
            return data[:at] + random.randbytes(random.choice((1, 4, 100))) + data[at:]
        case 6:
            return random.choice((b"", b"\n", b"\0", random.randbytes(500), *NASTY_BYTES))
        case 7:
            return random.choice((b"\xef\xbb\xbf" + data, data + "é".encode("latin-1"), data.replace(b"\n", b"\r")))
        case _:  # a line doubled: keys twice
            lines = data.split(b"\n")
            lines.insert(random.randrange(len(lines) + 1), random.choice(lines))
            return b"\n".join(lines)


def numbers_changed(data: bytes, random: Random) -> bytes:
    """A number in a text replaced by another, its tag or line doubled or removed, or bytes changed."""
    if random.random() < 0.4:
        return bytes_changed(data, random)
    found = list(re.finditer(rb"(?<![\w.])-?\d+(\.\d+)?|<[^<>]*>|\n[^\n]*", data[:20_000]))
    if not found:
        return bytes_changed(data, random)
    its = random.choice(found)
    if its[0].startswith((b"<", b"\n")):
        other = its[0] * random.choice((0, 2, 60))
    else:
        other = str(random.choice((*FLOATS, *NUMBERS[:-1], "", "1,5", "0x10", "1e-3", "[1]"))).encode()
    return data[: its.start()] + other + data[its.end() :]


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every container of a tree with each of its keys."""
    waiting = [tree]
    while waiting:
        one = waiting.pop()
        for key in one if isinstance(one, dict) else range(len(one)) if isinstance(one, list) else ():
            yield one, key
            waiting.append(one[key])


def tree_changed(tree: Any, random: Random) -> Any:
    """Values replaced by nasty ones, removed, moved, renamed or nested deeply."""
    tree = json.loads(json.dumps(tree))
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        places = list(_places(tree))
        if not places:
            break
        where, key = random.choice(places)
        match random.randrange(8):
            case 0:
                del where[key]
            case 1:
                other, its = random.choice(places)
                where[key] = json.loads(json.dumps(other[its] if _has(other, its) else 0, default=str))
            case 2 if isinstance(where, dict):
                where[random.choice(("", "kind", "x" * 1000, "a.b", "é\n", "base", "preset"))] = where.pop(key)
            case 3:
                deep: Any = 0
                for _ in range(random.choice((2, 50, 900, DEEP))):
                    deep = [deep] if random.random() < 0.5 else {"a": deep}
                where[key] = deep
            case 4 if isinstance(where[key], str | list):
                where[key] = where[key] * random.choice((0, 2, 100))
            case 5 if isinstance(where[key], int | float):
                where[key] = random.choice((-where[key], where[key] * 1e6, str(where[key]), [where[key]]))
            case _:
                where[key] = nasty(random)
    return tree


def _has(where: Any, key: Any) -> bool:
    return key in where if isinstance(where, dict) else isinstance(key, int) and key < len(where)


def toml_changed(data: bytes, random: Random) -> bytes:
    """A TOML text, changed as a tree or as bytes."""
    return _text_changed(data, random, lambda text: tomlkit.parse(text).unwrap(), tomlkit.dumps)


def json_changed(data: bytes, random: Random) -> bytes:
    """A JSON text, changed as a tree or as bytes."""
    return _text_changed(data, random, json.loads, json.dumps)


def _text_changed(data: bytes, random: Random, read: Callable[[str], Any], write: Callable[[Any], str]) -> bytes:
    if random.random() < 0.7:
        try:
            return write(tree_changed(read(data.decode()), random)).encode("utf-8", "surrogatepass")
        except Exception:  # some trees cannot be written in this language
            pass
    return bytes_changed(data, random)


def csv_changed(data: bytes, random: Random) -> bytes:
    """A CSV, its cells, rows or columns changed, or its bytes."""
    rows = [line.split(b",") for line in data.split(b"\n")]
    row, column = random.randrange(len(rows)), random.randrange(len(rows[0]))
    match random.randrange(5):
        case 0:
            rows[row][column % len(rows[row])] = str(random.choice((*FLOATS, *NUMBERS[:-1], *TEXTS))).encode()
        case 1:
            del rows[row]
        case 2:
            rows = [cells[:column] + cells[column + 1 :] for cells in rows]
        case 3:
            rows[row] = rows[row] * random.choice((2, 100))
        case _:
            return bytes_changed(data, random)
    return b"\n".join(b",".join(cells) for cells in rows)


def array_changed(array: Any, random: Random) -> Any:
    """An array of another shape, type or content."""
    match random.randrange(8):
        case 0:
            return array[: random.randrange(len(array) + 1)] if array.ndim else array.reshape(1)
        case 1:
            return array[..., None]
        case 2:
            return np.concatenate([array, array]) if array.ndim else np.stack([array, array])
        case 3:
            return np.array(random.choice((*FLOATS, "a", 0, True)))
        case 4:
            return array.astype(random.choice(("U8", "i1", "f2", "?", "c8", "M8[s]")), casting="unsafe")
        case 5 if array.size and array.dtype.kind in "fi":
            changed = array.astype(np.float64)
            changed.flat[random.randrange(array.size)] = random.choice(FLOATS)
            return changed
        case 6:
            return np.zeros(0)
        case _:
            return array.T if array.ndim > 1 else array[::-1] if array.ndim else array


def arrays_changed(arrays: Mapping[str, Any], random: Random) -> dict[str, Any]:
    """Arrays by name: one changed, removed, renamed or added."""
    found = dict(arrays)
    name = random.choice(list(found))
    match random.randrange(6):
        case 0:
            del found[name]
        case 1:
            found[random.choice(("", "x", "../x", "é"))] = found.pop(name)
        case 2:
            found["more"] = np.zeros(3)
        case _:
            found[name] = array_changed(found[name], random)
    return found


def npz_changed(data: bytes, random: Random) -> bytes:
    """A .npz: its arrays, the JSON in `about`, the headers of its arrays, or its bytes."""
    kind = random.randrange(6)
    if kind == 0:
        return bytes_changed(data, random)
    with np.load(io.BytesIO(data)) as stored:
        arrays = {name: stored[name] for name in stored.files}
    if kind == 1:
        return _with_header(data, random)
    if kind in (2, 3):
        about = tree_changed(json.loads(str(arrays["about"])), random)
        try:
            arrays["about"] = np.array(json.dumps(about))
        except (ValueError, RecursionError):  # an integer of too many digits for Python itself
            arrays["about"] = np.array("[" * DEEP)
    elif random.random() < 0.1:
        arrays[random.choice(list(arrays))] = np.array([{"an": "object"}, None], dtype=object)
    else:
        arrays = arrays_changed(arrays, random)
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def _with_header(data: bytes, random: Random) -> bytes:
    """A .npz one of whose arrays has another header, or is a bomb."""
    shapes = (
        "(-1,)",
        "(-5, 3)",
        "(10**12,)",
        "(1000000000000,)",
        "()",
        "(3, 3, 3)",
        "(" + "1," * 60 + ")",
        "'a'",
        "(1e9,)",
    )
    types = ("'<f8'", "'|O'", "'<U1000000000'", "'|V0'", "[('a', '<f8')]", "'rubbish'")
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as new:
        chosen = random.choice(old.namelist())
        for name in old.namelist():
            content = old.read(name)
            if name == chosen and random.random() < 0.05:
                content = np.lib.format.magic(1, 0) + b"\0\1" + b" " * 255 + b"\n" + b"\0" * 300_000_000
            elif name == chosen:
                text = f"{{'descr': {random.choice(types)}, 'fortran_order': False, 'shape': {random.choice(shapes)}}}"
                header = text.encode().ljust(117) + b"\n"
                content = np.lib.format.magic(1, 0) + len(header).to_bytes(2, "little") + header + content[128:]
            new.writestr(name, content)
    return file.getvalue()


def safetensors_changed(data: bytes, random: Random) -> bytes:
    """A safetensors file: its header as a tree, the configuration in its metadata, its length, or its bytes."""
    length = int.from_bytes(data[:8], "little")
    header, content = json.loads(data[8 : 8 + length]), data[8 + length :]
    match random.randrange(5):
        case 0:
            return bytes_changed(data, random)
        case 1:
            return random.choice((0, 1, 2**31, 2**63, 10**8, length + 1)).to_bytes(8, "little") + data[8:]
        case 2:
            header = tree_changed(header, random)
        case 3:
            config = json_changed(header["__metadata__"]["config"].encode(), random)
            header["__metadata__"]["config"] = config.decode("utf-8", "replace")
        case _:
            header["__metadata__"][random.choice(("episodes", "format", "config", "version"))] = str(
                random.choice(TEXTS)
            )
    try:
        text = json.dumps(header).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):  # an integer of too many digits for Python itself
        text = b"{" * DEEP
    return len(text).to_bytes(8, "little") + text + content
