"""Runs Structured Text: a parser of the subset that exports are written in, by the standard's grammar, to C.

It shares nothing with what writes the text. `AND` and `OR` ask both sides, and every index is checked.
"""

import ctypes
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

TOKEN = re.compile(
    r"\(\*.*?\*\)|\s+|(\d+\.\d+(?:E[+-]?\d+)?|\d+(?!\.\d)|[A-Za-z_]\w*|:=|=>|<=|>=|<>|\.\.|[-+*/()\[\],;:.<>=])", re.S
)
TYPES = {"REAL": "float", "LREAL": "double", "DINT": "int", "BOOL": "int"}
BY_C = {"float": np.float32, "double": np.float64, "int": np.int32}
LEVELS = ({"OR"}, {"AND"}, {"=", "<>"}, {"<", ">", "<=", ">="}, {"+", "-"}, {"*", "/", "MOD"})
SIGNS = {"OR": "|", "AND": "&", "=": "==", "<>": "!=", "MOD": "%"}
MATH = {"SQRT": "sqrt", "SIN": "sin", "COS": "cos", "EXP": "exp", "ATAN": "atan"}
PRELUDE = """#include <math.h>
#include <stdlib.h>
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define ABS(a) ((a) < 0 ? -(a) : (a))
static int at(int place, int size) { if (place < 0 || place >= size) abort(); return place; }
static int trunc_to_int(double x) { if (!(fabs(x) < 2147483647.0)) abort(); return (int)x; }
"""


class Compiler:
    """Compiles a text to C."""

    def __init__(self, text: str) -> None:
        self.tokens = [its for its in TOKEN.findall(text) if its]
        assert not TOKEN.sub("", text), TOKEN.sub("", text)[:40]
        self.place = 0
        self.single = "LREAL" not in self.tokens
        self.sizes: dict[str, int] = {}
        self.elements: dict[str, str] = {}
        self.structs: dict[str, dict[str, str]] = {}
        self.functions: dict[str, list[tuple[str, str, str]]] = {}
        self.blocks: dict[str, list[tuple[str, str]]] = {}
        self.out: list[str] = [PRELUDE]
        while self.place < len(self.tokens):
            {"TYPE": self.type, "FUNCTION": self.function, "FUNCTION_BLOCK": self.block}[self.take()]()

    def peek(self) -> str:
        return self.tokens[self.place]

    def take(self, *wanted: str) -> str:
        token = self.tokens[self.place]
        assert not wanted or token in wanted, (wanted, self.tokens[self.place - 5 : self.place + 5])
        self.place += 1
        return token

    def type(self) -> None:
        name = self.take()
        self.take(":")
        if self.peek() == "STRUCT":
            self.take()
            members = {}
            while self.peek() != "END_STRUCT":
                member = self.take()
                self.take(":")
                members[member] = self.take()
                self.take(";")
            self.take("END_STRUCT")
            self.structs[name] = members
            self.out.append(f"typedef struct {{ {' '.join(f'{t} {n};' for n, t in members.items())} }} {name};")
        else:
            self.sizes[name], self.elements[name] = self.array()
            self.out.append(f"typedef {self.elements[name]} {name}[{self.sizes[name]}];")
        self.take(";")
        self.take("END_TYPE")

    def array(self) -> tuple[int, str]:
        self.take("ARRAY")
        self.take("[")
        self.take("0")
        self.take("..")
        size = int(self.take()) + 1
        self.take("]")
        self.take("OF")
        return size, TYPES[self.take()]

    def sections(self) -> list[tuple[str, str, str, str]]:
        """Variables: section, name, type, value."""
        found = []
        while self.peek().startswith("VAR"):
            section = self.take()
            if self.peek() == "CONSTANT":
                section = self.take()
            while self.peek() != "END_VAR":
                name = self.take()
                self.take(":")
                value = ""
                if self.peek() == "ARRAY":
                    size, kind = self.array()
                    kind = f"{kind} {size}"
                    self.take(":=")
                    self.take("[")
                    while self.peek() != "]":
                        token = self.take()
                        value += {"TRUE": "1", "FALSE": "0"}.get(token, token)
                    self.take("]")
                else:
                    kind = self.take()
                self.take(";")
                found.append((section, name, kind, value))
            self.take("END_VAR")
        return found

    def function(self) -> None:
        self.name = self.take()
        self.take(":")
        result = TYPES[self.take()]
        variables = self.sections()
        order = ("VAR_INPUT", "VAR_IN_OUT", "VAR_OUTPUT")
        params = [(s, n, t) for section in order for s, n, t, _ in variables if s == section]
        self.functions[self.name] = params
        self.types, self.written = {}, {}
        for section, name, kind, _ in variables:
            self.types[name] = kind
            pointer = section == "VAR_OUTPUT" or (section == "VAR_IN_OUT" and kind in self.structs)
            self.written[name] = f"(*{name})" if pointer else name
        self.types[self.name], self.written[self.name] = "", "result__"
        signature = [f"{self.c(t)} {'*' if self.written[n] != n else ''}{n}" for _, n, t in params]
        self.out.append(f"static {result} {self.name}({', '.join(signature) or 'void'})\n{{\n{result} result__ = 0;")
        for section, name, kind, value in variables:
            if section == "CONSTANT":
                of, size = kind.split()
                self.out.append(f"static const {of} {name}[{size}] = {{ {value} }};")
            elif section == "VAR":
                self.out.append(f"{self.c(kind)} {name}{' = 0' if kind in TYPES else ''};")
        self.statements("END_FUNCTION")
        self.out.append("return result__;\n}")

    def block(self) -> None:
        self.name = self.take()
        variables = self.sections()
        self.types = {name: kind for _, name, kind, _ in variables}
        self.written = {name: f"self->{name}" for name in self.types}
        self.blocks[self.name] = [(name, kind) for _, name, kind, _ in variables]
        members = " ".join(f"{self.c(kind)} {name};" for _, name, kind, _ in variables)
        self.out.append(f"typedef struct {{ {members} }} {self.name};\nvoid run_{self.name}({self.name} *self)\n{{")
        self.statements("END_FUNCTION_BLOCK")
        self.out.append("}")

    def c(self, kind: str) -> str:
        return TYPES.get(kind, kind)

    def statements(self, *ends: str) -> str:
        while self.peek() not in ends:
            self.statement()
        return self.take()

    def statement(self) -> None:
        match self.peek():
            case "IF":
                self.take()
                self.out.append(f"if ({self.expression()}) {{")
                self.take("THEN")
                end = self.statements("ELSE", "ELSIF", "END_IF")
                while end != "END_IF":
                    self.out.append("} else {" if end == "ELSE" else f"}} else if ({self.expression()}) {{")
                    if end == "ELSIF":
                        self.take("THEN")
                    end = self.statements("ELSE", "ELSIF", "END_IF")
                self.out.append("}")
            case "FOR":
                self.take()
                name = self.take()
                self.take(":=")
                start = self.expression()
                self.take("TO")
                end = self.expression()
                self.take("DO")
                self.out.append(f"{{ const int end__ = {end}; for ({name} = {start}; {name} <= end__; {name}++) {{")
                self.statements("END_FOR")
                self.out.append("} }")
            case "RETURN" | "EXIT" | "CONTINUE":
                words = {"RETURN": "return result__;", "EXIT": "break;", "CONTINUE": "continue;"}
                self.out.append(words[self.take()])
            case _:
                target, kind = self.variable()
                self.take(":=")
                value = self.expression()
                copies = kind in self.sizes
                self.out.append(
                    f"for (int i = 0; i < {self.sizes[kind]}; i++) {target}[i] = {value}[i];"
                    if copies
                    else f"{target} = {value};"
                )
        self.take(";")

    def variable(self) -> tuple[str, str]:
        name = self.take()
        text, kind = self.written[name], self.types[name]
        if self.peek() == ".":
            self.take()
            member = self.take()
            text, kind = f"{text}.{member}", self.structs[kind][member]
        if self.peek() == "[":
            self.take()
            size = self.sizes[kind] if kind in self.sizes else int(kind.split()[1])
            text, kind = f"{text}[at({self.expression()}, {size})]", "element"
            self.take("]")
        return text, kind

    def expression(self, level: int = 0) -> str:
        if level == len(LEVELS):
            return self.unary()
        text = self.expression(level + 1)
        while self.peek() in LEVELS[level]:
            sign = self.take()
            text = f"({text} {SIGNS.get(sign, sign)} {self.expression(level + 1)})"
        return text

    def unary(self) -> str:
        token = self.peek()
        if token in ("-", "NOT"):
            self.take()
            return f"({'!' if token == 'NOT' else '-'}{self.unary()})"
        if token == "(":
            self.take()
            text = self.expression()
            self.take(")")
            return f"({text})"
        if token in ("TRUE", "FALSE"):
            return str(int(self.take() == "TRUE"))
        if token[0].isdigit():
            self.take()
            return token + ("f" if "." in token and self.single else "")
        if self.tokens[self.place + 1] == "(":
            return self.call()
        return self.variable()[0]

    def call(self) -> str:
        name = self.take()
        self.take("(")
        if name not in self.functions:
            args = [self.expression()]
            while self.peek() == ",":
                self.take()
                args.append(self.expression())
            self.take(")")
            if name in MATH:
                return f"{MATH[name]}{'f' if self.single else ''}({args[0]})"
            if name.startswith("DINT_TO_"):
                return f"(({TYPES[name[8:]]}){args[0]})"
            return f"{'trunc_to_int' if name == 'TRUNC' else name}({', '.join(args)})"
        given = {}
        while self.peek() != ")":
            param = self.take()
            given[param] = self.expression() if self.take(":=", "=>") == ":=" else self.variable()[0]
            if self.peek() == ",":
                self.take()
        self.take(")")
        args = []
        for section, param, kind in self.functions[name]:
            pointer = section == "VAR_OUTPUT" or (section == "VAR_IN_OUT" and kind in self.structs)
            args.append(f"{'&' if pointer else ''}{given.pop(param)}")
        assert not given, given
        return f"{name}({', '.join(args)})"

    def layout(self, kind: str) -> Any:
        """The NumPy type of a variable."""
        if kind in self.structs:
            return np.dtype([(n, self.layout(t)) for n, t in self.structs[kind].items()], align=True)
        if kind in self.sizes:
            return np.dtype((BY_C[self.elements[kind]], (self.sizes[kind],)))
        return np.dtype(BY_C[TYPES[kind]])


class Running:
    """An instance of the function block of a text."""

    def __init__(self, text: str, folder: Path) -> None:
        compiler = Compiler(text)
        ((name, variables),) = compiler.blocks.items()
        source, library = folder / "text.c", folder / "text.so"
        source.write_text("\n".join(compiler.out))
        command = ["gcc", "-std=c99", "-O1", "-w", "-shared", "-fPIC", "-o", str(library), str(source), "-lm"]
        answer = subprocess.run(command, capture_output=True, text=True)
        assert answer.returncode == 0, answer.stderr[:2000]
        self.instance = np.zeros((), np.dtype([(n, compiler.layout(t)) for n, t in variables], align=True))
        self._run = getattr(ctypes.CDLL(str(library)), f"run_{name}")

    def reset(self) -> None:
        """Begins anew."""
        self.instance[...] = np.zeros((), self.instance.dtype)

    def __call__(self, **inputs: Any) -> Any:
        """Runs it once; its variables after that."""
        for name, value in inputs.items():
            self.instance[name] = value
        self._run(ctypes.c_void_p(self.instance.ctypes.data))
        return self.instance
