"""Texts of manifold and scene files, written from Python values."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._errors import InputError


def value(name: str, item: Any) -> str:
    """Writes a value."""
    if isinstance(item, bool):
        return "true" if item else "false"
    if isinstance(item, str):
        return string(item)
    if isinstance(item, Mapping):
        pairs = (f"{key(k)} = {value(name, v)}" for k, v in item.items())
        return "{ " + ", ".join(pairs) + " }"
    if isinstance(item, (Sequence, np.ndarray)):
        return "[" + ", ".join(value(name, x) for x in item) + "]"
    try:
        found = float(item)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name}: {item!r} is no number, text or list", subject=name) from None
    if not np.isfinite(found):
        raise InputError(f"{name}: {item!r} is not finite", subject=name)
    return repr(found)


def string(text: str) -> str:
    """Writes a text in quotation marks."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def key(name: str) -> str:
    """Writes a key; in quotation marks where it must be."""
    plain = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if plain else string(name)


def lines(entries: Mapping[str, Any]) -> str:
    """Writes entries, each in a line."""
    return "".join(f"{key(k)} = {value(k, v)}\n" for k, v in entries.items())


def table(title: str, entries: Mapping[str, Any]) -> str:
    """Writes a table under its header; nothing if it is empty."""
    if not entries:
        return ""
    return f"\n[{title}]\n{lines(entries)}"
