"""Translates functions of `firmware_sim.equations` to C99: assignments, arithmetic, `if`, min, max, sqrt, exp.

A function of numbers becomes `static double name(...)`; one that returns several numbers becomes
`static void name(..., double result[])`. A function that returns an inner function becomes a structure with its
arguments, which the inner function gets as `with`. Python and C evaluate the same operations in the same order, in
double precision.
"""

import ast

HELPERS = """\
static double lesser(double a, double b) { return b < a ? b : a; }
static double greater(double a, double b) { return b > a ? b : a; }
"""

CALLS = {"min": "lesser", "max": "greater", "sqrt": "sqrt", "exp": "exp"}
OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.USub: "-",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.And: "&&", ast.Or: "||",
}  # fmt: skip
CLOSURE = "Slopes"
"""Annotation of an argument that is an inner function; a call of it gets the structure of that name."""


def c_code(source: str) -> str:
    """All functions of a module's source as C. Raises NotImplementedError, with the line, where it can't translate."""
    tree = ast.parse(source)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    return "\n".join([HELPERS, *(_outer(function) for function in functions)])


def _outer(function: ast.FunctionDef) -> str:
    inner = [node for node in function.body if isinstance(node, ast.FunctionDef)]
    if not inner:
        return _Function(function).code()
    kept = [argument.arg for argument in function.args.args]
    structure = f"struct {CLOSURE} {{\n    double {', '.join(kept)};\n}};\n"
    return structure + "\n" + "\n".join(_Function(one, frozenset(kept)).code() for one in inner)


class _Function:
    """One function. kept : names of the outer function's arguments, for an inner one."""

    def __init__(self, function: ast.FunctionDef, kept: frozenset[str] = frozenset()) -> None:
        self._function = function
        self._kept = kept
        self._arguments = {one.arg for one in function.args.args}
        self._closures = {
            one.arg
            for one in function.args.args
            if isinstance(one.annotation, ast.Name) and one.annotation.id == CLOSURE
        }
        self._locals: dict[str, None] = {}

    def code(self) -> str:
        """The function in C."""
        body = [line for node in self._function.body for line in self._statement(node)]
        names = ", ".join(self._locals)
        declared = [f"    double {names};"] if names else []
        what = (ast.get_docstring(self._function) or "").partition("\n")[0]
        return "\n".join(
            [
                *([f"/* {what} */"] if what else []),
                self._head(),
                "{",
                *declared,
                *(f"    {line}" for line in body),
                "}",
                "",
            ]
        )

    def _head(self) -> str:
        arguments = [f"const struct {CLOSURE} *with"] if self._kept or self._closures else []
        arguments += [f"double {one.arg}" for one in self._function.args.args if one.arg not in self._closures]
        is_scalar = isinstance(self._function.returns, ast.Name) and self._function.returns.id == "float"
        kind = "double" if is_scalar else "void"
        if not is_scalar:
            arguments.append("double result[]")
        return f"static {kind} {self._function.name}({', '.join(arguments)})"

    def _statement(self, node: ast.stmt) -> list[str]:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return []  # the docstring
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            return self._assignment(node.targets[0], node.value)
        if isinstance(node, ast.If):
            body = [f"    {line}" for one in node.body for line in self._statement(one)]
            other = [f"    {line}" for one in node.orelse for line in self._statement(one)]
            return [f"if ({self._value(node.test)}) {{", *body, *(["} else {", *other] if other else []), "}"]
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple):
            values = [self._value(one) for one in node.value.elts]
            return [*(f"result[{at}] = {value};" for at, value in enumerate(values)), "return;"]
        if isinstance(node, ast.Return) and node.value is not None:
            return [f"return {self._value(node.value)};"]
        raise self._unknown(node)

    def _assignment(self, target: ast.expr, value: ast.expr) -> list[str]:
        if isinstance(target, ast.Name):
            return [f"{self._local(target)} = {self._value(value)};"]
        if not isinstance(target, ast.Tuple):
            raise self._unknown(target)
        if isinstance(value, ast.Tuple) and _is_in_order(target, value):
            return [
                line
                for one, other in zip(target.elts, value.elts, strict=True)
                for line in self._assignment(one, other)
            ]
        if isinstance(value, ast.Tuple):  # all values come before the first assignment
            values = [f"const double new{at} = {self._value(one)};" for at, one in enumerate(value.elts)]
            pairs = [f"{self._local(one)} = new{at};" for at, one in enumerate(target.elts)]
            return ["{", *(f"    {line}" for line in (*values, *pairs)), "}"]
        if isinstance(value, ast.Call):
            call = self._call(value, "all")
            pairs = [f"{self._local(one)} = all[{at}];" for at, one in enumerate(target.elts)]
            lines = [f"double all[{len(pairs)}];", f"{call};", *pairs]
            return ["{", *(f"    {line}" for line in lines), "}"]
        raise self._unknown(value)

    def _local(self, target: ast.expr) -> str:
        if not isinstance(target, ast.Name):
            raise self._unknown(target)
        if target.id not in self._arguments:
            self._locals[target.id] = None
        return target.id

    def _value(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=float(number)):
                return repr(number)
            case ast.Name(id=name):
                return f"with->{name}" if name in self._kept else name
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
                return f"({self._value(left)} {OPERATORS[type(op)]} {self._value(right)})"
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return f"(-{self._value(operand)})"
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return f"({self._value(test)} ? {self._value(body)} : {self._value(orelse)})"
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in OPERATORS:
                return f"({self._value(left)} {OPERATORS[type(op)]} {self._value(right)})"
            case ast.Call():
                return self._call(node)
        raise self._unknown(node)

    def _call(self, node: ast.Call, result: str = "") -> str:
        if not isinstance(node.func, ast.Name) or node.keywords:
            raise self._unknown(node)
        name = node.func.id
        values = ["with"] if name in self._closures else []
        values += [self._value(one) for one in node.args]
        return f"{CALLS.get(name, name)}({', '.join([*values, result] if result else values)})"

    def _unknown(self, node: ast.AST) -> NotImplementedError:
        where = f"{self._function.name}, line {getattr(node, 'lineno', '?')}"
        return NotImplementedError(f"{where}: {ast.unparse(node)!r} has no translation to C")


def _is_in_order(targets: ast.Tuple, values: ast.Tuple) -> bool:
    """Whether no value needs a target that comes before it, so that one assignment can follow the other."""
    names = [one.id if isinstance(one, ast.Name) else "" for one in targets.elts]
    used = [{node.id for node in ast.walk(value) if isinstance(node, ast.Name)} for value in values.elts]
    return not any(used[at].intersection(names[:at]) for at in range(len(names)))
