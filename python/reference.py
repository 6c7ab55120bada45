"""Writes docs/python.md, the reference of the package, from its docstrings.

    python python/reference.py            writes the page
    python python/reference.py --check    fails if it is not up to date
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path
from typing import Any

import geofan as gf

PAGE = Path(__file__).resolve().parents[1] / "docs" / "python.md"

#: Classes and functions in the order of the page.
ORDER = (
    "Manifold", "Paths", "Connections", "Bundle", "Certificate", "Quantiles", "Lookups", "Skies", "Camera", "Scene",
    "Image", "Comparison", "page", "view", "View", "sweep", "threads", "thread_count", "GeofanError", "InputError",
    "ManifoldError", "SceneError", "GeofanWarning",
)  # fmt: skip


def signature(item: Any) -> str:
    """Returns the parameters of a function, without types."""
    found = inspect.signature(item)
    plain = [p.replace(annotation=inspect.Parameter.empty) for p in found.parameters.values() if p.name != "self"]
    return str(inspect.Signature(plain))


def text(item: Any) -> str:
    """Returns a docstring as Markdown: sections of numpydoc become lists."""
    lines, out = (inspect.getdoc(item) or "").splitlines(), []
    for i, line in enumerate(lines):
        underlined = i + 1 < len(lines) and set(lines[i + 1]) == {"-"} and line.strip() != ""
        if line and set(line) == {"-"}:
            continue
        if underlined:
            out += [f"*{line}*", ""]
        elif line.startswith("    ") and out and out[-1].startswith("- "):
            out[-1] += " " + line.strip()
        elif i > 0 and in_list(lines, i):
            out.append(f"- `{line}`:")
        else:
            out.append(line)
    joined = re.sub(r":\w+:(`[^`]+`)", r"\1", "\n".join(examples(out)))
    return re.sub("(?<!`)``(?!`)", "`", joined)


def in_list(lines: list[str], i: int) -> bool:
    """Tells an entry of a section by the indented text below it."""
    entry = bool(lines[i]) and not lines[i].startswith((" ", ">>>", "..."))
    return entry and i + 1 < len(lines) and lines[i + 1].startswith("    ") and not lines[i].endswith(":")


def examples(lines: list[str]) -> list[str]:
    """Puts examples into blocks of code."""
    out: list[str] = []
    inside = False
    for line in lines:
        if line.startswith(">>>") and not inside:
            out += ["```python"]
            inside = True
        elif inside and not line:
            out += ["```"]
            inside = False
        out.append(line)
    return out + ["```"] * inside


def members(kind: type) -> list[str]:
    """Returns the sections of a class's public methods and properties."""
    parts = []
    for name, member in vars(kind).items():
        if name.startswith("_") or not (inspect.isfunction(member) or isinstance(member, (property, classmethod))):
            continue
        if isinstance(member, property):
            parts.append(f"#### `{kind.__name__}.{name}`\n\n{text(member)}\n")
            continue
        function = getattr(kind, name)
        parts.append(f"#### `{kind.__name__}.{name}{signature(function)}`\n\n{text(function)}\n")
    return parts


def page() -> str:
    """Returns the whole page."""
    missing = set(gf.__all__) - set(ORDER) - {"__version__", "catalogue"}
    assert not missing, missing
    parts = ["# The Python package\n", text(gf) + "\n", "Made from the docstrings by `python/reference.py`.\n"]
    for name in ORDER:
        item = getattr(gf, name)
        named = f"class {name}" if isinstance(item, type) else f"{name}{signature(item)}"
        parts.append(f"## `{named}`\n\n{text(item)}\n")
        if isinstance(item, type):
            parts += members(item)
    parts += ["## `catalogue`\n", text(gf.catalogue) + "\n"]
    parts.append("Its spaces: " + ", ".join(f"`{name}`" for name in gf.catalogue.names()) + ".\n")
    return "\n".join(parts)


if __name__ == "__main__":
    made = page()
    if "--check" in sys.argv:
        sys.exit(0 if PAGE.read_text(encoding="utf-8") == made else f"{PAGE} is not up to date: run {sys.argv[0]}")
    PAGE.write_text(made, encoding="utf-8")
