"""Faults that can be planted in a source file: small changes that still run and compute something else.

A number is larger; a comparison, a sign or a truth is turned round; a term or a factor is dropped; a minimum is a
maximum. Left out are messages, annotations and indices, where a fault is no wrong number.
"""

import ast
from collections.abc import Iterator
from copy import copy
from pathlib import Path
from typing import Any, NamedTuple

INVERSE: dict[type, type] = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn,
                             ast.Add: ast.Sub, ast.Mult: ast.Div, ast.BitAnd: ast.BitOr, ast.And: ast.Or}  # fmt: skip
INVERSE |= {there: here for here, there in INVERSE.items()}
EXTREMES = {"min": "max", "minimum": "maximum", "argmin": "argmax", "floor": "ceil"}
EXTREMES |= {there: here for here, there in EXTREMES.items()}
LEFT_OUT = {"annotation", "returns", "decorator_list", "slice", "type_params"}
"""Fields of the syntax tree."""


class Fault(NamedTuple):
    """A change of a source file."""

    file: str  # within the checkout
    line: int  # where the changed expression begins, from 1
    column: int  # bytes, from 0
    kind: str
    before: str
    after: str

    def __str__(self):
        return f"{self.file}:{self.line}: {self.before} -> {self.after} ({self.kind})"


def faults_of(root: Path, file: str) -> list[Fault]:
    """All faults that one file can have, in its order."""
    tree = ast.parse((root / file).read_bytes())
    return [
        Fault(file, node.lineno, node.col_offset, kind, ast.unparse(node), f"({ast.unparse(changed)})")
        for node in _expressions(tree)
        for kind, changed in _changes(node)
    ]


def planted(root: Path, fault: Fault) -> bytes:
    """The source of the fault's file with the fault in it."""
    source = (root / fault.file).read_bytes()
    lines = source.splitlines(keepends=True)
    for node in _expressions(ast.parse(source)):
        if (node.lineno, node.col_offset, ast.unparse(node)) == (fault.line, fault.column, fault.before):
            begin = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
            end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
            return source[:begin] + fault.after.encode() + source[end:]
    raise ValueError(f"{fault.file} has changed: there is no {fault.before} in line {fault.line}")


def _expressions(node: ast.AST) -> Iterator[Any]:
    """The expressions of a tree that faults are planted in."""
    if isinstance(node, ast.expr):
        yield node
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr):
        return
    if isinstance(node, ast.keyword) and node.arg == "axis":
        return
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in LEFT_OUT:
                yield from _expressions(child)


def _changes(node: Any) -> Iterator[tuple[str, ast.AST]]:
    """What an expression may become, with the kind of the fault."""
    match node:
        case ast.Constant(value=bool(truth)):
            yield "truth", ast.Constant(not truth)
        case ast.Constant(value=int(number)):
            yield "number", ast.Constant(number + 1 if abs(number) < 10 else 2 * number)
        case ast.Constant(value=float(number)):
            yield "number", ast.Constant(2 * number or 1.0)
        case ast.Compare(ops=[operator]) if type(operator) in INVERSE:
            yield "comparison", _with(node, ops=[INVERSE[type(operator)]()])
        case ast.BoolOp(op=operator):
            yield "truth", _with(node, op=INVERSE[type(operator)]())
        case ast.BinOp(op=operator) if type(operator) in INVERSE and not _is_text(node.left) | _is_text(node.right):
            yield "sign", _with(node, op=INVERSE[type(operator)]())
            yield "dropped", node.left
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert()):
            yield "sign", node.operand
        case ast.Call(func=ast.Name(id=name) as called) if name in EXTREMES:
            yield "extreme", _with(node, func=_with(called, id=EXTREMES[name]))
        case ast.Call(func=ast.Attribute(attr=name) as called) if name in EXTREMES:
            yield "extreme", _with(node, func=_with(called, attr=EXTREMES[name]))


def _with(node: Any, **fields: Any) -> Any:
    changed = copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
