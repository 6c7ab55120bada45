"""Texts of manifold files from Python values, and line elements of such texts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from . import _latex, _toml
from ._errors import ManifoldError
from ._expressions import Expression, text_of

#: Entries of a symmetric matrix, as manifold files name them.
_ENTRIES = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


def of_matrix(matrix: Any) -> dict[str, str]:
    """Returns the entries of a symmetric 3 × 3 matrix of expressions."""
    listed = matrix.tolist() if hasattr(matrix, "tolist") else [list(row) for row in matrix]
    if len(listed) != 3 or any(len(row) != 3 for row in listed):
        raise ManifoldError("a metric is a matrix of 3 × 3 entries", subject="matrix")
    texts = [[text_of(f"matrix[{i}, {j}]", x) for j, x in enumerate(row)] for i, row in enumerate(listed)]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if texts[i][j] != texts[j][i] and listed[i][j] != listed[j][i]:
            message = f"entries ({i}, {j}) and ({j}, {i}) differ: {texts[i][j]} and {texts[j][i]}"
            raise ManifoldError(message, subject="matrix", hint="a metric is symmetric")
    entries = {name: texts[i][j] for name, (i, j) in _ENTRIES.items()}
    return {name: text for name, text in entries.items() if name[0] == name[1] or text not in ("0", "0.0")}


def written(
    name: str,
    coordinates: Sequence[str],
    definition: tuple[str, Any],
    parameters: Mapping[str, float] | None,
    let: Mapping[str, Expression] | None,
    domain: Mapping[str, Any] | None,
    exits: Mapping[str, Any] | None,
    symmetry: Mapping[str, Any] | None,
    cameras: Mapping[str, Any] | None,
    length: float | None,
) -> str:
    """Writes a manifold file."""
    top = {"name": name, "coordinates": [str(x) for x in coordinates], definition[0]: definition[1]}
    text = "".join(f"{k} = {_toml.value(k, v)}\n" for k, v in top.items())
    text += _toml.table("parameters", parameters or {})
    text += _toml.table("let", {k: text_of(k, v) for k, v in (let or {}).items()})
    bounds = dict(domain or {})
    if "inside" in bounds:
        given = bounds["inside"]
        conditions = [given] if isinstance(given, str) else given
        bounds["inside"] = [text_of("inside", x) for x in conditions]
    text += _toml.table("domain", bounds)
    for exit_name, way in (exits or {}).items():
        text += f"\n[[exit]]\nname = {_toml.string(exit_name)}\n"
        given = dict(way) if isinstance(way, Mapping) else {"when": way}
        for key, item in given.items():
            several = isinstance(item, Sequence) and not isinstance(item, str)
            formula = [text_of(key, x) for x in item] if several else text_of(key, item)
            text += f"{_toml.key(key)} = {_toml.value(key, formula)}\n"
    text += _toml.table("symmetry", symmetry or {})
    region = dict(cameras or {})
    if "at" in region:
        region["at"] = [text_of("at", x) for x in region["at"]]
    if length is not None:
        region["length"] = length
    return text + _toml.table("cameras", region)


def line_element(text: str, coordinates: Sequence[str]) -> str:
    """Returns what the file gives, as LaTeX between dollars; its text where it cannot be read."""
    try:
        import tomllib
    except ImportError:  # Python 3.10
        return f"<pre>{escape(text)}</pre>"
    document = tomllib.loads(text)
    names = [_latex.name(x) for x in coordinates]
    given = document.get("metric")
    if isinstance(given, dict) and "conformal" in given:
        square = " + ".join(rf"\mathrm{{d}}{x}^2" for x in names)
        body = rf"\mathrm{{d}}s^2 = \left({_latex.latex(str(given['conformal']))}\right)^2 \left({square}\right)"
    elif isinstance(given, dict):
        body = r"\mathrm{d}s^2 = " + " + ".join(_term(k, v, names) for k, v in given.items())
    elif "embedding" in document:
        parts = ", ".join(_latex.latex(str(x)) for x in document["embedding"])
        body = rf"f({', '.join(names)}) = \left({parts}\right)"
    else:
        return f"<pre>{escape(text)}</pre>"
    where = [rf"{_latex.name(k)} = {_latex.latex(str(v))}" for k, v in document.get("let", {}).items()]
    return f"$\\displaystyle {body}$" + "".join(f"<br>$\\quad {x}$" for x in where)


def _term(entry: str, formula: Any, names: list[str]) -> str:
    """Returns one term of a line element."""
    i, j = _ENTRIES.get(entry, (0, 0))
    body = rf"\left({_latex.latex(str(formula))}\right)"
    if i == j:
        return rf"{body} \, \mathrm{{d}}{names[i]}^2"
    return rf"2 {body} \, \mathrm{{d}}{names[i]} \, \mathrm{{d}}{names[j]}"
