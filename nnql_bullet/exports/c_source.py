"""Writes translated kernels (`translation`) as C99: static functions of fixed sizes, no allocation, no recursion."""

from collections.abc import Iterator, Mapping, Sequence

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
    Struct,
    Var,
)

TYPES: dict[Kind, str] = {"real": "double", "int": "int", "bool": "int"}
_STORED: dict[Kind, str] = {"real": "double", "int": "int", "bool": "unsigned char"}
_INFIX = {"+", "-", "*", "<", "<=", ">", ">=", "==", "!="}
_NAMED = {"and": "&&", "or": "||"}
_HELPED = {"min": "smaller", "max": "larger", "//": "quotient", "%": "remainder_of"}

_HELPERS = (
    "static double smaller(double a, double b) { return b < a ? b : a; }",
    "static double larger(double a, double b) { return b > a ? b : a; }",
    "static int smaller_int(int a, int b) { return b < a ? b : a; }",
    "static int larger_int(int a, int b) { return b > a ? b : a; }",
    "static int abs_int(int a) { return a < 0 ? -a : a; }",
    """static int quotient_int(int a, int b) /* rounds down */
{
    return a / b - (a % b != 0 && (a % b < 0) != (b < 0));
}""",
    "static int remainder_of_int(int a, int b) { return a - b * quotient_int(a, b); }",
    """static double remainder_of(double a, double b)
{
    const double rest = fmod(a, b);
    return rest < 0.0 || rest > 0.0 ? ((rest < 0.0) != (b < 0.0) ? rest + b : rest) : 0.0;
}""",
)
"""Each is called by those after it alone."""


def c_functions(functions: Sequence[Function], structs: Mapping[str, Struct]) -> str:
    """The functions, after what they call, with the helpers that they need."""
    text = "\n\n".join("\n".join(_function(its, structs)) for its in functions)
    needed: list[str] = []
    for helper in reversed(_HELPERS):
        name = helper.partition("(")[0].split()[-1]
        if f"{name}(" in text + "".join(needed):
            needed.insert(0, helper)
    return "\n".join([*needed, "", text]) + "\n"


def _table(array: ArrayOf) -> str:
    """A table in the source."""
    values = np.asarray(array.values).reshape(-1).tolist()
    numbers = ", ".join(_literal(its, array.kind) for its in values)
    return f"static const {_STORED[array.kind]} {array.name}[{array.size}] = {{ {numbers} }};"


def _function(f: Function, structs: Mapping[str, Struct]) -> Iterator[str]:
    written = f.written()
    params = []
    for name, struct in structs.items():
        if f.takes(name):
            const = "" if any(of == name for of, _ in written) else "const "
            params.append(f"{const}{struct.type} *{name}")
    for its in f.params:
        if not isinstance(its, ArrayOf):
            params.append(f"{TYPES[its.kind]} {its.name}")
        elif not its.struct:
            const = "" if ("", its.name) in written else "const "
            params.append(f"{const}{_STORED[its.kind]} {its.name}[{its.size}]")
    one = len(f.results) == 1
    if not one:
        params += [f"{TYPES[its.kind]} *{its.name}" for its in f.results]
    kind = TYPES[f.results[0].kind] if one else "void"
    if f.about:
        yield f"/* {f.about} */"
    yield f"static {kind} {f.name}({', '.join(params) or 'void'})"
    yield "{"
    yield from (f"    {_table(its)}" for its in f.constants)
    variables = f.variables | ({f.results[0].name: f.results[0].kind} if one else {})
    yield from (f"    {TYPES[k]} {name} = {'0.0' if k == 'real' else '0'};" for name, k in variables.items())
    yield from (f"    {_STORED[its.kind]} {its.name}[{its.size}];" for its in f.arrays)
    read = _read(f)
    names = [*f.variables, *(its.name for its in f.params if not (isinstance(its, ArrayOf) and its.struct))]
    used = {part for part in names if part in read}
    for name in structs:
        if f.takes(name) and name not in read:
            yield f"    (void){name};"
    yield from (f"    (void){name};" for name in names if name not in used)
    pointers = set() if one else {its.name for its in f.results}
    yield from _block(f.body, "    ", pointers, f.results[0].name if one else "")
    yield "}"


def _read(f: Function) -> set[str]:
    found: set[str] = set()

    def look(e: Expr | ArrayOf) -> None:
        if isinstance(e, (Var, ArrayOf)):
            found.add((isinstance(e, ArrayOf) and e.struct) or e.name)
        elif isinstance(e, Item):
            look(e.array)
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
                given = list(
                    dict.fromkeys(its.struct for its in function.params if isinstance(its, ArrayOf) and its.struct)
                )
                for param, a in zip(function.params, args, strict=True):
                    if not (isinstance(param, ArrayOf) and param.struct):
                        given.append(_place(a) if isinstance(a, ArrayOf) else _expr(a, pointers))
                if len(results) == 1:
                    yield f"{indent}{results[0].name} = {function.name}({', '.join(given)});"
                else:
                    given += [f"&{its.name}" for its in results]
                    yield f"{indent}{function.name}({', '.join(given)});"


def _place(array: ArrayOf) -> str:
    return f"{array.struct}->{array.name}" if array.struct else array.name


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
            return f"{_place(array)}[{_expr(place, pointers)}]"
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
        case Op(name, args, kind):
            name = _HELPED.get(name, name)
            if kind == "int":
                name = f"{name}_int"
            elif name == "abs":
                name = "fabs"
            return f"{name}({', '.join(_expr(a, pointers) for a in args)})"


def _literal(value: float | int | bool, kind: Kind) -> str:
    if kind == "real":
        text = repr(float(value))
        return text if value >= 0 and text[0] != "-" else f"({text})"
    number = int(value)
    return str(number) if number >= 0 else f"({number})"


def c_struct(struct: Struct, last: str = "") -> str:
    """The declaration of a structure, with another member as its last."""
    members = [f"    {_STORED[its.kind]} {its.name}[{its.size}];" for its in struct.members]
    members += [f"    {last};"] if last else []
    return "\n".join(["typedef struct {", *members, f"}} {struct.type};"]) + "\n"
