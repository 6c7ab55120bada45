"""Accuracy against table size."""

from __future__ import annotations

import csv
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import _native
from ._arrays import count, number
from ._errors import InputError
from ._manifold import Manifold
from ._progress import Progress, teller


def sweep(
    manifolds: Any,
    out: str | os.PathLike[str] | None = None,
    *,
    quick: bool = True,
    max_error: Sequence[float] = (),
    cells: Sequence[float] = (),
    rays: int | None = None,
    seed: int = 2,
    progress: Progress = False,
) -> dict[str, list[Any]]:
    """Measures accuracy against table size: bundles at several promises beside uniform grids of several sizes.

    Parameters
    ----------
    manifolds : path, Manifold, or a sequence of them
    out : path, optional
        The folder for results: ``sweep.csv``, figures and a page. Points measured before are kept. Without, the
        columns alone are kept.
    quick : bool
        Fewer and smaller tables: minutes instead of hours.
    max_error : floats
        Promises of bundles, mrad, instead of the usual ones.
    cells : floats
        Mean numbers of cells of grids, instead of the usual ones.
    rays, seed : int
        The fresh rays on which tables are measured.
    progress : bool or function
        As in :meth:`Manifold.bake`.

    Returns
    -------
    dict of lists
        The columns of ``sweep.csv``, units in their names, with None for what was not measured:
        ``pandas.DataFrame(gf.sweep(…))``.
    """
    listed = [manifolds] if isinstance(manifolds, (str, os.PathLike, Manifold)) else list(manifolds)
    with tempfile.TemporaryDirectory(prefix="geofan-") as folder:
        results = Path(folder) / "results" if out is None else Path(out)
        paths = [_file_of(item, Path(folder)) for item in listed]
        _native.sweep(
            paths,
            os.fspath(results),
            bool(quick),
            [number("max_error", x) for x in max_error],
            [number("cells", x) for x in cells],
            None if rays is None else count("rays", rays),
            count("seed", seed),
            teller(progress),
        )
        return _columns(results / "sweep.csv")


def _file_of(item: Any, folder: Path) -> str:
    """Returns the file of a manifold; writes one for a manifold that is at hand."""
    if not isinstance(item, Manifold):
        given: str = os.fspath(item)
        return given
    if Manifold(item.text if "\n" in item.text else item.text + "\n").parameters != item.parameters:
        message = "manifolds: parameters that were set are not in the text; write them into it"
        raise InputError(message, subject="manifolds")
    name = "".join(x if x.isalnum() else "-" for x in item.name)
    path = folder / f"{name}.toml"
    path.write_text(item.text, encoding="utf-8")
    return os.fspath(path)


def _columns(path: Path) -> dict[str, list[Any]]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = rows[0].keys() if rows else ()
    return {name: [_value(row[name]) for row in rows] for name in names}


def _value(cell: str) -> Any:
    """Reads a cell as a number where it is one."""
    if not cell:
        return None
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    return cell
