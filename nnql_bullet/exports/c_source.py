"""Writes translated kernels (`translation`) as C99: static functions of fixed sizes, without allocation or recursion."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from nnql_bullet.exports.translation import (
    ArrayOf,
    Do,
    Expr,
    For,
    Function,
    If,
    Item,
    Kind,
    Leave,
    Literal_,
    Op,
    Set,
    Statement,
    Var,
)

TYPES: dict[Kind, str] = {"real": "double", "int": "int", "bool": "int"}
_STORED: dict[Kind, str] = {"real": "double", "int": "int", "bool": "unsigned char"}
_INFIX = {"+", "-", "*", "<", "<=", ">", ">=", "==", "!="}
_NAMED = {"and": "&&", "or": "||"}
_HELPED = {"min": "smaller", "max": "larger", "//": "quotient", "%": "remainder_of"}
_INTEGER = {"//", "%"}

HELPERS = """\
static double smaller(double a, double b) { return b < a ? b : a; }
static double larger(double a, double b) { return b > a ? b : a; }
static int smaller_int(int a, int b) { return b < a ? b : a; }
static int larger_int(int a, int b) { return b > a ? b : a; }
/* Of a division that rounds down, as its remainder. */
static int quotient_int(int a, int b) { return a / b - (a % b != 0 && (a % b < 0) != (b < 0)); }
static int remainder_of_int(int a, int b) { return a - b * quotient_int(a, b); }
static double remainder_of(double a, double b)
{
    const double rest = fmod(a, b);
    return rest < 0.0 || rest > 0.0 ? ((rest < 0.0) != (b < 0.0) ? rest + b : rest) : 0.0;
}
"""


def c_functions(functions: Sequence[Function]) -> str:
    """The functions, after what they call."""
    used = "\n\n".join("\n".join(_function(its)) for its in functions)
    return "\n".join(line for line in HELPERS.splitlines() if _needed(line, used)) + "\n\n" + used + "\n"


def _needed(line: str, text: str) -> bool:
    return True


def c_array(array: ArrayOf) -> str:
    """A table in the source."""
    assert array.values is not None
    numbers = ", ".join(_literal(its, array.kind) for its in array.values.reshape(-1).tolist())
    return f"static const {_STORED[array.kind]} {array.name}[{array.size}] = {{ {numbers} }};"


def c_member(array: ArrayOf) -> str:
    """A member of a structure."""
    return f"{_STORED[array.kind]} {array.name}[{array.size}];"


def _function(f: Function) -> Iterator[str]:
    written = f.written()
    params = []
    for its in f.params:
        if isinstance(its, ArrayOf):
            const = "" if its.name in written else "const "
            params.append(f"{const}{_STORED[its.kind]} {its.name}[{its.size}]")
        else:
            params.append(f"{TYPES[its.kind]} {its.name}")
    one = len(f.results) == 1
    if not one:
        params += [f"{TYPES[its.kind]} *{its.name}" for its in f.results]
    kind = TYPES[f.results[0].kind] if one else "void"
    if f.about:
        yield f"/* {f.about} */"
    yield f"static {kind} {f.name}({', '.join(params) or 'void'})"
    yield "{"
    yield from (f"    {c_array(its)}" for its in f.constants)
    results = {its.name for its in f.results}
    yield from (f"    {TYPES[k]} {name} = {'0.0' if k == 'real' else '0'};" for name, k in f.variables.items())
    if one:
        its = f.results[0]
        yield f"    {TYPES[its.kind]} {its.name} = {'0.0' if its.kind == 'real' else '0'};"
    yield from (f"    {_STORED[its.kind]} {its.name}[{its.size}];" for its in f.arrays)
    read = _read(f)
    unused = [name for name in f.variables if name not in read]
    unused += [its.name for its in f.params if its.name not in read]
    yield from (f"    (void){name};" for name in unused)
    pointers = set() if one else results
    yield from _block(f.body, "    ", pointers, f.results[0].name if one else "")
    yield "}"


def _read(f: Function) -> set[str]:
    found: set[str] = set()

    def look(e: Expr | ArrayOf) -> None:
        if isinstance(e, (Var, ArrayOf)):
            found.add(e.name)
        elif isinstance(e, Item):
            found.add(e.array.name)
            look(e.place)
        elif isinstance(e, Op):
            for arg in e.args:
                look(arg)

    for its in f.statements():
        match its:
            case Set(target, value):
                look(value)
                if isinstance(target, Item):
                    look(target)
            case If(test, _, _):
                look(test)
            case For(counter, start, stop, _, _):
                found.add(counter.name)
                look(start)
                look(stop)
            case Do(_, args, _):
                for arg in args:
                    look(arg)
    return found


def _block(body: Sequence[Statement], indent: str, pointers: set[str], result: str) -> Iterator[str]:
    for its in body:
        match its:
            case Set(target, value):
                where = _expr(target, pointers)
                cast = "(unsigned char)" if isinstance(target, Item) and target.kind == "bool" else ""
                yield f"{indent}{where} = {cast}{_wrapped(value, pointers) if cast else _expr(value, pointers)};"
            case If(test, then, other):
                yield f"{indent}if ({_expr(test, pointers)}) {{"
                yield from _block(then, indent + "    ", pointers, result)
                if other:
                    yield f"{indent}}} else {{"
                    yield from _block(other, indent + "    ", pointers, result)
                yield f"{indent}}}"
            case For(counter, start, stop, _, inner):
                n = counter.name
                yield f"{indent}for ({n} = {_expr(start, pointers)}; {n} < {_expr(stop, pointers)}; {n}++) {{"
                yield from _block(inner, indent + "    ", pointers, result)
                yield f"{indent}}}"
            case Leave("return"):
                yield f"{indent}return{' ' + result if result else ''};"
            case Leave(how):
                yield f"{indent}{how};"
            case Do(function, args, results):
                given = [a.name if isinstance(a, ArrayOf) else _expr(a, pointers) for a in args]
                if len(results) == 1:
                    yield f"{indent}{results[0].name} = {function.name}({', '.join(given)});"
                else:
                    given += [f"&{its.name}" for its in results]
                    yield f"{indent}{function.name}({', '.join(given)});"


def _wrapped(e: Expr, pointers: set[str]) -> str:
    text = _expr(e, pointers)
    return f"({text})" if isinstance(e, Op) else text


def _expr(e: Expr, pointers: set[str]) -> str:
    match e:
        case Literal_(value, kind):
            return _literal(value, kind)
        case Var(name):
            return f"*{name}" if name in pointers else name
        case Item(array, place):
            return f"{array.name}[{_expr(place, pointers)}]"
        case Op("/", (a, b)):
            return f"{_wrapped(a, pointers)} / {_wrapped(b, pointers)}"
        case Op("neg", (a,)):
            return f"-{_wrapped(a, pointers)}"
        case Op("not", (a,)):
            return f"!{_wrapped(a, pointers)}"
        case Op("real", (a,)):
            return f"(double){_wrapped(a, pointers)}"
        case Op("trunc", (a,)):
            return f"(int){_wrapped(a, pointers)}"
        case Op(name, (a, b)) if name in _INFIX or name in _NAMED:
            return f"{_wrapped(a, pointers)} {_NAMED.get(name, name)} {_wrapped(b, pointers)}"
    assert isinstance(e, Op)
    name = _HELPED.get(e.name, e.name)
    if e.kind == "int":
        name = "abs_int" if name == "abs" else f"{name}_int"
    elif name == "abs":
        name = "fabs"
    return f"{name}({', '.join(_expr(a, pointers) for a in e.args)})"


def _literal(value: float | int | bool, kind: Kind) -> str:
    if kind == "real":
        text = repr(float(value))
        return text if value >= 0 and "-" != text[0] else f"({text})"
    number = int(value)
    return str(number) if number >= 0 else f"({number})"
