"""Arrays as the extension module takes them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ._errors import InputError

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Counts = npt.NDArray[np.int32]
Names = npt.NDArray[np.str_]


def floats(name: str, values: npt.ArrayLike) -> Floats:
    """Returns `values` as numbers; refuses what are none."""
    if np.ma.is_masked(values):
        raise InputError(f"{name}: some entries are masked", subject=name)
    if getattr(getattr(values, "dtype", None), "kind", "") == "c":
        raise InputError(f"{name}: the numbers are complex, real ones are needed", subject=name)
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: {error}", subject=name) from None


def number(name: str, value: Any) -> float:
    """Returns `value` as one number."""
    found = floats(name, value)
    if found.ndim != 0:
        raise InputError(f"{name}: one number is needed", subject=name)
    return float(found)


def vectors(name: str, values: npt.ArrayLike) -> Floats:
    """Returns an array whose last axis has three entries."""
    found = floats(name, values)
    if found.ndim == 0 or found.shape[-1] != 3:
        raise InputError(f"{name}: the last axis needs 3 entries, the shape is {found.shape}", subject=name)
    return found


def vector(name: str, values: npt.ArrayLike) -> list[float]:
    """Returns three numbers."""
    found = vectors(name, values)
    if found.ndim != 1:
        raise InputError(f"{name}: three numbers are needed, the shape is {found.shape}", subject=name)
    numbers: list[float] = found.tolist()
    return numbers


def rows(values: Floats) -> Floats:
    """Returns vectors as rows; a view wherever one is possible."""
    return values.reshape(-1, 3)


def together(names: tuple[str, str], a: npt.ArrayLike, b: npt.ArrayLike) -> tuple[Floats, Floats, tuple[int, ...]]:
    """Broadcasts two arrays of vectors; returns them as rows, and the shape in front of the vectors."""
    first, second = vectors(names[0], a), vectors(names[1], b)
    try:
        shape = np.broadcast_shapes(first.shape[:-1], second.shape[:-1])
    except ValueError:
        message = f"{names[0]} and {names[1]}: the shapes {first.shape} and {second.shape} do not fit"
        raise InputError(message, subject=names[1]) from None
    return _spread(first, shape), _spread(second, shape), shape


def _spread(values: Floats, shape: tuple[int, ...]) -> Floats:
    """Returns one row for each entry of `shape`: of a single vector without copying it."""
    count = math.prod(shape)
    if values.ndim == 1:
        return np.broadcast_to(values, (count, 3))
    return rows(np.broadcast_to(values, (*shape, 3)))


def integers(name: str, values: npt.NDArray[Any]) -> Integers:
    """Returns an array of whole numbers; refuses what are none."""
    if values.dtype.kind not in "iuf" or not np.array_equal(values, np.trunc(values)):
        raise InputError(f"{name}: whole numbers are needed", subject=name.split(":")[0])
    return np.ascontiguousarray(values, dtype=np.int64)


def count(name: str, value: Any, most: int = 2**63 - 1) -> int:
    """Returns `value` as a whole number that is neither negative nor above `most`."""
    try:
        whole = int(value)
        if whole == value and 0 <= whole <= most:
            return whole
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{name}: {value!r} is no whole number from 0 to {most}", subject=name)


def counts(name: str, values: Any, length: int, most: int = 2**63 - 1) -> list[int]:
    """Returns so many whole numbers."""
    return [count(name, value, most) for value in items(name, values, length)]


def items(name: str, values: Any, length: int) -> list[Any]:
    """Returns the items of a sequence, of which there must be so many."""
    try:
        given = list(values)
    except TypeError:
        given = []
    if len(given) != length:
        raise InputError(f"{name}: a sequence of {length} is needed", subject=name)
    return given


def arc_lengths(values: npt.ArrayLike) -> Floats:
    """Returns arc lengths as one row."""
    found = floats("s", values)
    if found.ndim > 1:
        raise InputError(f"s: one axis is needed, the shape is {found.shape}", subject="s")
    return np.atleast_1d(found)
