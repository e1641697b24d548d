"""The mutants of a module: cosmic-ray's operators, without those that change no code that is ever run.

Of the operators that replace every comparison by every other, and every arithmetic one, those remain that move a
boundary, negate, or invert an operation: a test that detects these detects the others, in a third of the time.
"""

from __future__ import annotations

import ast
import hashlib
import pickle
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import MutationVisitor
from cosmic_ray.plugins import get_operator, operator_names

COMPARISONS = frozenset(
    f"ReplaceComparisonOperator_{pair}"
    for pair in (
        "Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt", "GtE_Lt", "Eq_NotEq", "NotEq_Eq",
        "Is_IsNot", "IsNot_Is", "In_NotIn", "NotIn_In",
    )
)  # fmt: skip
ARITHMETIC = frozenset(
    f"ReplaceBinaryOperator_{pair}" for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Mod_Mul", "Pow_Mul")
)


@dataclass(frozen=True)
class Mutant:
    """A module with one change: the operator, where, the line before and after, and all of the code."""

    operator: str
    line: int
    before: str
    after: str
    code: str


@dataclass(frozen=True)
class Site:
    """A place where an operator can change a module.

    rank : a number that depends on seed, module, operator and line only, so that a change elsewhere does not move it.
    """

    path: Path
    operator_name: str
    occurrence: int
    rank: str


def mutants_of(path: Path) -> list[Mutant]:
    """Every mutant that is another program than the module and than the mutants before it."""
    code = path.read_text(encoding="utf-8")
    seen = {_meaning(code)}
    mutants = []
    for site in sites_of(path):
        changed = _changed_code(code, site)
        meaning = _meaning(changed)
        if meaning not in seen:
            seen.add(meaning)
            mutants.append(_mutant(site.operator_name.rpartition("/")[2], code, changed))
    return sorted(mutants, key=lambda mutant: mutant.line)


def mutant_at(site: Site) -> Mutant | None:
    """The mutant of one place; None where the change makes no other program."""
    code = site.path.read_text(encoding="utf-8")
    changed = _changed_code(code, site)
    if _meaning(changed) in ("", _meaning(code)):
        return None
    return _mutant(site.operator_name.rpartition("/")[2], code, changed)


def sites_of(path: Path, module: str = "", seed: int = 0) -> Iterator[Site]:
    """Every place where one of the operators can change the module."""
    code = path.read_text(encoding="utf-8")
    lines, tree = code.splitlines(), get_ast(code)
    for name, operator in _operators():
        count: Counter[str] = Counter()
        positions = [place for node in ast_nodes(tree) for place in operator.mutation_positions(node)]
        for occurrence, ((line, _), _) in enumerate(positions):
            key = f"{seed} {module} {name} {lines[line - 1].strip()}"
            count[key] += 1
            rank = hashlib.sha256(f"{key} {count[key]}".encode()).hexdigest()
            yield Site(path, name, occurrence, rank)


def _operators() -> Iterator[tuple[str, Any]]:
    for name in operator_names():
        operator_class = get_operator(name)
        if not operator_class.arguments() and _is_worth_it(name.rpartition("/")[2]):
            yield name, operator_class()


def _changed_code(code: str, site: Site) -> str:
    visitor = MutationVisitor(site.occurrence, get_operator(site.operator_name)())
    tree = visitor.walk(pickle.loads(_pickled_tree(code)))  # noqa: S301 - our own
    return str(tree.get_code()) if visitor.mutation_applied else code


@cache
def _pickled_tree(code: str) -> bytes:
    """The tree of a module, which a mutation changes: unpickled in less than half the time of parsing."""
    return pickle.dumps(get_ast(code))


def _is_worth_it(operator: str) -> bool:
    family = operator.partition("_")[0]
    if family == "ReplaceComparisonOperator":
        return operator in COMPARISONS
    return family != "ReplaceBinaryOperator" or operator in ARITHMETIC


def _mutant(operator: str, code: str, changed: str) -> Mutant:
    old, new = code.splitlines(), changed.splitlines()
    number = next(i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b)
    after = new[number].strip() if len(old) == len(new) else f"({len(new) - len(old):+d} lines) {new[number].strip()}"
    return Mutant(operator, number + 1, old[number].strip(), after, changed)


def _meaning(code: str) -> str:
    """The program without its annotations, which are never evaluated, and without docstrings; "" if it is none."""
    try:
        tree = ast.parse(code)
    except SyntaxError:
        return ""
    return ast.dump(_Bare().visit(tree))


class _Bare(ast.NodeTransformer):
    """Leaves a marker for each annotation: dataclasses count them, no code reads them."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(value=None)
        return self.generic_visit(node)

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)
