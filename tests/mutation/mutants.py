"""Small changes of numerical code, each of which a test should notice."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

# Exchanged in both directions.
OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}
CALLS = {
    "floor": "rint",
    "rint": "floor",
    "ceil": "floor",
    "round": "floor",
    "minimum": "maximum",
    "maximum": "minimum",
    "min": "max",
    "max": "min",
    "sin": "cos",
    "cos": "sin",
    "any": "all",
    "all": "any",
    "argmin": "argmax",
    "argmax": "argmin",
    "nanmin": "nanmax",
    "nanmax": "nanmin",
}
SIGNS: dict[type[ast.AST], str] = {ast.USub: "-", ast.Invert: "~", ast.Not: "not "}
ABSOLUTE = {"abs", "fabs"}


@dataclass(frozen=True)
class Mutant:
    """One change: characters ``start`` to ``end`` of a file are replaced."""

    start: int
    end: int
    text: str
    line: int

    def applied(self, source: str) -> str:
        """The changed source."""
        return source[: self.start] + self.text + source[self.end :]

    def described(self, source: str) -> tuple[str, str]:
        """The line before and after."""
        at = source.rfind("\n", 0, self.start) + 1
        till = source.find("\n", self.start)
        line = source[at : till if till >= 0 else None]
        return line.strip(), (line[: self.start - at] + self.text + line[self.end - at :]).strip()


def mutants(source: str) -> list[Mutant]:
    """Every mutant of a module; docstrings, annotations and messages are left alone.

    >>> [m.described("x = a + 2.0")[1] for m in mutants("x = a + 2.0")]
    ['x = a - 2.0', 'x = a + 4.0']
    """
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    data = source.encode()

    def place(line: int, column: int) -> int:
        """Character of a position that counts bytes."""
        return len(data[: starts[line - 1] + column].decode())

    found = []
    for node in _numerical(ast.parse(source)):
        start = place(node.lineno, node.col_offset)
        end = place(node.end_lineno or 0, node.end_col_offset or 0)
        if isinstance(node, ast.BinOp):
            left = place(node.left.end_lineno or 0, node.left.end_col_offset or 0)
            right = place(node.right.lineno, node.right.col_offset)
            found += _operator(source, type(node.op), left, right, node.lineno)
        elif isinstance(node, ast.Compare) and len(node.ops) == 1:
            left = place(node.left.end_lineno or 0, node.left.end_col_offset or 0)
            right = place(node.comparators[0].lineno, node.comparators[0].col_offset)
            found += _operator(source, type(node.ops[0]), left, right, node.lineno)
        elif isinstance(node, ast.Constant):
            changed = _number(node.value)
            if changed is not None:
                found.append(Mutant(start, end, changed, node.lineno))
        elif isinstance(node, ast.Call):
            name = place(node.func.end_lineno or 0, node.func.end_col_offset or 0)
            found += _call(source, node, start, name, end)
        elif isinstance(node, ast.UnaryOp):
            sign = next((word for kind, word in SIGNS.items() if isinstance(node.op, kind)), "")
            if sign:
                found.append(Mutant(start, start + len(sign), "", node.lineno))
    return sorted(set(found), key=lambda mutant: (mutant.start, mutant.text))


Expression = ast.BinOp | ast.Compare | ast.Constant | ast.Call | ast.UnaryOp


def _numerical(tree: ast.AST) -> Iterator[Expression]:
    """Expressions that compute something."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if not isinstance(node, ast.AST) or isinstance(
                node, ast.JoinedStr | ast.Raise | ast.Assert | ast.Import | ast.ImportFrom
            ):
                continue
            if isinstance(node, ast.Subscript) and getattr(node.value, "id", "") == "Annotated":
                continue
            if (
                isinstance(node, ast.UnaryOp)
                and getattr(getattr(tree, "func", 0), "attr", "") == "reshape"
            ):
                continue  # any negative length is NumPy's free one
            if isinstance(node, Expression):
                yield node
            yield from _numerical(node)


def _operator(source: str, kind: type[ast.AST], left: int, right: int, line: int) -> list[Mutant]:
    """The operator between two operands, exchanged."""
    if kind not in OPERATORS:
        return []
    old, new = OPERATORS[kind]
    at = source.find(old, left, right)
    return [] if at < 0 else [Mutant(at, at + len(old), new, line)]


def _number(value: object) -> str | None:
    """Another number; None for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if isinstance(value, int):
        return str(value + 1)
    return repr(2.0 * value if value else 1.0)


def _call(source: str, node: ast.Call, start: int, name_end: int, end: int) -> list[Mutant]:
    """A function of numbers exchanged for its opposite, an absolute value left out."""
    callee = node.func
    name = callee.attr if isinstance(callee, ast.Attribute) else getattr(callee, "id", "")
    if name in ABSOLUTE:
        return [Mutant(start, name_end, "", node.lineno)]
    if name in CALLS:
        return [Mutant(name_end - len(name), name_end, CALLS[name], node.lineno)]
    return []
