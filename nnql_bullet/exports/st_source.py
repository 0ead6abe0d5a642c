"""Writes translated kernels (`translation`) as Structured Text of IEC 61131-3, plain and in PLCopen XML.

Arrays are fixed, loops are bounded, nothing recurses. Only standard functions are called: what the standard lacks, such
as the arc tangent of two numbers, is written out in `_HELPERS`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

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

Real = Literal["REAL", "LREAL"]
_RESERVED = frozenset(
    [
        "ABS",
        "ACOS",
        "ACTION",
        "ADD",
        "AND",
        "ANY",
        "ARRAY",
        "ASIN",
        "AT",
        "ATAN",
        "ATAN2",
        "BOOL",
        "BY",
        "BYTE",
        "CASE",
        "CEIL",
        "CLASS",
        "CONCAT",
        "CONFIGURATION",
        "CONSTANT",
        "CONTINUE",
        "COS",
        "CTD",
        "CTU",
        "DATE",
        "DELETE",
        "DINT",
        "DIV",
        "DO",
        "DT",
        "DWORD",
        "ELSE",
        "ELSIF",
        "END",
        "EQ",
        "EXIT",
        "EXP",
        "EXPT",
        "FALSE",
        "FIND",
        "FLOOR",
        "FOR",
        "FROM",
        "FUNCTION",
        "GE",
        "GT",
        "IF",
        "IN",
        "INSERT",
        "INT",
        "INTERFACE",
        "LE",
        "LEFT",
        "LEN",
        "LIMIT",
        "LINT",
        "LN",
        "LOG",
        "LREAL",
        "LT",
        "MAX",
        "METHOD",
        "MID",
        "MIN",
        "MOD",
        "MOVE",
        "MUL",
        "MUX",
        "NE",
        "NEG",
        "NOT",
        "NULL",
        "OF",
        "ON",
        "OR",
        "PROGRAM",
        "PT",
        "READ",
        "REAL",
        "REF",
        "REPEAT",
        "REPLACE",
        "RESOURCE",
        "RETAIN",
        "RETURN",
        "RIGHT",
        "ROL",
        "ROR",
        "RS",
        "SEL",
        "SHL",
        "SHR",
        "SIN",
        "SINT",
        "SQRT",
        "SR",
        "STEP",
        "STRING",
        "STRUCT",
        "SUB",
        "TAN",
        "TASK",
        "THEN",
        "TIME",
        "TO",
        "TOD",
        "TOF",
        "TON",
        "TP",
        "TRANSITION",
        "TRUE",
        "TRUNC",
        "TYPE",
        "UNTIL",
        "USING",
        "VAR",
        "WHILE",
        "WITH",
        "WORD",
        "WRITE",
        "XOR",
    ]
)
_INFIX = {
    **{name: name for name in ("+", "-", "*", "/", "<", "<=", ">", ">=")},
    **{"==": "=", "!=": "<>", "and": "AND", "or": "OR"},
}
_STANDARD = {"cos": "COS", "sin": "SIN", "sqrt": "SQRT", "exp": "EXP", "min": "MIN", "max": "MAX", "abs": "ABS"}
_OWN = ("atan2", "hypot", "floor", "ceil", "rint", "copysign")

_HELPERS = """\
(* The largest whole number that is not larger. *)
FUNCTION NNQL_FLOOR : @REAL
VAR_INPUT x : @REAL; END_VAR
    NNQL_FLOOR := DINT_TO_@REAL(TRUNC(x));
    IF DINT_TO_@REAL(TRUNC(x)) > x THEN
        NNQL_FLOOR := DINT_TO_@REAL(TRUNC(x)) - 1.0;
    END_IF;
END_FUNCTION

(* The smallest whole number that is not smaller. *)
FUNCTION NNQL_CEIL : @REAL
VAR_INPUT x : @REAL; END_VAR
    NNQL_CEIL := -NNQL_FLOOR(x := -x);
END_FUNCTION

(* The nearest whole number; half-way the even one. *)
FUNCTION NNQL_RINT : @REAL
VAR_INPUT x : @REAL; END_VAR
VAR below : @REAL; END_VAR
    below := NNQL_FLOOR(x := x);
    NNQL_RINT := below;
    IF ((x - below) > 0.5) OR (((x - below) = 0.5) AND ((TRUNC(below) MOD 2) <> 0)) THEN
        NNQL_RINT := below + 1.0;
    END_IF;
END_FUNCTION

FUNCTION NNQL_HYPOT : @REAL
VAR_INPUT x : @REAL; y : @REAL; END_VAR
    NNQL_HYPOT := SQRT((x * x) + (y * y));
END_FUNCTION

(* The size of one number with the sign of another. *)
FUNCTION NNQL_COPYSIGN : @REAL
VAR_INPUT x : @REAL; y : @REAL; END_VAR
    NNQL_COPYSIGN := ABS(x);
    IF y < 0.0 THEN
        NNQL_COPYSIGN := -ABS(x);
    END_IF;
END_FUNCTION

(* The direction of (x, y), from -pi to pi. *)
FUNCTION NNQL_ATAN2 : @REAL
VAR_INPUT y : @REAL; x : @REAL; END_VAR
    IF (x = 0.0) AND (y = 0.0) THEN
        NNQL_ATAN2 := 0.0;
    ELSIF ABS(y) > ABS(x) THEN
        NNQL_ATAN2 := NNQL_COPYSIGN(x := @HALF_PI, y := y) - ATAN(x / y);
    ELSIF x > 0.0 THEN
        NNQL_ATAN2 := ATAN(y / x);
    ELSE
        NNQL_ATAN2 := ATAN(y / x) + NNQL_COPYSIGN(x := @PI, y := y);
    END_IF;
END_FUNCTION

(* The remainder of a division that rounds down. *)
FUNCTION NNQL_REMAINDER : @REAL
VAR_INPUT x : @REAL; y : @REAL; END_VAR
    NNQL_REMAINDER := x - (y * NNQL_FLOOR(x := x / y));
END_FUNCTION

FUNCTION NNQL_REMAINDER_INT : DINT
VAR_INPUT x : DINT; y : DINT; END_VAR
    NNQL_REMAINDER_INT := x MOD y;
    IF (NNQL_REMAINDER_INT <> 0) AND ((NNQL_REMAINDER_INT < 0) <> (y < 0)) THEN
        NNQL_REMAINDER_INT := NNQL_REMAINDER_INT + y;
    END_IF;
END_FUNCTION

(* The quotient, rounded down. *)
FUNCTION NNQL_QUOTIENT_INT : DINT
VAR_INPUT x : DINT; y : DINT; END_VAR
    NNQL_QUOTIENT_INT := (x - NNQL_REMAINDER_INT(x := x, y := y)) / y;
END_FUNCTION
"""


@dataclass(frozen=True, slots=True)
class Block:
    """A function block: inputs, outputs and what it keeps, with the function that it calls."""

    name: str
    about: str
    inputs: Sequence[Var | ArrayOf]
    outputs: Sequence[Var | ArrayOf]
    function: Function


@dataclass(frozen=True, slots=True)
class Unit:
    """A declaration by itself: what it is, its name, and its text in parts as PLCopen XML has them."""

    kind: Literal["type", "function", "block"]
    name: str
    text: str


@dataclass
class Writer:
    """Writes functions and a block over real numbers of one precision."""

    real: Real
    structs: Mapping[str, Struct] = field(default_factory=dict)
    _types: dict[str, str] = field(default_factory=dict)

    def units(self, functions: Sequence[Function], block: Block) -> list[Unit]:
        """Types, functions in the order of their calls, and the block."""
        bodies = [Unit("function", _named(its.name), "\n".join(self._function(its)) + "\n") for its in functions]
        last = Unit("block", block.name, "\n".join(self._block_of(block)) + "\n")
        structs = [self._struct(its) for its in self.structs.values()]
        types = [Unit("type", name, text) for name, text in sorted(self._types.items())]
        return [*types, *structs, *self._helpers("".join(its.text for its in (*bodies, last))), *bodies, last]

    def _helpers(self, text: str) -> list[Unit]:
        """Those of the functions in `_HELPERS` that are needed."""
        helpers = _HELPERS.replace("@REAL", self.real)
        helpers = helpers.replace("@HALF_PI", "1.5707963267948966").replace("@PI", "3.141592653589793")
        found: list[Unit] = []
        for its in reversed(helpers.split("END_FUNCTION\n")[:-1]):
            name = its.partition("FUNCTION ")[2].partition(" ")[0]
            if f"{name}(" in text + "".join(one.text for one in found):
                found.insert(0, Unit("function", name, its.lstrip("\n") + "END_FUNCTION\n"))
        return found

    def _type(self, kind: Kind) -> str:
        return {"real": self.real, "int": "DINT", "bool": "BOOL"}[kind]

    def _array(self, array: ArrayOf) -> str:
        """The name of an array's type, which it declares."""
        kind = self._type(array.kind)
        name = f"NNQL_{kind}_{array.size}"
        self._types[name] = f"TYPE\n    {name} : ARRAY [0..{array.size - 1}] OF {kind};\nEND_TYPE\n"
        return name

    def _struct(self, struct: Struct) -> Unit:
        members = [f"        {_name(its.name)} : {self._array(its)};" for its in struct.members]
        text = "\n".join(["TYPE", f"    {struct.type} : STRUCT", *members, "    END_STRUCT;", "END_TYPE"]) + "\n"
        return Unit("type", struct.type, text)

    def _declared(self, its: Var | ArrayOf) -> str:
        kind = self._array(its) if isinstance(its, ArrayOf) else self._type(its.kind)
        return f"    {_name(its.name)} : {kind};"

    def _function(self, f: Function) -> Iterator[str]:
        if f.about:
            yield f"(* {f.about} *)"
        one = len(f.results) == 1
        yield f"FUNCTION {_named(f.name)} : {self._type(f.results[0].kind) if one else 'BOOL'}"
        yield from _section("VAR_INPUT", (self._declared(its) for its in f.params if isinstance(its, Var)))
        within = [f"    {name} : {its.type};" for name, its in self.structs.items() if f.takes(name)]
        arrays = (its for its in f.params if isinstance(its, ArrayOf) and not its.struct)
        yield from _section("VAR_IN_OUT", (*within, *map(self._declared, arrays)))
        yield from _section("VAR_OUTPUT", () if one else map(self._declared, f.results))
        inner = [self._declared(Var(name, kind)) for name, kind in f.variables.items()]
        inner += map(self._declared, f.arrays)
        if any(isinstance(its, Do) and len(its.results) != 1 for its in f.statements()):
            inner.append("    done : BOOL;")
        yield from _section("VAR", inner)
        tables = []
        for its in f.constants:
            numbers = ", ".join(
                self._literal(one, its.kind).strip("()") for one in np.asarray(its.values).reshape(-1).tolist()
            )
            kind = self._type(its.kind)
            tables.append(f"    {its.name} : ARRAY [0..{its.size - 1}] OF {kind} := [{numbers}];")
        yield from _section("VAR CONSTANT", tables)
        yield from self._statements(f.body, "    ", {f.results[0].name: _named(f.name)} if one else {}, f)
        yield "END_FUNCTION"

    def _statements(
        self, body: Sequence[Statement], indent: str, names: Mapping[str, str], f: Function
    ) -> Iterator[str]:
        for its in body:
            match its:
                case Set(target, value):
                    where = names.get(target.name) if isinstance(target, Var) else None
                    yield f"{indent}{where or self._expr(target)} := {self._expr(value)};"
                case If(test, then, other):
                    yield f"{indent}IF {self._expr(test)} THEN"
                    yield from self._statements(then, indent + "    ", names, f)
                    if other:
                        yield f"{indent}ELSE"
                        yield from self._statements(other, indent + "    ", names, f)
                    yield f"{indent}END_IF;"
                case For(counter, start, stop, _, inner):
                    last = Literal_(int(stop.value) - 1, "int") if isinstance(stop, Literal_) else None
                    end = self._expr(last) if last else f"{self._expr(stop)} - 1"
                    yield f"{indent}FOR {_name(counter.name)} := {self._expr(start)} TO {end} DO"
                    yield from self._statements(inner, indent + "    ", names, f)
                    yield f"{indent}END_FOR;"
                case Leave("return"):
                    if len(f.results) != 1:
                        yield f"{indent}{_named(f.name)} := TRUE;"
                    if its is not f.body[-1]:
                        yield f"{indent}RETURN;"
                case Leave("break"):
                    yield f"{indent}EXIT;"
                case Leave():
                    yield f"{indent}CONTINUE;"
                case Do(function, args, results):
                    done = _name(results[0].name) if len(results) == 1 else "done"
                    given = list(self._given(function, args))
                    if len(results) != 1:
                        pairs = zip(function.results, results, strict=True)
                        given += [f"{_name(inner.name)} => {_name(outer.name)}" for inner, outer in pairs]
                    yield f"{indent}{done} := {_named(function.name)}({', '.join(given)});"

    def _given(self, function: Function, args: Sequence[Expr | ArrayOf]) -> Iterator[str]:
        yield from (f"{name} := {name}" for name in self.structs if function.takes(name))
        for param, arg in zip(function.params, args, strict=True):
            if isinstance(param, ArrayOf) and param.struct:
                continue
            yield f"{_name(param.name)} := {self._place(arg) if isinstance(arg, ArrayOf) else self._expr(arg)}"

    def _place(self, array: ArrayOf) -> str:
        return f"{array.struct}.{_name(array.name)}" if array.struct else _name(array.name)

    def _inner(self, e: Expr) -> str:
        text = self._expr(e)
        return f"({text})" if isinstance(e, Op) and (e.name in _INFIX or e.name in ("neg", "not")) else text

    def _expr(self, e: Expr) -> str:
        match e:
            case Literal_(value, kind):
                return self._literal(value, kind)
            case Var(name):
                return _name(name)
            case Item(array, place):
                return f"{self._place(array)}[{self._expr(place)}]"
            case Op("neg", (a,)):
                return f"-{self._inner(a)}"
            case Op("not", (a,)):
                return f"NOT {self._inner(a)}"
            case Op("real", (a,)):
                return f"DINT_TO_{self.real}({self._expr(a)})"
            case Op("trunc", (a,)):
                return f"TRUNC({self._expr(a)})"
            case Op("%" | "//", (a, b), kind):
                what = "REMAINDER" if e.name == "%" else "QUOTIENT"
                return f"NNQL_{what}{'_INT' if kind == 'int' else ''}(x := {self._expr(a)}, y := {self._expr(b)})"
            case Op(name, (a, b)) if name in _INFIX:
                return f"{self._inner(a)} {_INFIX[name]} {self._inner(b)}"
            case Op(name, parts):
                args = [self._expr(a) for a in parts]
                if name not in _OWN:
                    return f"{_STANDARD[name]}({', '.join(args)})"
                letters = ("y", "x") if name == "atan2" else ("x", "y")
                given = (f"{x} := {arg}" for x, arg in zip(letters, args, strict=False))
                return f"NNQL_{name.upper()}({', '.join(given)})"

    def _literal(self, value: float | int | bool, kind: Kind) -> str:
        if kind == "bool":
            return "TRUE" if value else "FALSE"
        if kind == "int":
            return str(value) if value >= 0 else f"({value})"
        text = repr(float(value)) if self.real == "LREAL" else f"{float(value):.9g}"
        mantissa, e, exponent = text.partition("e")
        text = (mantissa if "." in mantissa else f"{mantissa}.0") + (f"E{int(exponent):+d}" if e else "")
        return f"({text})" if text.startswith("-") else text

    def _block_of(self, b: Block) -> Iterator[str]:
        """A block: it copies its inputs, because the function may change them, and calls the function."""
        yield f"(* {b.about} *)"
        yield f"FUNCTION_BLOCK {b.name}"
        yield from _section("VAR_INPUT", map(self._declared, b.inputs))
        yield from _section("VAR_OUTPUT", map(self._declared, b.outputs))
        kept = [f"    {name} : {its.type};" for name, its in self.structs.items()]
        copies = {its.name: f"own_{its.name}" for its in b.inputs if isinstance(its, ArrayOf)}
        kept += [f"    own_{its.name} : {self._array(its)};" for its in b.inputs if isinstance(its, ArrayOf)]
        yield from _section("VAR", [*kept, "    done : BOOL;"])
        yield from (f"    {copy} := {_name(name)};" for name, copy in copies.items())
        given = [f"{name} := {name}" for name in self.structs if b.function.takes(name)]
        for its in b.function.params:
            if not (isinstance(its, ArrayOf) and its.struct):
                plain = its.name.removesuffix("_in")
                given.append(f"{_name(its.name)} := {copies.get(plain, _name(plain))}")
        numbers = [its for its in b.outputs if isinstance(its, Var)]
        pairs = zip(b.function.results, numbers, strict=True)
        given += [f"{_name(inner.name)} => {_name(outer.name)}" for inner, outer in pairs]
        yield f"    done := {_named(b.function.name)}({', '.join(given)});"
        yield "END_FUNCTION_BLOCK"


def _section(title: str, lines: Iterator[str] | Sequence[str]) -> Iterator[str]:
    found = list(lines)
    if found:
        yield from (title, *found, "END_VAR")


def _name(name: str) -> str:
    return f"{name}_value" if name.upper() in _RESERVED else name


def _named(function: str) -> str:
    return f"NNQL_{function.upper()}_".rstrip("_")
