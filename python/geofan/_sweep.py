"""Accuracy against table size."""

from __future__ import annotations

import csv
import itertools
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import _native
from ._arrays import count, number
from ._errors import InputError
from ._manifold import Manifold, _rebuilt
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
        The spaces.
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
        paths = _files_of(listed, Path(folder))
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


def _files_of(listed: list[Any], folder: Path) -> list[str]:
    """Returns the files of manifolds; writes one into `folder` for each that has none."""
    paths: list[str] = []
    for item in listed:
        if not isinstance(item, Manifold):
            paths.append(os.fspath(item))
            continue
        if _rebuilt(*item._native.source, [], item._file).parameters != item.parameters:
            message = "manifolds: parameters that were set are not in the text; write them into it"
            raise InputError(message, subject="manifolds")
        paths.append(item._path() or _written(item, folder))
    return paths


def _written(manifold: Manifold, folder: Path) -> str:
    """Writes the file of a manifold, under its name, with a number if that is taken."""
    name = "".join(x if x.isalnum() else "-" for x in manifold.name)
    names = (name if number == 1 else f"{name}-{number}" for number in itertools.count(1))
    path = next(path for name in names if not (path := folder / f"{name}.toml").exists())
    path.write_text(manifold.text, encoding="utf-8")
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
