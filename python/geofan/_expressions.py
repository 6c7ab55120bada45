"""Expressions of a manifold file from strings, numbers and SymPy expressions."""

from __future__ import annotations

from typing import Any

from ._errors import InputError

#: A formula: text in the language of manifold files, a number, or a SymPy expression.
Expression = Any


def text_of(name: str, value: Expression) -> str:
    """Returns the formula as text; `name` is for complaints."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        raise InputError(f"{name}: {value!r} is no formula", subject=name)
    if isinstance(value, (int, float)):
        return repr(float(value)) if isinstance(value, float) else str(value)
    if hasattr(value, "free_symbols") and hasattr(value, "subs"):
        return _printed(name, value)
    try:
        return repr(float(value))
    except (TypeError, ValueError, OverflowError):
        message = f"{name}: {type(value).__name__} is no text, number or SymPy expression"
        raise InputError(message, subject=name) from None


#: SymPy's names of functions by those of manifold files, where they differ.
_FUNCTIONS = {"Abs": "abs", "Max": "max", "Min": "min", "log": "log"}
_KNOWN = frozenset(
    "sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp log sqrt abs min max".split()
)


def _printed(name: str, value: Any) -> str:
    """Prints a SymPy expression in the language of manifold files."""
    from sympy.printing.str import StrPrinter

    class Printer(StrPrinter):  # type: ignore[misc, unused-ignore]
        def _print_Pow(self, expr: Any, rational: bool = False) -> str:
            printed: str = super()._print_Pow(expr, rational)
            return printed.replace("**", "^")

        def _print_Function(self, expr: Any) -> str:
            function = _FUNCTIONS.get(expr.func.__name__, expr.func.__name__)
            if function not in _KNOWN:
                raise InputError(f"{name}: manifold files have no function `{function}`", subject=name)
            return f"{function}({', '.join(self._print(a) for a in expr.args)})"

        def _print_Max(self, expr: Any) -> str:
            # Those of manifold files take two.
            function = _FUNCTIONS[expr.func.__name__]
            *others, printed = map(self._print, expr.args)
            for other in reversed(others):
                printed = f"{function}({other}, {printed})"
            return str(printed)

        _print_Abs = _print_Function
        _print_Min = _print_Max

        def _print_LatticeOp(self, expr: Any) -> str:
            return self._print_Max(expr)

        def _print_Piecewise(self, expr: Any) -> str:
            *cases, (last, condition) = expr.args
            if condition != True:  # noqa: E712 - SymPy's own truth
                raise InputError(f"{name}: the last case of a Piecewise must be True", subject=name)
            printed: str = self._print(last)
            for then, condition in reversed(cases):
                printed = f"if({self._print(condition)}, {self._print(then)}, {printed})"
            return printed

        def _print_Relational(self, expr: Any) -> str:
            if expr.rel_op not in ("<", "<=", ">", ">="):
                raise InputError(f"{name}: conditions are < <= > >=, not {expr.rel_op}", subject=name)
            left, right = self._print(expr.lhs), self._print(expr.rhs)
            return f"{left} {expr.rel_op} {right}"

        def _print_Float(self, expr: Any) -> str:
            return repr(float(expr))

        def _print_Exp1(self, expr: Any) -> str:
            return "e"

    printed: str = Printer({"order": "none"}).doprint(value)
    return printed
