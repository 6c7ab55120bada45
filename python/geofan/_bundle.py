"""Bundles: baked tables of paths with their certificates."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _native
from ._arrays import arc_lengths, count, number, rows, together, vector, vectors
from ._errors import InputError, warn
from ._manifold import Manifold
from ._paths import Lookups, Paths, Skies
from ._progress import Progress, teller


class Quantiles(NamedTuple):
    """Median, 95th and 99th percentile and maximum of errors; the maximum is of those sampled, not a bound."""

    p50: float
    p95: float
    p99: float
    max: float


@dataclass(frozen=True)
class Certificate:
    """Errors of a table against exact paths, on fresh random rays; all in mrad.

    Attributes
    ----------
    mrad : Quantiles
        Distance across the ray over arc length.
    screen_mrad : Quantiles
        The same divided by the ray's magnification: what an eye can see.
    sky_mrad, rotation_mrad : Quantiles or None
        Errors of directions on skies, and of transported frames, where they are promised.
    flagged : float
        Share of rays of which the table gives up a part.
    rays, seed : int
        How many rays, and their seed.
    tolerance : float
        Local tolerance of the exact paths.
    promise : float
        What was promised of the 99th percentile of the screen error.
    sky_promise : float or None
        What was promised of that of directions.
    kept : bool
        Whether the promise of the screen error holds on these rays, and that of directions where it is one of its own:
        by ``max_sky_error``, and always in spaces without exits.
    sky_kept : bool or None
        Whether the promise of directions holds, whoever made it; None where none are promised or none were seen.
    unfinished : dict or None
        Shares of paths that end by their length or where the metric ends, by the names of ``geofan check --json``.
        Checks alone know them.
    beyond_20_promises : int
        Rays off by more than twenty times the promise; the worst are listed in `worst`. Checks alone know them.
    """

    mrad: Quantiles
    screen_mrad: Quantiles
    sky_mrad: Quantiles | None
    rotation_mrad: Quantiles | None
    flagged: float
    rays: int
    seed: int
    tolerance: float
    promise: float
    sky_promise: float | None
    kept: bool
    sky_kept: bool | None = None
    beyond_20_promises: int = 0
    unfinished: dict[str, float | None] | None = None
    worst: list[dict[str, Any]] = field(default_factory=list, repr=False)

    @classmethod
    def _of(cls, found: Mapping[str, Any], **more: Any) -> Certificate:
        def quantiles(name: str) -> Quantiles | None:
            return None if found[name] is None else Quantiles(**found[name])

        return cls(
            mrad=Quantiles(**found["mrad"]),
            screen_mrad=Quantiles(**found["screen_mrad"]),
            sky_mrad=quantiles("sky_mrad"),
            rotation_mrad=quantiles("rotation_mrad"),
            flagged=found["flagged"],
            rays=found["rays"],
            seed=found["seed"],
            tolerance=found["tolerance"],
            **more,
        )

    def _repr_html_(self) -> str:
        """Shows the errors as a table in a notebook."""
        kinds = {
            "screen": self.screen_mrad,
            "position": self.mrad,
            "sky": self.sky_mrad,
            "rotation": self.rotation_mrad,
        }
        head = "<tr><th>mrad</th><th>p50</th><th>p95</th><th>p99</th><th>max</th></tr>"
        body = "".join(
            f"<tr><td>{name}</td>" + "".join(f"<td>{x:.4f}</td>" for x in found) + "</tr>"
            for name, found in kinds.items()
            if found is not None
        )
        verdict = "kept" if self.kept else "<b>not kept</b>"
        return (
            f"<table>{head}{body}</table>{self.rays} rays, seed {self.seed}; {100 * self.flagged:.3f} % flagged; "
            f"promise of {self.promise:g} mrad: {verdict}"
        )


class Bundle:
    """A baked table of all paths from a region of cameras.

    Parameters
    ----------
    path : path
        A bundle file.

    Raises
    ------
    InputError
        The file is no bundle, or damaged.

    A bundle does not change; it can be pickled, and shared by threads.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._native = _native.Bundle.read(os.fspath(path))
        self._path: str | None = os.fspath(path)

    @classmethod
    def _of(cls, native: _native.Bundle, path: str | None = None) -> Bundle:
        made = cls.__new__(cls)
        made._native = native
        made._path = path
        return made

    @classmethod
    def from_bytes(cls, data: bytes | bytearray | memoryview) -> Bundle:
        """Reads the bytes of a bundle file."""
        try:
            whole = bytes(memoryview(data))
        except TypeError:
            raise InputError(f"data: {type(data).__name__} holds no bytes", subject="data") from None
        return cls._of(_native.Bundle.from_bytes(whole))

    @classmethod
    def _baked(
        cls,
        manifold: Manifold,
        out: str | os.PathLike[str] | None,
        options: tuple[Any, ...],
        progress: Progress,
    ) -> Bundle:
        if out is not None:
            path = os.fspath(out)
            return cls._of(cls._bake(manifold, path, options, progress), path)
        resume = options[3][2]
        if resume:
            raise InputError("resume: an interrupted bake is kept beside `out`; give it", subject="resume")
        with tempfile.TemporaryDirectory(prefix="geofan-") as folder:
            return cls._of(cls._bake(manifold, os.path.join(folder, "table.fan"), options, progress))

    @classmethod
    def _bake(cls, manifold: Manifold, path: str, options: tuple[Any, ...], progress: Progress) -> Any:
        (max_error, max_sky_error), max_size, length, switches, share, certify_rays = options
        baked, warnings = _native.Bundle.bake(
            manifold._native,
            path,
            (
                None if max_error is None else number("max_error", max_error),
                None if max_sky_error is None else number("max_sky_error", max_sky_error),
            ),
            None if max_size is None else count("max_size", max_size),
            None if length is None else number("length", length),
            tuple(bool(x) for x in switches),
            share,
            count("certify_rays", certify_rays),
            teller(progress),
        )
        warn(warnings)
        return baked

    @classmethod
    def merge(
        cls,
        shares: Sequence[str | os.PathLike[str]],
        out: str | os.PathLike[str],
        *,
        progress: Progress = False,
    ) -> Bundle:
        """Joins the shares of one bake (:meth:`Manifold.bake_share`): the same bytes as a bake in one go.

        Parameters
        ----------
        shares : paths
            All shares, in any order.
        out : path
            The bundle file to write.
        progress : bool or function
            As in :meth:`Manifold.bake`.
        """
        if isinstance(shares, (str, os.PathLike)):
            raise InputError("shares: a sequence of paths is needed, not one path", subject="shares")
        paths = [os.fspath(share) for share in shares]
        baked, warnings = _native.Bundle.merge(paths, os.fspath(out), teller(progress))
        warn(warnings)
        assert baked is not None
        return cls._of(baked, os.fspath(out))

    def save(self, path: str | os.PathLike[str]) -> int:
        """Writes the bundle file, whole or not at all; returns its size in bytes."""
        return self._native.write(os.fspath(path))

    def _file(self) -> str | None:
        """Returns the file that it was read from or baked into, if that still holds this bundle."""
        if self._path is None:
            return None
        try:
            kept = _native.Bundle.read(self._path).id == self._native.id
        except (InputError, OSError):
            return None
        return self._path if kept else None

    def to_bytes(self) -> bytes:
        """Returns the bytes of the bundle file."""
        return self._native.to_bytes()

    @property
    def path(self) -> Path | None:
        """The file that it was read from or baked into."""
        return None if self._path is None else Path(self._path)

    @property
    def manifold(self) -> Manifold:
        """The manifold that it was baked from."""
        return Manifold._of(self._native.manifold)

    @property
    def length(self) -> float:
        """How far its paths go, arc length."""
        return self._native.length

    @property
    def info(self) -> dict[str, Any]:
        """What is inside, by the names of ``geofan info --json``."""
        found: dict[str, Any] = json.loads(self._native.info())
        return found

    @property
    def certificate(self) -> Certificate:
        """The errors that were measured after the bake."""
        info = self.info
        if info["certificate"] is None:
            raise InputError("the bundle has no certificate", subject="certificate")
        promises = {name: info[name] for name in ("promise", "sky_promise")}
        kept = {"kept": bool(self._native.kept), "sky_kept": self._native.sky_kept}
        return Certificate._of(info["certificate"], **promises, **kept)

    def check(self, rays: int = 100_000, seed: int = 2, *, progress: Progress = False) -> Certificate:
        """Compares the table with exact paths of fresh random rays.

        Parameters
        ----------
        rays : int
            How many.
        seed : int
            Their seed; the bundle's own certificate has seed 1.
        progress : bool or function
            As in :meth:`Manifold.bake`.
        """
        found = json.loads(self._native.check(count("rays", rays), count("seed", seed), teller(progress)))
        certificate = found.pop("certificate")
        return Certificate._of(certificate, **found)

    def trace(
        self,
        at: npt.ArrayLike,
        direction: npt.ArrayLike,
        length: float | None = None,
        *,
        samples: int = 2,
        tolerance: float = 1e-10,
    ) -> Paths:
        """Reads paths with their frames from the table, each up to the end of its ray.

        The parameters are those of :meth:`Manifold.trace`; the points must lie in the table's region of cameras, and
        rays from one point should follow each other. A path that the table gives up on is integrated. Areas are not
        stored.
        """
        points, directions, shape = together(("at", "direction"), at, direction)
        samples = count("samples", samples)
        found = self._native.trace(
            points,
            directions,
            None if length is None else number("length", length),
            samples,
            number("tolerance", tolerance),
        )
        space = self.manifold
        return Paths._of(found, shape, samples, tuple(space._native.ends), space.coordinates)

    def paths(
        self, camera: npt.ArrayLike, directions: npt.ArrayLike, s: npt.ArrayLike, *, tolerance: float = 1e-8
    ) -> Lookups:
        """Looks up points and tangents of the rays from one camera: the fastest way.

        Parameters
        ----------
        camera : array (3,)
            Chart point of the camera, in the table's region.
        directions : array (…, 3)
            In the standard frame at the camera.
        s : array (k,)
            Ascending arc lengths, the same for all rays.
        tolerance : float
            Of rays that the table gives up on.

        Paths run past exits, as far as the space goes; :meth:`sky` tells where rays leave.
        """
        u, ways, places = vector("camera", camera), vectors("directions", directions), arc_lengths(s)
        found = self._native.paths((u[0], u[1], u[2]), rows(ways), places, number("tolerance", tolerance))
        shape = ways.shape[:-1]
        u_of, v_of = (found[name].reshape(*shape, len(places), 3) for name in ("u", "v"))
        return Lookups(places, u_of, v_of, found["flagged"].reshape(shape).astype(np.bool_))

    def sky(self, camera: npt.ArrayLike, directions: npt.ArrayLike, *, tolerance: float = 1e-8) -> Skies:
        """Tells where the rays from one camera leave, and which part of the sky they see.

        The parameters are those of :meth:`paths`.
        """
        u, ways = vector("camera", camera), vectors("directions", directions)
        found = self._native.sky((u[0], u[1], u[2]), rows(ways), number("tolerance", tolerance))
        shape = ways.shape[:-1]
        return Skies(
            u=found["u"].reshape(*shape, 3),
            direction=found["direction"].reshape(*shape, 3),
            length=found["length"].reshape(shape),
            end_number=found["end"].reshape(shape),
            ends=tuple(self._native.manifold.ends),
        )

    def __repr__(self) -> str:
        info = self.info
        return f"<bundle of {info['name']!r}: {info['cameras']}; {info['patches']} patches>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Bundle.from_bytes, (self.to_bytes(),)

    def _repr_html_(self) -> str:
        """Shows what is inside and the certificate in a notebook."""
        info = self.info
        names = ("cameras", "reduction", "mirrors", "length", "chunks", "patches", "flagged_boxes", "promise")
        cells = "".join(f"<tr><td>{k.replace('_', ' ')}</td><td>{escape(str(info[k]))}</td></tr>" for k in names)
        shown = "" if info["certificate"] is None else self.certificate._repr_html_()
        return f"<b>{escape(info['name'])}</b><table>{cells}</table>{shown}"
