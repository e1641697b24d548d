"""Expressions such as `status == 'tripped' and iae.gain_fall[0] > 1`, read with `ast` and walked; no code is ever run.

An expression knows names, `.key`, `[number]`, constants, `and or not`, comparisons (also chained, `in`, `is None`),
`+ - * /`, `len` and `abs`. A name that is not there is unknown, and so is what is computed from it; `not` of the
unknown is unknown. `x is None` asks whether a value is unknown.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from hil.core.errors import HilError

MAX_LETTERS = 1000

KeyPath = tuple[str | int, ...]
"""The keys of `a.b[0]`."""


class SelectionError(HilError, ValueError):
    """The expression or key can't be used; the message says which part, and what there is instead."""


_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda item, holder: item in holder,
    ast.NotIn: lambda item, holder: item not in holder,
}
_COMPUTE: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_FUNCTIONS: dict[str, Callable[[Any], Any]] = {"len": len, "abs": abs}
_Number = (int, float)


class Expression:
    """An expression that has been read and checked, for any number of runs. Raises SelectionError."""

    def __init__(self, text: str) -> None:
        self._text = " ".join(text.split())
        if not self._text or len(self._text) > MAX_LETTERS:
            raise SelectionError(f"an expression has from 1 to {MAX_LETTERS} letters")
        try:
            self._tree = ast.parse(self._text, mode="eval").body
            self._check(self._tree)
        except SyntaxError as error:
            raise SelectionError(f"{self._text}: not an expression ({error.msg}, at letter {error.offset})") from None
        except (RecursionError, MemoryError, ValueError) as error:
            if isinstance(error, SelectionError):
                raise
            raise SelectionError(f"{self._text[:60]} ...: not an expression that can be read") from None

    @property
    def paths(self) -> Iterator[KeyPath]:
        """What the expression names, such as `("iae", "gain_fall", 0)`."""
        return self._paths(self._tree)

    def is_true(self, names: Mapping[str, Any]) -> bool:
        """Whether it is true, and not false or unknown, of these names. Raises SelectionError."""
        try:
            return self._truth(self._tree, names) is True
        except ArithmeticError as error:
            raise SelectionError(f"{self._text}: {error}") from None

    def value(self, names: Mapping[str, Any]) -> Any:
        """Its value, None if it is unknown. Raises SelectionError."""
        try:
            return self._value(self._tree, names)
        except ArithmeticError as error:
            raise SelectionError(f"{self._text}: {error}") from None

    def _check(self, node: ast.AST) -> None:
        """Only what the opening of this module lists."""
        match node:
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in _FUNCTIONS:
                self._check(argument)
                return
            case ast.Constant(value=value) if value is None or type(value) in (str, bool, int, float):
                return
            case ast.Name():
                return
            case ast.Attribute(value=ast.Name() | ast.Attribute() | ast.Subscript() as holder):
                self._check(holder)
                return
            case ast.Subscript(value=ast.Name() | ast.Attribute() | ast.Subscript() as holder, slice=index):
                self._check_index(index)
                self._check(holder)
                return
            case ast.BoolOp() | ast.List() | ast.Tuple():
                children: Iterable[ast.AST] = node.values if isinstance(node, ast.BoolOp) else node.elts
            case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
                children = [operand]
            case ast.BinOp(op=operation) if type(operation) in _COMPUTE:
                children = [node.left, node.right]
            case ast.Compare():
                children = [node.left, *node.comparators]
                for comparison, right in zip(node.ops, node.comparators, strict=True):
                    if isinstance(comparison, ast.Is | ast.IsNot) and not _is_none(right):
                        raise SelectionError(f"{self._text}: `is` compares with None only; == compares values")
            case _:
                raise SelectionError(
                    f"{self._part(node)}: not possible in an expression; it has names, .key, [number], and, or, not, "
                    "comparisons, + - * /, len() and abs()"
                )
        for child in children:
            self._check(child)

    def _check_index(self, index: ast.AST) -> None:
        match index:
            case ast.Constant(value=value) if type(value) in (int, str):
                return
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=value)) if type(value) is int:
                return
        raise SelectionError(f"{self._text}: in brackets stands a whole number or a key in quotes")

    def _part(self, node: ast.AST) -> str:
        return ast.get_source_segment(self._text, node) or self._text

    def _paths(self, node: ast.AST) -> Iterator[KeyPath]:
        path = _path(node)
        if path is not None:
            yield path
            return
        children = node.args if isinstance(node, ast.Call) else list(ast.iter_child_nodes(node))
        for child in children:
            yield from self._paths(child)

    def _value(self, node: ast.AST, names: Mapping[str, Any]) -> Any:
        path = _path(node)
        if path is not None:
            found: Any = names
            for key in path:
                found = step_into(found, key, None)
            return found
        match node:
            case ast.Constant(value=value):
                return value
            case ast.List(elts=elements) | ast.Tuple(elts=elements):
                return [self._value(element, names) for element in elements]
            case ast.BoolOp(op=ast.And(), values=values):
                return _all(self._truth(value, names) for value in values)
            case ast.BoolOp(values=values):
                return _not(_all(_not(self._truth(value, names)) for value in values))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return _not(self._truth(operand, names))
            case ast.UnaryOp(operand=operand):
                return self._computed(node, operator.neg, self._value(operand, names))
            case ast.BinOp(left=left, op=operation, right=right):
                return self._computed(
                    node, _COMPUTE[type(operation)], self._value(left, names), self._value(right, names)
                )
            case ast.Call(func=ast.Name(id=name), args=[argument]):
                value = self._value(argument, names)
                return self._called(node, name, value)
            case ast.Compare(left=left, ops=operations, comparators=others):
                values = [self._value(one, names) for one in (left, *others)]
                return _all(
                    self._compared(node, operation, values[place], values[place + 1])
                    for place, operation in enumerate(operations)
                )
        raise SelectionError(f"{self._part(node)}: not possible in an expression")

    def _truth(self, node: ast.AST, names: Mapping[str, Any]) -> bool | None:
        value = self._value(node, names)
        if value is None or isinstance(value, bool):
            return value
        raise SelectionError(f"{self._part(node)}: true or false is needed here; compare it, as in `... > 0`")

    def _computed(self, node: ast.AST, operation: Callable[..., Any], *values: Any) -> Any:
        if any(value is None for value in values):
            return None
        if not all(isinstance(value, _Number) for value in values):
            raise SelectionError(f"{self._part(node)}: only numbers can be computed with")
        return operation(*values)

    def _called(self, node: ast.AST, name: str, value: Any) -> Any:
        try:
            return None if value is None else _FUNCTIONS[name](value)
        except TypeError:
            raise SelectionError(f"{self._part(node)}: {name}() can't be had of {kind_of(value)}") from None

    def _compared(self, node: ast.AST, operation: ast.cmpop, left: Any, right: Any) -> bool | None:
        if isinstance(operation, ast.Is | ast.IsNot):
            return (left is None) is isinstance(operation, ast.Is)
        if left is None or right is None:
            return None
        try:
            return bool(_COMPARE[type(operation)](left, right))
        except TypeError:
            raise SelectionError(
                f"{self._part(node)}: {kind_of(left)} can't be compared so with {kind_of(right)}"
            ) from None


def _path(node: ast.AST) -> KeyPath | None:
    """The keys of `a.b[0]`; None for what is no path."""
    match node:
        case ast.Name(id=name):
            return (name,)
        case ast.Attribute(value=holder, attr=key):
            before = _path(holder)
            return None if before is None else (*before, key)
        case ast.Subscript(value=holder, slice=index):
            before = _path(holder)
            return None if before is None else (*before, ast.literal_eval(index))
    return None


def step_into(holder: Any, key: str | int, otherwise: Any) -> Any:
    """What a table has by this key, or a list in this place; `otherwise` where there is nothing."""
    if isinstance(holder, Mapping):
        return holder.get(key, otherwise)
    if isinstance(holder, list | tuple) and isinstance(key, int) and -len(holder) <= key < len(holder):
        return holder[key]
    return otherwise


def _all(values: Iterable[bool | None]) -> bool | None:
    known = list(values)
    return False if False in known else None if None in known else True


def _not(value: bool | None) -> bool | None:
    return None if value is None else not value


def _is_none(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def kind_of(value: Any) -> str:
    """The kind of a value, for messages."""
    if isinstance(value, bool):
        return "true or false"
    if isinstance(value, _Number):
        return "a number"
    return "text" if isinstance(value, str) else "a table" if isinstance(value, Mapping) else "a list"
