"""Translates kernels from Python into a small typed form, from which C and Structured Text are written.

What drives in this package and what is exported have one source: the kernels are read with `ast`, each for the types
and shapes that it is called with. They may use numbers, arrays of fixed shape, tuples, bounded loops, `if`, calls of
other kernels, and the functions of `_FUNCTIONS`. Constants are worked out while translating, and so are branches that
depend on them alone. An array that a kernel makes has its final shape; one that it returns is its caller's.

Infinity becomes `FAR`, and what is not a number `NOWHERE`: neither exists in Structured Text.
"""

import ast
import inspect
import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["real", "int", "bool"]
FAR, NOWHERE = 1e300, 1e150
"""Stand for infinity and for what is not a number; the square of the second is a number."""


@dataclass(frozen=True, slots=True)
class Literal_:
    """A number or truth value that is known."""

    value: float | int | bool
    kind: Kind


@dataclass(frozen=True, slots=True)
class Var:
    """A variable."""

    name: str
    kind: Kind


@dataclass(frozen=True, slots=True, eq=False)
class ArrayOf:
    """An array of fixed shape; its numbers lie row by row."""

    name: str
    shape: tuple[int, ...]
    kind: Kind
    values: NDArray[Any] | None = None
    """Of a constant one."""
    struct: str = ""
    """The structure that it is a member of, as functions call it."""

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return math.prod(self.shape)


@dataclass(frozen=True, slots=True)
class Struct:
    """A structure of arrays, which functions pass on as a whole."""

    name: str
    """What functions call it."""
    type: str
    members: tuple[ArrayOf, ...]


@dataclass(frozen=True, slots=True)
class Item:
    """A number of an array."""

    array: ArrayOf
    place: "Expr"

    @property
    def kind(self) -> Kind:
        """That of the array."""
        return self.array.kind


@dataclass(frozen=True, slots=True)
class Op:
    """An operator or a function of numbers, by its name in `_FUNCTIONS` or its sign."""

    name: str
    args: tuple["Expr", ...]
    kind: Kind


Expr = Literal_ | Var | Item | Op


@dataclass(frozen=True, slots=True)
class Set:
    """Gives a variable or a number of an array a value."""

    target: Var | Item
    value: Expr


@dataclass(frozen=True, slots=True)
class If:
    """A branch."""

    test: Expr
    then: list["Statement"]
    other: list["Statement"]


@dataclass(frozen=True, slots=True)
class For:
    """Counts from a number up to below another, at most so many times."""

    counter: Var
    start: Expr
    stop: Expr
    most: int
    body: list["Statement"]


@dataclass(frozen=True, slots=True)
class Leave:
    """Leaves a loop, begins its next round, or returns."""

    how: Literal["break", "continue", "return"]


@dataclass(frozen=True, slots=True)
class Do:
    """Calls a function; its results go into variables."""

    function: "Function"
    args: tuple[Expr | ArrayOf, ...]
    results: tuple[Var, ...]


Statement = Set | If | For | Leave | Do


@dataclass
class Function:
    """A kernel for given types and shapes."""

    name: str
    about: str
    params: list[Var | ArrayOf] = field(default_factory=list)
    results: list[Var] = field(default_factory=list)
    variables: dict[str, Kind] = field(default_factory=dict)
    arrays: list[ArrayOf] = field(default_factory=list)
    constants: list[ArrayOf] = field(default_factory=list)
    body: list[Statement] = field(default_factory=list)
    returned: tuple[Any, ...] = ()
    """What its last `return` gives: arrays, which are among the parameters, and numbers."""

    def statements(self) -> Iterator[Statement]:
        """All of them, also within others."""
        todo = list(self.body)
        while todo:
            its = todo.pop()
            yield its
            if isinstance(its, If):
                todo += [*its.then, *its.other]
            elif isinstance(its, For):
                todo += its.body

    def takes(self, struct: str) -> bool:
        """Whether members of a structure are among its parameters."""
        return any(isinstance(its, ArrayOf) and its.struct == struct for its in self.params)

    def written(self) -> set[tuple[str, str]]:
        """The arrays that it changes: their structures and names."""
        found = set()
        for its in self.statements():
            if isinstance(its, Set) and isinstance(its.target, Item):
                found.add((its.target.array.struct, its.target.array.name))
            elif isinstance(its, Do):
                changed = its.function.written()
                pairs = zip(its.function.params, its.args, strict=True)
                found |= {
                    (arg.struct, arg.name)
                    for param, arg in pairs
                    if isinstance(arg, ArrayOf) and isinstance(param, ArrayOf) and (param.struct, param.name) in changed
                }
        return found

    def deepest(self, size: Callable[["Function"], int]) -> int:
        """The largest sum of sizes of functions that are active at once, itself among them."""
        return size(self) + max(
            (its.function.deepest(size) for its in self.statements() if isinstance(its, Do)), default=0
        )


@dataclass(frozen=True, slots=True)
class Known:
    """A value that is known while translating: a number, an array, a module, a function."""

    value: Any


@dataclass(frozen=True, slots=True)
class Group:
    """Several values together, as in a tuple."""

    values: tuple["Value", ...]
    names: tuple[str, ...] = ()
    struct: str = ""
    """Of the members of a structure, what functions call it."""


def group_of(struct: Struct) -> Group:
    """A structure as an argument."""
    return Group(struct.members, tuple(its.name for its in struct.members), struct.name)


def struct_of(name: str, kind: str, arrays: Any) -> Struct:
    """A structure with a member for each array of a named tuple."""
    kinds: dict[str, Kind] = {"f": "real", "i": "int", "b": "bool"}
    members = (
        ArrayOf(field, its.shape, kinds[its.dtype.kind], struct=name)
        for field, its in zip(arrays._fields, arrays, strict=True)
    )
    return Struct(name, kind, tuple(members))


Value = Known | Group | ArrayOf | Literal_ | Var | Item | Op


class NotTranslatable(Exception):
    """A kernel uses what has no counterpart; says where."""


_REAL: dict[Any, str] = {
    **dict.fromkeys((np.cos, math.cos), "cos"),
    **dict.fromkeys((np.sin, math.sin), "sin"),
    **dict.fromkeys((np.sqrt, math.sqrt), "sqrt"),
    **dict.fromkeys((np.exp, math.exp), "exp"),
    **dict.fromkeys((np.arctan2, math.atan2), "atan2"),
    **dict.fromkeys((np.hypot, math.hypot), "hypot"),
    **dict.fromkeys((np.floor,), "floor"),
    **dict.fromkeys((np.ceil,), "ceil"),
    **dict.fromkeys((np.rint,), "rint"),
    math.copysign: "copysign",
}
_EITHER: dict[Any, str] = {
    **dict.fromkeys((min, np.minimum), "min"),
    **dict.fromkeys((max, np.maximum), "max"),
    **dict.fromkeys((abs, np.abs), "abs"),
}
_SIGNS: dict[type, str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%"}
_COMPARED: dict[type, str] = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_WORKED_OUT: dict[str, Callable[..., Any]] = {
    **{"+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b},
    **{"//": lambda a, b: a // b, "%": lambda a, b: a % b},
    **{"<": lambda a, b: a < b, "<=": lambda a, b: a <= b, ">": lambda a, b: a > b, ">=": lambda a, b: a >= b},
    **{"==": lambda a, b: a == b, "!=": lambda a, b: a != b},
}


class Translator:
    """Translates kernels, each once for the same types and shapes; those that are called come first."""

    def __init__(self) -> None:
        self.functions: list[Function] = []
        self._known: dict[Any, Function] = {}
        self._names: dict[str, int] = {}

    def translate(self, kernel: Callable[..., Any], *args: Value) -> Function:
        """A kernel for arguments of these types and shapes, or with these constants.

        Raises:
            NotTranslatable: If it uses what has no counterpart.
        """
        plain = getattr(kernel, "py_func", kernel)
        key = (plain, *map(_key, args))
        if key not in self._known:
            name = plain.__name__.lstrip("_")
            self._names[name] = self._names.get(name, 0) + 1
            number = self._names[name]
            made = _Kernel(self, plain, name if number == 1 else f"{name}_{number}", args).function
            self._known[key] = made
            self.functions.append(made)
        return self._known[key]


def _key(value: Value) -> Any:
    match value:
        case Known(its) if isinstance(its, float):
            return "real"
        case Known(its) if isinstance(its, np.ndarray):
            return ("constants", its.shape, its.tobytes())
        case Known(its):
            return ("known", id(its) if isinstance(its, tuple) else its)
        case Group(values, _, struct):
            return (struct, *map(_key, values))
        case ArrayOf(_, shape, kind):
            return (shape, kind)
        case _:
            return value.kind


class _Kernel:
    """One kernel while it is translated."""

    def __init__(self, owner: Translator, kernel: Callable[..., Any], name: str, args: Sequence[Value]) -> None:
        self._owner, self._kernel = owner, kernel
        self._globals = kernel.__globals__
        tree = ast.parse(textwrap.dedent(inspect.getsource(kernel))).body[0]
        if not isinstance(tree, ast.FunctionDef):
            raise NotTranslatable(f"{name} is not a function")
        self._stores: dict[str, int] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                self._stores[node.id] = self._stores.get(node.id, 0) + 1
            elif isinstance(node, ast.For):  # assigned at every round
                for target in ast.walk(node.target):
                    if isinstance(target, ast.Name):
                        self._stores[target.id] = 2
        about = (ast.get_docstring(tree) or "").partition("\n")[0].replace("`", "'")
        self.function = Function(name, about)
        self._env: dict[str, Value] = {}
        self._out = self.function.body
        self._temporaries, self._array_name = 0, ""
        names = [arg.arg for arg in tree.args.args]
        if len(args) != len(names):
            raise NotTranslatable(f"{name} takes {len(names)} arguments")
        for arg, value in zip(names, args, strict=True):
            self._env[arg] = self._parameter(arg, value)
        self._block(tree.body)
        if not self.function.body or not isinstance(self.function.body[-1], Leave):
            self.function.body.append(Leave("return"))

    def _parameter(self, name: str, value: Value) -> Value:
        match value:
            case Group(values, names, struct) if struct:
                arrays = [its for its in values if isinstance(its, ArrayOf)]
                members = tuple(ArrayOf(its.name, its.shape, its.kind, struct=name) for its in arrays)
                self.function.params += members
                return Group(members, names, name)
            case Group(values, names):
                inner = names or tuple(map(str, range(len(values))))
                its = (self._parameter(f"{name}_{one}", v) for one, v in zip(inner, values, strict=True))
                return Group(tuple(its), names)
            case Known(its) if not isinstance(its, float):
                return value
            case ArrayOf(_, shape, its_kind):
                array = ArrayOf(name, shape, its_kind)
                self.function.params.append(array)
                return array
            case _:
                kind: Kind = "real" if isinstance(value, Known) else value.kind
                changes = name in self._stores
                param = Var(f"{name}_in" if changes else name, kind)
                self.function.params.append(param)
                if changes:
                    self._set(name, param)
                    return Var(name, kind)
                return param

    # Statements

    def _block(self, body: Sequence[ast.stmt]) -> None:
        for statement in body:
            self._statement(statement)

    def _within(self, body: Sequence[ast.stmt]) -> list[Statement]:
        """The statements of an inner block."""
        outer, self._out = self._out, []
        self._block(body)
        inner, self._out = self._out, outer
        return inner

    def _statement(self, s: ast.stmt) -> None:
        match s:
            case ast.Expr(ast.Constant()) | ast.Pass():
                pass
            case ast.Expr(ast.Call() as call):
                self._value(call)
            case ast.Assign(targets, value):
                its = self._new(targets[0], value)
                its = its if len(targets) == 1 else self._kept(its)
                for target in targets:
                    self._assign(target, its)
            case ast.AnnAssign(target, _, value) if value is not None:
                self._assign(target, self._value(value))
            case ast.AugAssign(target, op, value):
                read = ast.parse(ast.unparse(target), mode="eval").body
                self._assign(target, self._binary(op, self._value(read), self._value(value)))
            case ast.If(test, body, orelse):
                self._branch(self._value(test), body, orelse)
            case ast.For(target, each, body, []):
                self._loop(target, each, body)
            case ast.Break():
                self._out.append(Leave("break"))
            case ast.Continue():
                self._out.append(Leave("continue"))
            case ast.Return(value):
                self._return(value)
            case _:
                self._refuse(s)

    def _refuse(self, node: ast.AST) -> None:
        raise NotTranslatable(f"{self._kernel.__name__}: {ast.unparse(node)}")

    def _assign(self, target: ast.expr, value: Value) -> None:
        match target:
            case ast.Name("_"):
                pass
            case ast.Name(name):
                if (
                    isinstance(value, (Group, ArrayOf))
                    or (isinstance(value, Known) and not _is_number(value.value))
                    or (isinstance(value, Known) and self._stores.get(name) == 1)
                ):
                    self._env[name] = value
                else:
                    self._set(name, _expr(value))
            case ast.Tuple(targets) if isinstance(value, (Group, Known)):
                values = value.values if isinstance(value, Group) else tuple(map(Known, value.value))
                if len(targets) != len(values):
                    self._refuse(target)
                given = {its.id for its in targets if isinstance(its, ast.Name)}
                plain = len(given) == len(targets)
                kept = [values[0]] if plain else []  # set before the others are
                kept += [
                    its if plain and not _reads_any(its, given) else self._kept(its) for its in values[len(kept) :]
                ]
                for one, its in zip(targets, kept, strict=True):
                    self._assign(one, its)
            case ast.Subscript(of, place):
                array = self._value(of)
                if not isinstance(array, ArrayOf):
                    self._refuse(target)
                    return
                if isinstance(value, Group):
                    places = [self._value(place)]
                    for column, its in enumerate(value.values):
                        self._out.append(
                            Set(Item(array, self._flat(array, [*places, Known(column)])), self._as(its, array.kind))
                        )
                else:
                    index = self._flat(array, self._indices(place))
                    self._out.append(Set(Item(array, index), self._as(value, array.kind)))
            case _:
                self._refuse(target)

    def _new(self, target: ast.expr, value: ast.expr) -> Value:
        """The value of an assignment; arrays that it makes are called like their target."""
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
            pairs = zip(target.elts, value.elts, strict=True)
            return Group(tuple(self._new(its, one) for its, one in pairs))
        self._array_name = target.id if isinstance(target, ast.Name) and self._stores[target.id] == 1 else ""
        found = self._value(value)
        self._array_name = ""
        return found

    def _new_array(self, shape: tuple[int, ...], kind: Kind) -> ArrayOf:
        name, self._array_name = self._array_name, ""
        if not name:
            self._temporaries += 1
        array = ArrayOf(name or f"a{self._temporaries}", shape, kind)
        self.function.arrays.append(array)
        return array

    def _kept(self, value: Value) -> Value:
        """A value that later assignments do not change."""
        if isinstance(value, (Known, Group, ArrayOf)) or not _reads(value):
            return value
        its = _expr(value)
        return self._temporary(its)

    def _set(self, name: str, value: Expr) -> None:
        kind = self.function.variables.setdefault(name, value.kind)
        self._env[name] = Var(name, kind)
        last = self._out[-1] if self._out else None
        if (
            isinstance(last, Do)
            and value in last.results
            and value.kind == kind
            and Var(name, kind) not in last.results
        ):
            results = tuple(Var(name, kind) if its == value else its for its in last.results)
            self._out[-1] = Do(last.function, last.args, results)
            del self.function.variables[value.name]
            return
        self._out.append(Set(Var(name, kind), self._as(value, kind)))

    def _temporary(self, value: Expr) -> Var:
        self._temporaries += 1
        name = f"t{self._temporaries}"
        self.function.variables[name] = value.kind
        self._out.append(Set(Var(name, value.kind), value))
        return Var(name, value.kind)

    def _branch(self, test: Value, body: Sequence[ast.stmt], orelse: Sequence[ast.stmt]) -> None:
        if isinstance(test, Known):
            self._block(body if test.value else orelse)
            return
        then, other = self._within(body), self._within(orelse)
        self._out.append(If(_expr(test), then, other))

    def _loop(self, target: ast.expr, each: ast.expr, body: Sequence[ast.stmt]) -> None:
        match each:
            case ast.Call(ast.Name("range"), args):
                bounds = [self._value(arg) for arg in args]
                start, stop = (Known(0), bounds[0]) if len(bounds) == 1 else (bounds[0], bounds[1])
                self._count(target, start, stop, self._most(args[-1], start, stop), lambda _: self._block(body))
            case ast.Call(ast.Name("enumerate"), [over]) if isinstance(target, ast.Tuple):
                array, (counter, one) = self._value(over), target.elts
                size = _length(array)

                def each_one(place: Var) -> None:
                    self._assign(one, self._item(array, [place]))
                    self._block(body)

                self._count(counter, Known(0), Known(size), size, each_one)
            case ast.Tuple(values):
                for its in values:
                    self._assign(target, self._value(its))
                    self._block(body)
            case _:
                self._refuse(each)

    def _most(self, stop: ast.expr, first: Value, end: Value) -> int:
        """How often a loop is gone through at most: a known end, or the known one of `min`."""
        least = first.value if isinstance(first, Known) else 0
        if isinstance(end, Known):
            return max(int(end.value) - least, 0)
        if isinstance(stop, ast.Call) and isinstance(stop.func, ast.Name) and stop.func.id == "min":
            known = [its.value for its in map(self._value, stop.args) if isinstance(its, Known)]
            if known:
                return int(min(known)) - int(least)
        raise NotTranslatable(f"{self._kernel.__name__}: a loop without a bound: {ast.unparse(stop)}")

    def _count(self, target: ast.expr, start: Value, stop: Value, most: int, body: Callable[[Var], None]) -> None:
        if not isinstance(target, ast.Name):
            self._refuse(target)
            return
        if isinstance(stop, Known) and isinstance(start, Known) and stop.value <= start.value:
            return
        name = "unused" if target.id == "_" else target.id
        self.function.variables.setdefault(name, "int")
        counter = Var(name, "int")
        self._env[target.id] = counter
        end = _expr(stop)
        if not isinstance(end, Literal_):
            end = self._temporary(end)
        outer, self._out = self._out, []
        body(counter)
        inner, self._out = self._out, outer
        self._out.append(For(counter, _expr(start), end, most, inner))

    def _return(self, value: ast.expr | None) -> None:
        its = None if value is None else self._value(value)
        if its is not None:
            parts = its.values if isinstance(its, Group) else (its,)
            number = 0
            kept = [self._kept(part) for part in parts] if len(parts) > 1 else list(parts)
            for part in kept:
                if isinstance(part, ArrayOf):
                    if part in self.function.arrays:
                        self.function.arrays.remove(part)
                        self.function.params.append(part)
                    continue
                expr = _expr(part)
                if number == len(self.function.results):
                    self.function.results.append(Var(f"result_{number + 1}", expr.kind))
                result = self.function.results[number]
                self._out.append(Set(result, self._as(expr, result.kind)))
                number += 1
            self.function.returned = tuple(parts)
        self._out.append(Leave("return"))

    # Expressions

    def _value(self, e: ast.expr) -> Value:
        match e:
            case ast.Constant(value):
                return Known(value)
            case ast.Name(name):
                return self._named(name)
            case ast.Attribute(of, name):
                return self._attribute(self._value(of), name)
            case ast.Tuple(values):
                return Group(tuple(self._value(its) for its in values))
            case ast.Subscript(of, place):
                return self._item(self._value(of), self._indices(place))
            case ast.BinOp(left, op, right):
                return self._binary(op, self._value(left), self._value(right))
            case ast.UnaryOp(op, operand):
                return self._unary(op, self._value(operand))
            case ast.BoolOp(op, values):
                return self._logical(isinstance(op, ast.And), values)
            case ast.Compare(left, ops, rights):
                return self._compared(left, ops, rights)
            case ast.IfExp(test, body, orelse):
                return self._either(self._value(test), body, orelse)
            case ast.Call(function, args, keywords):
                return self._call(e, self._value(function), args, keywords)
            case _:
                raise NotTranslatable(f"{self._kernel.__name__}: {ast.unparse(e)}")

    def _named(self, name: str) -> Value:
        if name in self._env:
            return self._env[name]
        if name in self._globals:
            return Known(self._globals[name])
        if name in self._globals["__builtins__"]:
            return Known(self._globals["__builtins__"][name])
        raise NotTranslatable(f"{self._kernel.__name__}: {name} is not set")

    def _attribute(self, of: Value, name: str) -> Value:
        match of:
            case Known(its):
                return Known(getattr(its, name))
            case Group(values, names) if name in names:
                return values[names.index(name)]
            case ArrayOf(_, shape) if name == "shape":
                return Known(shape)
        raise NotTranslatable(f"{self._kernel.__name__}: .{name}")

    def _indices(self, place: ast.expr) -> list[Value]:
        value = self._value(place)
        return list(value.values) if isinstance(value, Group) else [value]

    def _item(self, of: Value, places: list[Value]) -> Value:
        match of:
            case Group(values) if isinstance(places[0], Known):
                chosen: Value = values[places[0].value]
                return chosen
            case Known(its):
                if all(isinstance(place, Known) for place in places):
                    index = tuple(place.value for place in places if isinstance(place, Known))
                    found = its[index if len(index) > 1 else index[0]]
                    return Known(found.item() if isinstance(found, np.generic) else found)
                return self._item(self._constant(np.asarray(its)), places)
            case ArrayOf():
                return Item(of, self._flat(of, places))
        raise NotTranslatable(f"{self._kernel.__name__}: an index")

    def _constant(self, values: NDArray[Any]) -> ArrayOf:
        """A table in the source."""
        for its in self.function.constants:
            if its.values is not None and its.shape == values.shape and (its.values == values).all():
                return its
        kinds: dict[str, Kind] = {"f": "real", "i": "int", "b": "bool"}
        name = f"table_{len(self.function.constants) + 1}"
        made = ArrayOf(name, values.shape, kinds[values.dtype.kind], values)
        self.function.constants.append(made)
        return made

    def _flat(self, array: ArrayOf, places: list[Value]) -> Expr:
        """Where a number lies among all numbers of an array."""
        if len(places) != len(array.shape):
            raise NotTranslatable(f"{self._kernel.__name__}: {array.name} has {len(array.shape)} axes")
        flat: Value = Known(0)
        for size, place in zip(array.shape, places, strict=True):
            if isinstance(place, Known) and place.value < 0:
                place = Known(size + place.value)
            flat = self._arithmetic("+", self._arithmetic("*", flat, Known(size)), place)
        return _expr(flat)

    def _binary(self, op: ast.operator, left: Value, right: Value) -> Value:
        if isinstance(op, ast.Pow):
            if isinstance(left, Known) and isinstance(right, Known):
                return Known(left.value**right.value)
            if isinstance(right, Known) and right.value == 2:
                its = _expr(left)
                once = its if isinstance(its, (Var, Literal_)) else self._temporary(its)
                return Op("*", (once, once), "real")
        sign = _SIGNS.get(type(op))
        if sign is None:
            raise NotTranslatable(f"{self._kernel.__name__}: {type(op).__name__}")
        return self._arithmetic(sign, left, right)

    def _arithmetic(self, sign: str, left: Value, right: Value) -> Value:
        if isinstance(left, Known) and isinstance(right, Known):
            return Known(_WORKED_OUT[sign](left.value, right.value))
        if sign == "+" and isinstance(left, Known) and isinstance(left.value, int) and left.value == 0:
            return right
        if isinstance(left, Known) and isinstance(left.value, int) and left.value == 0 and sign == "*":
            return Known(0)
        if sign == "*" and isinstance(right, Known) and isinstance(right.value, int) and right.value == 1:
            return left
        if sign == "+" and isinstance(right, Known) and isinstance(right.value, int) and right.value == 0:
            return left
        a, b = _expr(left), _expr(right)
        kind: Kind = "real" if sign == "/" or "real" in (a.kind, b.kind) else "int"
        return Op(sign, (self._as(a, kind), self._as(b, kind)), kind)

    def _unary(self, op: ast.unaryop, value: Value) -> Value:
        if isinstance(value, Known):
            return Known(not value.value if isinstance(op, ast.Not) else -value.value)
        its = _expr(value)
        if isinstance(op, ast.Not):
            return Op("not", (its,), "bool")
        if isinstance(op, ast.USub):
            return Op("neg", (its,), its.kind)
        raise NotTranslatable(f"{self._kernel.__name__}: {type(op).__name__}")

    def _logical(self, both: bool, values: Sequence[ast.expr]) -> Value:
        """`and` or `or`: the second is asked only if the first does not decide."""
        left = self._value(values[0])
        for node in values[1:]:
            if isinstance(left, Known):
                if bool(left.value) != both:
                    return left
                left = self._value(node)
                continue
            outer, self._out = self._out, []
            right = self._value(node)
            before, self._out = self._out, outer
            if isinstance(right, Known):
                left = left if bool(right.value) == both else right
            elif before or _may_fail(_expr(right)):
                kept = self._temporary(_expr(left))
                inner: list[Statement] = [*before, Set(kept, _expr(right))]
                test: Expr = kept if both else Op("not", (kept,), "bool")
                self._out.append(If(test, inner, []))
                left = kept
            else:
                left = Op("and" if both else "or", (_expr(left), _expr(right)), "bool")
        return left

    def _compared(self, left: ast.expr, ops: Sequence[ast.cmpop], rights: Sequence[ast.expr]) -> Value:
        values = [self._value(its) for its in (left, *rights)]
        found: Value | None = None
        for a, op, b in zip(values, ops, values[1:], strict=False):
            sign = _COMPARED[type(op)]
            if isinstance(a, Known) and isinstance(b, Known):
                one: Value = Known(_WORKED_OUT[sign](a.value, b.value))
            else:
                x, y = _expr(a), _expr(b)
                kind: Kind = "real" if "real" in (x.kind, y.kind) else x.kind
                one = Op(sign, (self._as(x, kind), self._as(y, kind)), "bool")
            found = one if found is None else Op("and", (_expr(found), _expr(one)), "bool")
        return found or Known(True)

    def _either(self, test: Value, body: ast.expr, orelse: ast.expr) -> Value:
        if isinstance(test, Known):
            return self._value(body if test.value else orelse)
        outer = self._out
        then: list[Statement] = []
        other: list[Statement] = []
        self._out = then
        first = _expr(self._value(body))
        self._out = other
        second = _expr(self._value(orelse))
        self._out = outer
        kind: Kind = "real" if "real" in (first.kind, second.kind) else first.kind
        self._temporaries += 1
        chosen = Var(f"t{self._temporaries}", kind)
        self.function.variables[chosen.name] = kind
        then.append(Set(chosen, self._as(first, kind)))
        other.append(Set(chosen, self._as(second, kind)))
        self._out.append(If(_expr(test), then, other))
        return chosen

    def _call(self, e: ast.expr, function: Value, args: Sequence[ast.expr], keywords: Sequence[ast.keyword]) -> Value:
        if not isinstance(function, Known):
            raise NotTranslatable(f"{self._kernel.__name__}: {ast.unparse(e)}")
        its = function.value
        if its in (np.zeros, np.empty, np.full):
            return self._made(its, args)
        values = [self._value(arg) for arg in args]
        if its is len:
            return Known(_length(values[0]))
        if its in (int, float, bool) or its in _REAL or its in _EITHER or its is np.isnan:
            return self._function(its, values)
        if inspect.isclass(its) and hasattr(its, "_fields"):
            return Group(tuple(values), its._fields)
        inner = its if hasattr(its, "py_func") or inspect.isfunction(its) else None
        if inner is None or keywords:
            raise NotTranslatable(f"{self._kernel.__name__}: {ast.unparse(e)}")
        return self._called(inner, values)

    def _function(self, its: Any, values: list[Value]) -> Value:
        if all(isinstance(value, Known) for value in values):
            found = its(*(value.value for value in values if isinstance(value, Known)))
            return Known(found.item() if isinstance(found, np.generic) else found)
        exprs = [_expr(value) for value in values]
        if its is bool:
            return exprs[0]
        if its is float:
            return self._as(exprs[0], "real")
        if its is int:
            return exprs[0] if exprs[0].kind == "int" else Op("trunc", (exprs[0],), "int")
        if its is np.isnan:
            return Op(">=", (exprs[0], Literal_(NOWHERE, "real")), "bool")
        if its in _REAL:
            return Op(_REAL[its], tuple(self._as(x, "real") for x in exprs), "real")
        kind: Kind = "real" if any(x.kind == "real" for x in exprs) else "int"
        exprs = [self._as(x, kind) for x in exprs]
        name = _EITHER[its]
        if name == "abs":
            return Op(name, (exprs[0],), kind)
        return reduce(lambda a, b: Op(name, (a, b), kind), exprs)

    def _made(self, how: Any, args: Sequence[ast.expr]) -> ArrayOf:
        """A new array, filled if it is to be."""
        values = [self._value(arg) for arg in args]
        sizes = values[0].values if isinstance(values[0], Group) else (values[0],)
        shape = tuple(int(its.value) for its in sizes if isinstance(its, Known))
        if len(shape) < len(sizes):
            raise NotTranslatable(f"{self._kernel.__name__}: an array of no fixed shape")
        kinds: dict[Any, Kind] = {np.bool_: "bool", np.int64: "int"}
        asked = values[-1].value if isinstance(values[-1], Known) and len(values) > 1 else None
        kind: Kind = kinds.get(asked, "real") if isinstance(asked, type) else "real"
        array = self._new_array(shape, kind)
        if how is not np.empty:
            fill = self._as(values[1], kind) if how is np.full else self._as(Known(kind == "real" and 0.0), kind)
            self.function.variables.setdefault("fill", "int")
            place = Var("fill", "int")
            self._out.append(
                For(place, Literal_(0, "int"), Literal_(array.size, "int"), array.size, [Set(Item(array, place), fill)])
            )
        return array

    def _called(self, kernel: Callable[..., Any], values: list[Value]) -> Value:
        function = self._owner.translate(kernel, *values)
        given: list[Expr | ArrayOf] = []
        for value in values:
            given += list(self._passed(value))
        results: list[Var] = []
        arrays: list[ArrayOf] = []
        back: list[Value] = []
        for part in function.returned:
            if isinstance(part, ArrayOf):
                array = self._new_array(part.shape, part.kind)
                arrays.append(array)
                back.append(array)
            else:
                self._temporaries += 1
                kind = function.results[len(results)].kind
                one = Var(f"t{self._temporaries}", kind)
                self.function.variables[one.name] = kind
                results.append(one)
                back.append(one)
        self._out.append(Do(function, (*given, *arrays), tuple(results)))
        return back[0] if len(back) == 1 else Group(tuple(back))

    def _passed(self, value: Value) -> Iterator[Expr | ArrayOf]:
        match value:
            case Group(values):
                for its in values:
                    yield from self._passed(its)
            case ArrayOf():
                yield value
            case Known(its) if not isinstance(its, float):
                return
            case _:
                yield _expr(value)

    def _as(self, value: Value, kind: Kind) -> Expr:
        """An expression as one of a kind."""
        its = _expr(value)
        if its.kind == kind:
            return its
        if kind == "real":
            return Literal_(float(its.value), "real") if isinstance(its, Literal_) else Op("real", (its,), "real")
        raise NotTranslatable(f"{self._kernel.__name__}: a {its.kind} where a {kind} is wanted: {its}")


def _is_number(value: object) -> bool:
    return isinstance(value, (bool, int, float, np.generic))


def _expr(value: Value) -> Expr:
    if isinstance(value, (Group, ArrayOf)):
        raise NotTranslatable(f"an array or a tuple where a number is wanted: {value}")
    if not isinstance(value, Known):
        return value
    its = value.value
    if isinstance(its, (bool, np.bool_)):
        return Literal_(bool(its), "bool")
    if isinstance(its, (int, np.integer)):
        return Literal_(int(its), "int")
    if not isinstance(its, float):
        raise NotTranslatable(f"{its!r} where a number is wanted")
    number = NOWHERE if math.isnan(its) else math.copysign(FAR, its) if math.isinf(its) else float(its)
    return Literal_(number, "real")


def _length(value: Value) -> int:
    match value:
        case ArrayOf(_, shape):
            return shape[0]
        case Group(values):
            return len(values)
        case Known(its):
            return len(its)
    raise NotTranslatable("the length of a number")


def _reads(e: Any) -> bool:
    """Whether an expression depends on variables or arrays."""
    return isinstance(e, (Var, Item)) or (isinstance(e, Op) and any(map(_reads, e.args)))


def _reads_any(e: Any, names: set[str]) -> bool:
    """Whether an expression depends on one of these variables."""
    if isinstance(e, Item):
        return _reads_any(e.place, names)
    return (isinstance(e, Var) and e.name in names) or (isinstance(e, Op) and any(_reads_any(a, names) for a in e.args))


def _may_fail(e: Expr) -> bool:
    """Whether an expression may have no value, for some of its variables."""
    if isinstance(e, Op):
        return e.name in ("/", "sqrt", "//", "%") or any(map(_may_fail, e.args))
    return False
