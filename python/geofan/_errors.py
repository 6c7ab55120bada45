"""What can go wrong, as exceptions."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from typing import Any


class GeofanError(Exception):
    """The base of all errors that the package raises itself."""


class InputError(GeofanError, ValueError):
    """Bad input: an argument, a file or a text that cannot work.

    Attributes
    ----------
    subject : str
        The argument, such as ``direction[17]``, or the file at fault.
    file : str or None
        The name of the text that holds the mistake, if it is in a text.
    line, column : int or None
        Where it stands in the text, both from 1.
    hint : str or None
        What to do.
    report : str or None
        The whole message with the text around the mistake, underlined.
    """

    def __init__(
        self,
        message: str,
        *,
        subject: str = "",
        file: str | None = None,
        line: int | None = None,
        column: int | None = None,
        hint: str | None = None,
        report: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.subject = subject
        self.file = file
        self.line = line
        self.column = column
        self.hint = hint
        self.report = report

    def __str__(self) -> str:
        if self.line is None:
            return self.message
        hint = "" if self.hint is None else f" ({self.hint})"
        return f"{self.file}:{self.line}:{self.column}: {self.message}{hint}"

    def __reduce__(self) -> tuple[Any, ...]:
        details = {
            name: getattr(self, name)
            for name in ("subject", "file", "line", "column", "hint", "report")
        }
        return _rebuilt, (type(self), self.message, details)


class ManifoldError(InputError):
    """A manifold that cannot work; ``line``, ``column`` and ``hint`` say where and what to do."""


class SceneError(InputError):
    """A scene that cannot work; ``line``, ``column`` and ``hint`` say where and what to do."""


class GeofanWarning(UserWarning):
    """What works, and is perhaps not what was meant: a view that is black in parts, a promise that is not kept."""


def check_kind(name: str, value: Any, kind: type | tuple[type, ...], told: str) -> None:
    """Refuses a value that is not of a kind, called `told` in the complaint."""
    if not isinstance(value, kind):
        raise InputError(f"{name}: {told} is needed, not {type(value).__name__}", subject=name)


def warn(messages: Iterable[str]) -> None:
    """Warns whoever called the package."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(__package__):
        level, frame = level + 1, frame.f_back
    for message in messages:
        warnings.warn(message, GeofanWarning, stacklevel=level)


def _rebuilt(kind: type[InputError], message: str, details: dict[str, Any]) -> InputError:
    return kind(message, **details)
