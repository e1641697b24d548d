"""The mutants of a module: cosmic-ray's operators, less those that change nothing that is ever run.

Of the operators that put every comparison for every other, and every arithmetic one, those remain that move a boundary,
negate, or turn an operation round: a test that tells these tells the rest, and they are a third of the time.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
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


def mutants_of(path: Path) -> list[Mutant]:
    """Every mutant that is another program than the module and than the mutants before it."""
    code = path.read_text(encoding="utf-8")
    seen = {_meaning(code)}
    mutants = []
    for name in operator_names():
        operator_class = get_operator(name)
        if operator_class.arguments() or not _is_worth_it(name.rpartition("/")[2]):
            continue
        operator = operator_class()
        positions = [place for node in ast_nodes(get_ast(code)) for place in operator.mutation_positions(node)]
        for occurrence in range(len(positions)):
            changed = mutate_code(code, operator, occurrence)
            if changed is None:
                continue
            meaning = _meaning(changed)
            if meaning in seen:
                continue
            seen.add(meaning)
            mutants.append(_mutant(name.rpartition("/")[2], code, changed))
    return sorted(mutants, key=lambda mutant: mutant.line)


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
    """Leaves a marker for each annotation: dataclasses count them, nobody reads them."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(value=None)
        return self.generic_visit(node)

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)
