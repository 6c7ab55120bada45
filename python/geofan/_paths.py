"""Results about many rays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ._arrays import Counts, Floats, Integers, Names


def _name_of(numbers: Counts, names: tuple[str, ...]) -> Names:
    """Returns names by their numbers."""
    return np.asarray(names)[numbers]


@dataclass(frozen=True, repr=False)
class Paths:
    """Geodesics as samples. The leading axes are those of the points and directions that were given.

    With samples at given arc lengths (``s=``), those beyond a path's end are not numbers.

    Attributes
    ----------
    s : array (…, samples)
        Arc length from the start.
    u : array (…, samples, 3)
        Chart points; glued coordinates lie inside their limits.
    v : array (…, samples, 3)
        Tangents, chart components, of unit length (against the wind, where there is one).
    frame : array (…, samples, 3, 3) or None
        Three transported vectors, ``frame[…, i, :]``, that start as the standard frame.
    area : array (…, samples) or None
        How far a unit solid angle has spread: ``s²`` in flat space; zero at a caustic.
    g, t : array (…, samples) or None
        Where light changes its frequency: frequency seen over frequency sent; where time is not arc length: the
        time since the start.
    length : array (…)
        Arc length at which each path ended.
    steps : array (…)
        Steps that the integrator tried.
    end_number : array (…)
        How each path ended, as an index of ``ends``.
    ends : tuple of str
        The names of exits, then ``length`` and ``singular``: where the metric ends, or where the integrator has taken
        all the steps it may.
    conjugate : list of arrays or None
        Of each path, in flattened order, the arc lengths of points conjugate to its start, if they were asked for.
    exact : array (…) of bool or None
        Which paths were integrated because the table gives up on them; None for exact paths.
    """

    s: Floats
    u: Floats
    v: Floats
    frame: Floats | None
    area: Floats | None
    g: Floats | None
    t: Floats | None
    length: Floats
    steps: Counts
    end_number: Counts
    ends: tuple[str, ...]
    coordinates: tuple[str, str, str]
    conjugate: list[Floats] | None = None
    exact: np.ndarray[Any, np.dtype[np.bool_]] | None = None

    @property
    def end(self) -> Names:
        """How each path ended: the name of its exit, ``length`` or ``singular``."""
        return _name_of(self.end_number, self.ends)

    def __len__(self) -> int:
        """Returns the number of paths."""
        return math.prod(self.length.shape)

    def __repr__(self) -> str:
        numbers, counts = np.unique(self.end_number, return_counts=True)
        told = ", ".join(f"{self.ends[i]}: {n}" for i, n in zip(numbers, counts))
        return f"<{len(self)} paths of {self.s.shape[-1]} samples; ends {told}>"

    def columns(self) -> dict[str, np.ndarray[Any, Any]]:
        """Returns one row for each sample, as columns: ``pandas.DataFrame(paths.columns())``.

        Columns: ``ray`` (number of the path), ``s``, the coordinates, ``v`` and the coordinates' names, and ``area``,
        ``g`` and ``t`` where known. Where two of them would have the same name, as with a coordinate called ``s``, the
        coordinates' columns are ``u_`` and ``v_`` with their names.
        """
        samples = self.s.shape[-1]
        columns: dict[str, np.ndarray[Any, Any]] = {
            "ray": np.repeat(np.arange(len(self)), samples),
            "s": self.s.reshape(-1),
        }
        known = [name for name in ("area", "g", "t") if getattr(self, name) is not None]
        for prefix, values in zip(self._prefixes({*columns, *known}), (self.u, self.v)):
            for k, name in enumerate(self.coordinates):
                columns[prefix + name] = values[..., k].reshape(-1)
        return columns | {name: getattr(self, name).reshape(-1) for name in known}

    def _prefixes(self, others: set[str]) -> tuple[str, str]:
        """Returns what the names of coordinates' columns begin with, so that they differ from `others`."""
        names = [prefix + name for prefix in ("", "v") for name in self.coordinates]
        return ("", "v") if len(others.union(names)) == len(others) + len(names) else ("u_", "v_")

    def to_xarray(self) -> Any:
        """Returns an ``xarray.Dataset`` with the axes ``ray``, ``sample``, ``coordinate`` and ``vector``."""
        import xarray

        samples = self.s.shape[-1]
        axes = {
            "s": ("ray", "sample"),
            "u": ("ray", "sample", "coordinate"),
            "v": ("ray", "sample", "coordinate"),
            "frame": ("ray", "sample", "vector", "coordinate"),
            "area": ("ray", "sample"),
            "g": ("ray", "sample"),
            "t": ("ray", "sample"),
        }
        arrays = {
            name: (dims, getattr(self, name).reshape(-1, samples, *[3] * (len(dims) - 2)))
            for name, dims in axes.items()
            if getattr(self, name) is not None
        }
        ends = {"length": ("ray", self.length.reshape(-1)), "end": ("ray", self.end.reshape(-1))}
        return xarray.Dataset({**arrays, **ends}, coords={"coordinate": list(self.coordinates)})

    @classmethod
    def _of(
        cls,
        found: Mapping[str, Any],
        shape: tuple[int, ...],
        samples: int,
        ends: tuple[str, ...],
        coordinates: tuple[str, str, str],
    ) -> Paths:
        """Shapes what the extension module returned; nothing is copied."""

        def shaped(name: str, *tail: int) -> Any:
            return found[name].reshape(*shape, samples, *tail) if name in found else None

        return cls(
            s=shaped("s"),
            u=shaped("u", 3),
            v=shaped("v", 3),
            frame=shaped("frame", 3, 3),
            area=shaped("area"),
            g=shaped("g"),
            t=shaped("t"),
            length=found["length"].reshape(shape),
            steps=found["steps"].reshape(shape),
            end_number=found["end"].reshape(shape),
            ends=ends,
            coordinates=coordinates,
            conjugate=found.get("conjugate"),
            exact=found["exact"].reshape(shape) if "exact" in found else None,
        )


@dataclass(frozen=True, repr=False)
class Connections:
    """All geodesics from one point to others; one row for each geodesic, by the number of the point, then by length.

    Attributes
    ----------
    index : array (n,)
        Which of the points it reaches, counted from 0; all 0 for a single point.
    direction : array (n, 3)
        Unit direction at the start, in the standard frame there.
    length : array (n,)
        Arc length.
    u : array (n, 3)
        Where the geodesic that was followed ends: at the point, or at its image whole periods away, to within a share
        ``0.01*sqrt(tolerance)`` of its length. `direction` and `length` are put right to the point itself.
    v : array (n, 3)
        Unit tangent at the end, chart components.
    area : array (n,)
        How far a unit solid angle has spread at the end; negative after an odd number of caustics.
    """

    index: Integers
    direction: Floats
    length: Floats
    u: Floats
    v: Floats
    area: Floats

    def __len__(self) -> int:
        """Returns the number of geodesics."""
        return len(self.length)

    def __repr__(self) -> str:
        return f"<{len(self)} geodesics to {len(np.unique(self.index))} points>"


@dataclass(frozen=True, repr=False)
class Lookups:
    """Points and tangents of the rays from one camera, looked up in a table.

    Attributes
    ----------
    s : array (k,)
        Arc lengths.
    u, v : array (…, k, 3)
        Chart points (glued coordinates run on) and tangents as the table has them: past exits, as far as the
        space goes.
    flagged : array (…) of bool
        Which rays were integrated because the table gives up on a part of them.
    """

    s: Floats
    u: Floats
    v: Floats
    flagged: np.ndarray[Any, np.dtype[np.bool_]]


@dataclass(frozen=True, repr=False)
class Skies:
    """Where the rays from one camera leave, and which part of the sky they see.

    Attributes
    ----------
    u : array (…, 3)
        Chart points at the end.
    direction : array (…, 3)
        Unit directions in which the skies are looked up.
    length : array (…)
        Arc lengths of the ends.
    end_number : array (…)
        How each ray ended, as an index of ``ends``.
    ends : tuple of str
        The names of exits, then ``length`` and ``singular``.
    """

    u: Floats
    direction: Floats
    length: Floats
    end_number: Counts
    ends: tuple[str, ...]

    @property
    def end(self) -> Names:
        """How each ray ended: the name of its exit, ``length`` or ``singular``."""
        return _name_of(self.end_number, self.ends)
