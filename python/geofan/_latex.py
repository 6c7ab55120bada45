"""Formulas of manifold files as LaTeX, for notebooks."""

from __future__ import annotations

import ast
import re

_GREEK = frozenset(
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi omega"
    .split()
)
_NAMED = frozenset("sin cos tan sinh cosh tanh exp log min max".split())
_INVERSE = {"asin": "sin", "acos": "cos", "atan": "tan", "asinh": "sinh", "acosh": "cosh", "atanh": "tanh"}
_COMPARED = {ast.Lt: "<", ast.LtE: r"\le", ast.Gt: ">", ast.GtE: r"\ge"}

#: How tightly parts bind: sums, products, signs, powers, names.
_SUM, _PRODUCT, _SIGN, _POWER, _NAME = range(5)


def latex(formula: str) -> str:
    """Returns the formula as LaTeX, or as text where it cannot be read."""
    spelt = re.sub(r"\bif\s*\(", "if_(", formula).replace("^", "**")
    spelt = re.sub(r"\blambda\b", "lambda_", spelt)
    try:
        return _written(ast.parse(spelt.strip(), mode="eval").body)[0]
    except (SyntaxError, ValueError, KeyError, RecursionError):
        return r"\texttt{" + formula.replace("_", r"\_").replace("^", r"\^{}") + "}"


def name(identifier: str) -> str:
    """Returns a name as LaTeX: Greek letters, and digits at its end as a subscript."""
    identifier = identifier.rstrip("_")
    found = re.fullmatch(r"([A-Za-z]+?)_?(\d*)", identifier)
    if found is None:
        return r"\mathrm{" + identifier.replace("_", r"\_") + "}"
    letters, digits = found.groups()
    if letters.lower() in _GREEK:
        body = "\\" + letters
    else:
        body = letters if len(letters) == 1 else rf"\mathrm{{{letters}}}"
    return f"{body}_{{{digits}}}" if digits else body


def _written(node: ast.expr) -> tuple[str, int]:
    """Returns a part as LaTeX, and how tightly it binds."""
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return str(node.value), _NAME
    if isinstance(node, ast.Name):
        return name(node.id), _NAME
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
        sign = "-" if isinstance(node.op, ast.USub) else ""
        return sign + _unsigned(node.operand, _SIGN), _SIGN
    if isinstance(node, ast.BinOp):
        return _operation(node)
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        left, right = _written(node.left)[0], _written(node.comparators[0])[0]
        return f"{left} {_COMPARED[type(node.ops[0])]} {right}", _SUM
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return _call(node.func.id, [_written(argument)[0] for argument in node.args])
    raise ValueError(ast.dump(node))


def _operation(node: ast.BinOp) -> tuple[str, int]:
    if isinstance(node.op, ast.Pow):
        return f"{_bound(node.left, _NAME)}^{{{_written(node.right)[0]}}}", _POWER
    if isinstance(node.op, ast.Div):
        return rf"\frac{{{_written(node.left)[0]}}}{{{_written(node.right)[0]}}}", _POWER
    if isinstance(node.op, ast.Mult):
        right = _unsigned(node.right, _SIGN)
        dot = r" \cdot " if right[:1].isdigit() else r" \, "
        return _bound(node.left, _PRODUCT) + dot + right, _PRODUCT
    sign = {ast.Add: "+", ast.Sub: "-"}[type(node.op)]  # type: ignore[index, unused-ignore]
    right = _unsigned(node.right, _PRODUCT if sign == "-" else _SUM)
    return f"{_written(node.left)[0]} {sign} {right}", _SUM


def _bound(node: ast.expr, least: int) -> str:
    """Returns a part in brackets, unless it binds at least so tightly."""
    text, tight = _written(node)
    return text if tight >= least else rf"\left({text}\right)"


def _unsigned(node: ast.expr, least: int) -> str:
    """Returns a part likewise, in brackets if it begins with a sign, too: for what follows an operator."""
    text = _bound(node, least)
    return rf"\left({text}\right)" if text.startswith("-") else text


def _call(function: str, arguments: list[str]) -> tuple[str, int]:
    joined = ", ".join(arguments)
    if function == "sqrt":
        return rf"\sqrt{{{joined}}}", _NAME
    if function == "abs":
        return rf"\left|{joined}\right|", _NAME
    if function == "if_":
        condition, then, otherwise = arguments
        cases = rf"{then} & {condition} \\ {otherwise} & \text{{else}}"
        return rf"\begin{{cases}} {cases} \end{{cases}}", _NAME
    if function in _INVERSE:
        head = rf"\{_INVERSE[function]}^{{-1}}"
    elif function in _NAMED:
        head = "\\" + function
    else:
        head = rf"\operatorname{{{function}}}"
    return rf"{head}\left({joined}\right)", _POWER
