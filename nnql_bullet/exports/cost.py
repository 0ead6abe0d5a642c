"""What a decision of an exported policy takes in the worst case: operations and stack."""

from dataclasses import dataclass, fields

from nnql_bullet.exports.translation import Do, Expr, For, Function, If, Item, Kind, Leave, Op, Set, Statement


@dataclass(frozen=True, slots=True)
class Operations:
    """Arithmetic of a decision in the worst case: operations on numbers that are not whole."""

    additions: int = 0
    """Also subtractions and changes of sign."""
    multiplications: int = 0
    divisions: int = 0
    comparisons: int = 0
    """Also smaller or larger of two, and absolute values."""
    functions: int = 0
    """Calls of exponential, root, rounding and trigonometric functions."""

    def __add__(self, other: "Operations") -> "Operations":
        return Operations(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def __rmul__(self, times: int) -> "Operations":
        return Operations(*(times * getattr(self, f.name) for f in fields(self)))

    def larger(self, other: "Operations") -> "Operations":
        """The larger number of each kind."""
        return Operations(*(max(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)))

    def text(self) -> str:
        """In words."""
        return ", ".join(f"{getattr(self, f.name)} {f.name}" for f in fields(self))


FRAME = 128
"""Stack that a call takes beside its arrays, generously: variables, saved registers, return address [bytes]."""


@dataclass(frozen=True, slots=True)
class Cost:
    """What a decision takes in the worst case."""

    operations: Operations
    stack: int
    """Of its deepest calls together [bytes]."""

    def text(self) -> str:
        """In words."""
        return f"{self.operations.text()}; {self.stack} bytes of stack"


BYTES: dict[Kind, int] = {"real": 8, "int": 4, "bool": 1}
"""Of a number of each kind in an array."""
_COUNTED = {
    **dict.fromkeys(("+", "-", "neg"), "additions"),
    **dict.fromkeys(("<", "<=", ">", ">=", "==", "!=", "min", "max", "abs"), "comparisons"),
    **{"*": "multiplications", "/": "divisions"},
}


def cost_of(function: Function) -> Cost:
    """What a call of a translated function takes at most.

    Of a branch, the larger number of each kind of operation counts, and what follows one that leaves counts for the
    other alone; every loop is gone through as often as it can be.
    """
    return Cost(_operations(function.body, {}), function.deepest(_frame))


def _frame(f: Function) -> int:
    numbers = 8 * (len(f.variables) + len(f.results) + len(f.params))
    return FRAME + numbers + sum(BYTES[its.kind] * its.size for its in f.arrays)


def _operations(body: list[Statement], known: dict[int, Operations]) -> Operations:
    total = Operations()
    for place, its in enumerate(body, 1):
        match its:
            case Set(target, value):
                total += _of(value) + (_of(target.place) if isinstance(target, Item) else Operations())
            case If(test, then, other):
                ways = [_operations(way, known) for way in (then, other)]
                leave = [bool(way) and isinstance(way[-1], Leave) for way in (then, other)]
                if any(leave):
                    rest = _operations(body[place:], known)
                    ways = [way if leaves else way + rest for way, leaves in zip(ways, leave, strict=True)]
                total += _of(test) + ways[0].larger(ways[1])
                if any(leave):
                    return total
            case For(_, start, stop, most, inner):
                total += _of(start) + _of(stop) + most * _operations(inner, known)
            case Do(function, args, _):
                if id(function) not in known:
                    known[id(function)] = _operations(function.body, known)
                total += known[id(function)]
                for arg in args:
                    total += _of(arg) if isinstance(arg, (Item, Op)) else Operations()
    return total


def _of(e: Expr) -> Operations:
    """Of an expression; whole numbers are not counted."""
    if isinstance(e, Item):
        return _of(e.place)
    if not isinstance(e, Op):
        return Operations()
    total = Operations()
    for arg in e.args:
        total += _of(arg)
    if not any(arg.kind == "real" for arg in e.args):
        return total
    return total + Operations(**{_COUNTED.get(e.name, "functions"): 1})
