"""Manifolds: curved spaces, their geometry and their geodesics."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from . import _manifold_file, _native, _toml
from ._arrays import Floats, arc_lengths, count, counts, items, number, rows, together, vector, vectors
from ._camera import Camera
from ._errors import InputError, ManifoldError, check_kind
from ._expressions import Expression, text_of
from ._paths import Connections, Paths
from ._progress import Progress

if TYPE_CHECKING:
    from ._bundle import Bundle

class Manifold:
    """A curved 3-dimensional space in one chart.

    Parameters
    ----------
    source : path or str
        A manifold file, or the text of one (a text has line ends).
    parameters : mapping, optional
        Values that replace those of the file.

    Raises
    ------
    ManifoldError
        The file cannot work; ``line``, ``column`` and ``hint`` say where and what to do.

    Points ``u`` are chart coordinates, tangents ``v`` chart components; lengths are in the metric's unit, angles in
    radians where nothing else is said. Directions are given in the *standard frame* at their point (Gram–Schmidt of
    the coordinate vectors in their order) and need no unit length. Arrays of points have any leading axes before the
    last one of three; results have the same. A manifold does not change, and can be pickled and shared by threads.
    Of a spacetime, and where a manifold file gives a ``shift``, "the metric" in the text of functions is that of light:
    the metric of space over lapse².

    >>> import geofan as gf
    >>> sphere = gf.Manifold.metric(conformal="2/(1 + x^2 + y^2 + z^2)")
    >>> float(sphere.scalar_curvature([0.3, 0.1, 0.2]).round(12))
    6.0
    """

    def __init__(
        self, source: str | os.PathLike[str], *, parameters: Mapping[str, float] | None = None
    ) -> None:
        settings = _settings(parameters)
        #: Where its file is, whatever the working directory is later.
        self._file: str | None = None
        if isinstance(source, str) and "\n" in source:
            self._native = _native.Manifold.parse("text", source, settings, [])
        else:
            self._native = _native.Manifold.load(os.fspath(source), settings)
            self._file = os.path.abspath(os.fspath(source))

    @classmethod
    def _of(cls, native: _native.Manifold, file: str | None = None) -> Manifold:
        made = cls.__new__(cls)
        made._native, made._file = native, file
        return made

    @classmethod
    def metric(
        cls,
        matrix: Any = None,
        *,
        conformal: Expression | None = None,
        coordinates: Sequence[str] = "xyz",
        parameters: Mapping[str, float] | None = None,
        let: Mapping[str, Expression] | None = None,
        domain: Mapping[str, Any] | None = None,
        exits: Mapping[str, Any] | None = None,
        symmetry: Mapping[str, Any] | None = None,
        cameras: Mapping[str, Any] | None = None,
        length: float | None = None,
        name: str = "metric",
        **entries: Expression,
    ) -> Manifold:
        """Makes a manifold of its metric.

        Parameters
        ----------
        matrix : 3 × 3 of expressions, optional
            The metric, such as a SymPy matrix; it must be symmetric.
        conformal : expression, optional
            ``n`` of a metric ``n² δ``, instead.
        **entries : expression
            Entries ``xx``, ``yy``, ``zz``, ``xy``, ``xz``, ``yz`` of the metric, instead; absent off-diagonals are 0.
        coordinates : three names
            A list, or a text of three letters.
        parameters : mapping of numbers, optional
            What expressions may name; changed by :meth:`set`.
        let : mapping of expressions, optional
            Named subexpressions, in order.
        domain : mapping, optional
            Limits of coordinates, ``{"x": (-1, 1)}``; ``"periodic": ["x"]`` glues them; ``"inside": [expression]``
            must stay above 0.
        exits : mapping, optional
            By its name when a path leaves: an expression that becomes positive, or
            ``{"when": expression, "direction": [three expressions]}``.
        symmetry : mapping, optional
            Claims, each checked: ``{"rotation": "origin"}``, ``{"translation": ["x"]}``.
        cameras : mapping, optional
            Where cameras may be: ``{"parameters": {"c": (0, 4)}, "at": ["c", 0, 0], "length": 10}``.
        length : float, optional
            How far paths are followed.

        Expressions are texts in the language of manifold files (``^`` is a power), numbers, or SymPy expressions.
        """
        given = [x is not None for x in (matrix, conformal)] + [bool(entries)]
        if sum(given) != 1:
            raise ManifoldError("give exactly one of matrix, conformal, and entries such as xx", subject="metric")
        if conformal is not None:
            definition = {"conformal": text_of("conformal", conformal)}
        elif matrix is not None:
            definition = _manifold_file.of_matrix(matrix)
        else:
            definition = {k: text_of(k, v) for k, v in entries.items()}
        sections = (parameters, let, domain, exits, symmetry, cameras, length)
        return cls._written(name, coordinates, ("metric", definition), sections)

    @classmethod
    def embedding(
        cls,
        components: Sequence[Expression],
        *,
        coordinates: Sequence[str] = "xyz",
        parameters: Mapping[str, float] | None = None,
        let: Mapping[str, Expression] | None = None,
        domain: Mapping[str, Any] | None = None,
        exits: Mapping[str, Any] | None = None,
        symmetry: Mapping[str, Any] | None = None,
        cameras: Mapping[str, Any] | None = None,
        length: float | None = None,
        name: str = "embedding",
    ) -> Manifold:
        """Makes a manifold of its embedding in R^N.

        Parameters
        ----------
        components : expressions
            The N ≥ 3 coordinates of the image of a chart point.

        The others are those of :meth:`metric`.
        """
        texts = [text_of(f"components[{i}]", x) for i, x in enumerate(components)]
        sections = (parameters, let, domain, exits, symmetry, cameras, length)
        return cls._written(name, coordinates, ("embedding", texts), sections)

    @classmethod
    def _written(
        cls, name: str, coordinates: Sequence[str], definition: tuple[str, Any], sections: tuple[Any, ...]
    ) -> Manifold:
        """Makes a manifold of the text that a file would have."""
        text = _manifold_file.written(name, coordinates, definition, *sections)
        return cls._of(_native.Manifold.parse(name, text, [], []))

    def set(self, **parameters: float) -> Manifold:
        """Returns the manifold with other values of parameters: ``m.set(a=0.5)``."""
        settings = dict(self._native.parameters) | dict(_settings(parameters))
        return Manifold._of(self._native.set(list(settings.items())), self._file)

    @property
    def name(self) -> str:
        """Its name."""
        return self._native.name

    @property
    def text(self) -> str:
        """The text of its file."""
        return self._native.source[1]

    @property
    def coordinates(self) -> tuple[str, str, str]:
        """The names of the coordinates."""
        return self._native.coordinates

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters, as set."""
        return dict(self._native.parameters)

    @property
    def exits(self) -> tuple[str, ...]:
        """The names of the ways out: the file's, then ``limit`` and ``inside``."""
        return tuple(self._native.ends[:-2])

    @property
    def length(self) -> float | None:
        """How far paths are followed, if the file says."""
        return self._native.length

    @property
    def cameras(self) -> dict[str, tuple[float, float]] | None:
        """The intervals of camera parameters by their names; None without a region of cameras."""
        region = self._native.cameras
        return None if region is None else {name: (low, high) for name, (low, high) in region}

    def mirrors(self, length: float | None = None) -> int:
        """Counts the reflections and exchanges of coordinates that a bake over `length` finds and uses."""
        return self._native.mirrors(None if length is None else number("length", length))

    def differences(self, other: Manifold) -> list[str]:
        """Lists what makes two manifolds different spaces; nothing if they mean the same."""
        return self._native.differences(other._native)

    def metric_at(self, u: npt.ArrayLike) -> Floats:
        """Returns the metric ``g_ij`` at points.

        Parameters
        ----------
        u : array (…, 3)
            Chart points.

        Returns
        -------
        array (…, 3, 3)

        Raises
        ------
        InputError
            A point lies outside the domain, or the metric fails there; `subject` names the point.
        """
        return self._at("metric", u, 3, 3)

    def christoffel(self, u: npt.ArrayLike) -> Floats:
        """Returns the Christoffel symbols ``Γ^k_ij`` at points, as an array (…, k, i, j)."""
        return self._at("christoffel", u, 3, 3, 3)

    def riemann(self, u: npt.ArrayLike) -> Floats:
        """Returns the Riemann tensor ``R_abcd`` at points, as an array (…, a, b, c, d).

        It is ``K (g_ac g_bd − g_ad g_bc)`` where all sectional curvatures are K.
        """
        return self._at("riemann", u, 3, 3, 3, 3)

    def ricci(self, u: npt.ArrayLike) -> Floats:
        """Returns the Ricci tensor ``R_bd = g^ac R_abcd`` at points, as an array (…, b, d)."""
        return self._at("ricci", u, 3, 3)

    def scalar_curvature(self, u: npt.ArrayLike) -> Floats:
        """Returns the scalar curvature at points, as an array (…): 6 on the unit 3-sphere."""
        return self._at("scalar", u)

    def inverse_metric(self, u: npt.ArrayLike) -> Floats:
        """Returns the inverse metric ``g^ij`` at points, as an array (…, 3, 3)."""
        return self._at("inverse", u, 3, 3)

    def connection(self, u: npt.ArrayLike) -> Floats:
        """Returns the connection of the standard frame at points, as an array (…, k, a, b).

        It is ``Ω(∂_k)^a_b``: how the frame turns along the coordinates.
        """
        return self._at("connection", u, 3, 3, 3)

    def frame(self, u: npt.ArrayLike) -> Floats:
        """Returns the standard frame at points: three orthonormal vectors ``[…, i, :]`` in chart components."""
        return self._at("frame", u, 3, 3)

    def _at(self, quantity: str, u: npt.ArrayLike, *tail: int) -> Floats:
        points = vectors("u", u)
        return self._native.at(quantity, rows(points)).reshape((*points.shape[:-1], *tail))

    def transport(
        self,
        curve: Any,
        vectors: npt.ArrayLike,
        interval: tuple[float, float] = (0.0, 1.0),
        *,
        tolerance: float = 1e-10,
    ) -> Floats:
        """Carries vectors along a curve by parallel transport.

        Parameters
        ----------
        curve : three expressions of t, or array (n, 3)
            A curve of the chart, or points of the chart that are joined by straight lines of the chart. Samples of paths
            (``Paths.u``) are within the domain: where a path goes over the limits of a periodic coordinate, let that go
            on (``numpy.unwrap``). Through glued faces points carry nothing.
        vectors : array (…, 3)
            Vectors at its start, chart components.
        interval : (float, float)
            The parameter of expressions runs from the first to the second.
        tolerance : float
            Largest angle (radians) by which one step may be off.

        Returns
        -------
        array (…, 3)
            The vectors at its end, chart components.
        """
        carried = _vectors("vectors", vectors)
        accuracy = number("tolerance", tolerance)
        if not hasattr(curve, "__len__"):
            raise InputError("curve: three expressions or an array of points are needed", subject="curve")
        if len(curve) == 3 and all(_is_formula(x) for x in curve):
            texts = [text_of(f"curve[{i}]", x) for i, x in enumerate(curve)]
            start, end = (number("interval", t) for t in items("interval", interval, 2))
            matrix = self._native.transport_along((texts[0], texts[1], texts[2]), (start, end), accuracy)
        else:
            points = _vectors("curve", curve)
            if points.ndim != 2 or len(points) == 0:
                raise InputError("curve: points are an array (n, 3)", subject="curve")
            matrix = self._native.transport_through(points, accuracy)
        arrived: Floats = carried @ np.array(matrix).T
        return arrived

    def trace(
        self,
        at: npt.ArrayLike,
        direction: npt.ArrayLike,
        length: float | None = None,
        *,
        samples: int = 2,
        s: npt.ArrayLike | None = None,
        tolerance: float = 1e-10,
        forward: bool = False,
        frame: bool = True,
        area: bool = True,
        conjugate: bool = False,
    ) -> Paths:
        """Follows geodesics exactly, many at once on all threads.

        Parameters
        ----------
        at : array (…, 3)
            Where they start.
        direction : array (…, 3)
            Where they go, in the standard frame there, of any length; the leading axes of both are broadcast.
        length : float, optional
            How far. Without, to the last of `s`, or as far as the manifold says.
        samples : int
            How many samples of each path, equally spaced from its start to its end.
        s : array (samples,), optional
            Arc lengths of samples, ascending, instead; beyond a path's end there are no numbers.
        tolerance : float
            Largest local error of a step, radians.
        forward : bool
            Follow light into the future; without, the line of sight, along which light has come. They differ where
            there is a wind.
        frame, area : bool
            Whether to carry the transported frame and the geodesic deviation along; without, paths are faster.
        conjugate : bool
            Whether to find the points conjugate to the start.

        A path for which the integrator would need more than 200,000 steps ends there, as ``singular``. One that would
        meet a pole of the chart, where the metric ends and the space does not, is turned by 1e-7 radians and goes past it.
        """
        points, directions, shape = together(("at", "direction"), at, direction)
        places = None if s is None else arc_lengths(s)
        samples = count("samples", samples)
        found = self._native.trace(
            points,
            directions,
            None if length is None else number("length", length),
            samples,
            places,
            number("tolerance", tolerance),
            bool(forward),
            (bool(frame), bool(area)),
            bool(conjugate),
        )
        samples = samples if places is None else len(places)
        return Paths._of(found, shape, samples, tuple(self._native.ends), self.coordinates)

    def connect(
        self, p: npt.ArrayLike, q: npt.ArrayLike, length: float | None = None, *, tolerance: float = 1e-10
    ) -> Connections:
        """Finds all geodesics from a point to others, up to a length.

        Parameters
        ----------
        p : array (3,)
            The start, a chart point.
        q : array (3,) or (n, 3)
            The points to reach.
        length : float, optional
            The longest geodesic; the manifold's own length if it has one.
        tolerance : float
            Largest local error of a step, radians.

        Ctrl-C takes effect when the fan of geodesics from `p` has been followed, and then between blocks of points.
        """
        start, points = vector("p", p), vectors("q", q)
        found = self._native.connect(
            (start[0], start[1], start[2]),
            rows(points),
            None if length is None else number("length", length),
            number("tolerance", tolerance),
        )
        return Connections(**found)

    def camera(
        self,
        at: npt.ArrayLike | Mapping[str, float],
        look: npt.ArrayLike,
        up: npt.ArrayLike = (0.0, 0.0, 1.0),
        *,
        fov: float | None = None,
        projection: str = "perspective",
        width: float | None = None,
        stereo: Mapping[str, Any] | None = None,
        crop: Sequence[float] | None = None,
        rest: str | None = None,
        velocity: npt.ArrayLike | None = None,
    ) -> Camera:
        """Returns a camera.

        Parameters
        ----------
        at : array (3,) or mapping
            A chart point, or values of the manifold's camera parameters.
        look, up : array (3,)
            The directions of view and upwards, in the standard frame.
        fov : float
            Horizontal angle of view, degrees, 90 if not given; of a fisheye the angle across its circle, 180.
        projection : {"perspective", "panorama", "fisheye", "orthographic", "cube"}
            How pixels become rays.
        width : float
            Of an orthographic camera: length in the metric across the picture.
        stereo : mapping, optional
            Two eyes: ``{"separation": 0.065, "convergence": 2.0, "layout": "side-by-side"}``, lengths in the metric;
            its layout may be ``"over-under"``, too.
        crop : four numbers, optional
            The part that is drawn: x, y, width and height, parts of the picture.
        rest : {"normal", "static"}, optional
            Whose directions the camera has: those of the normal observer, or at rest in the chart.
        velocity : array (3,), optional
            Past the normal observer instead, standard frame; light has 1.

        Raises
        ------
        InputError
            It cannot be; ``line`` and ``hint`` are of the lines that a scene file would have.
        """
        place = {str(k): number(str(k), v) for k, v in at.items()} if isinstance(at, Mapping) else vector("at", at)
        entries: dict[str, Any] = {
            "parameters" if isinstance(at, Mapping) else "at": place,
            "look": vector("look", look),
            "up": vector("up", up),
            "projection": projection,
            "fov": fov,
            "width": width,
            "stereo": stereo,
            "crop": crop,
            "rest": rest,
            "velocity": None if velocity is None else vector("velocity", velocity),
        }
        return Camera._read(self, _toml.lines({k: v for k, v in entries.items() if v is not None}))

    def journey(
        self,
        poses: str | os.PathLike[str] | Sequence[tuple[float, Camera]],
        frames: int,
        *,
        like: Camera | None = None,
    ) -> list[Camera]:
        """Returns the cameras of an animation, evenly in time: along geodesics from one key pose to the next.

        Parameters
        ----------
        poses : path, or pairs of a time and a camera
            A file of ``[[pose]]`` tables as ``geofan render --camera-path`` takes it, or key poses, times ascending.
        frames : int
            How many cameras, from 2.
        like : Camera, optional
            How they draw (projection, stereo, crop); the first pose of a sequence, if it is not given.
        """
        if isinstance(poses, (str, os.PathLike)):
            told = (os.fspath(poses), _read_poses(Path(poses)))
        else:
            pairs = [self._key_pose(f"poses[{i}]", pose) for i, pose in enumerate(poses)]
            like = pairs[0][1] if like is None and pairs else like
            told = ("poses", "".join(_pose(time, camera) for time, camera in pairs))
        if like is not None:
            check_kind("like", like, Camera, "a Camera")
        drawn = None if like is None else like._native
        found = _native.journey(self._native, told, count("frames", frames), drawn)
        return [Camera(self, camera) for camera in found]

    def _key_pose(self, name: str, pose: Any) -> tuple[float, Camera]:
        """Returns the time and the camera of a key pose, which must be in this manifold."""
        time, camera = items(name, pose, 2)
        check_kind(name, camera, Camera, "a Camera")
        if camera.manifold.differences(self):
            raise InputError(f"{name}: its camera is in another manifold", subject=name)
        return number(name, time), camera

    def bake(
        self,
        max_error: float | None = 0.5,
        *,
        max_sky_error: float | None = None,
        max_size: int | None = None,
        length: float | None = None,
        out: str | os.PathLike[str] | None = None,
        frames: bool = True,
        mirrors: bool = True,
        resume: bool = False,
        wait: bool = False,
        certify_rays: int = 20_000,
        progress: Progress = False,
    ) -> Bundle:
        """Bakes all paths of the manifold's region of cameras into a table.

        Parameters
        ----------
        max_error : float or None
            The promise: 99th percentile of the screen error, in mrad. With None and `max_size` it is loosened until
            the table fits.
        max_sky_error : float, optional
            The promise of directions: 99th percentile of the sky error, in mrad. Without, `max_error` where paths
            may end at an exit, and four times that where they never do.
        max_size : int, optional
            The largest file, bytes.
        length : float, optional
            How far paths go; the manifold's own if it has one.
        out : path, optional
            The bundle file to write. Without, the table is in memory alone.
        frames : bool
            Whether tangents are promised, and with them transported frames.
        mirrors : bool
            Whether to leave out what reflections or exchanges of coordinates carry into other parts.
        resume : bool
            Go on with what an interrupted bake left beside `out`.
        wait : bool
            If another process bakes into the same file, wait until it has ended.
        certify_rays : int
            Fresh random rays that the certificate takes.
        progress : bool or function
            Show a bar (by tqdm where it is installed), or call ``progress(work, done, total, detail)``.

        Ctrl-C ends a bake; with `out`, finished parts are kept, and ``resume=True`` goes on. A promise that is not
        kept, and paths that end before they leave, are warned of (:class:`GeofanWarning`).
        """
        from ._bundle import Bundle

        promises = (max_error, max_sky_error)
        options = (promises, max_size, length, (frames, mirrors, resume, wait), None, certify_rays)
        return Bundle._baked(self, out, options, progress)

    def bake_share(
        self,
        share: tuple[int, int],
        out: str | os.PathLike[str],
        max_error: float = 0.5,
        *,
        max_sky_error: float | None = None,
        length: float | None = None,
        frames: bool = True,
        mirrors: bool = True,
        resume: bool = False,
        wait: bool = False,
        certify_rays: int = 20_000,
        progress: Progress = False,
    ) -> Path:
        """Bakes one share of a table, for :meth:`Bundle.merge`: on several machines, or workers of Dask or Ray.

        Parameters
        ----------
        share : (int, int)
            ``(1, 4)`` is the first of four.
        out : path
            The file of the share.

        The others are those of :meth:`bake`, and must be the same for all shares. Returns `out`.
        """
        from ._bundle import Bundle

        index, of = counts("share", share, 2, _MOST_SHARES)
        pair = (index, of)
        options = ((max_error, max_sky_error), None, length, (frames, mirrors, resume, wait), pair, certify_rays)
        Bundle._bake(self, os.fspath(out), options, progress)
        return Path(out)

    def _path(self) -> str | None:
        """Returns the file that it was read from, if that still says the same."""
        name, text = self._native.source
        path = os.path.abspath(name) if self._file is None else self._file
        try:
            return path if Path(path).read_text(encoding="utf-8") == text else None
        except (OSError, ValueError):  # no file, or one of bytes that are no text
            return None

    def __repr__(self) -> str:
        set_to = "".join(f", {name}={value:g}" for name, value in self.parameters.items())
        return f"<manifold {self.name!r} over {', '.join(self.coordinates)}{set_to}>"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Manifold):
            return NotImplemented
        return self._native.fingerprint == other._native.fingerprint

    def __hash__(self) -> int:
        return hash(self._native.fingerprint)

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (*self._native.source, self._native.parameters, self._file, self._native.samples())

    def _repr_html_(self) -> str:
        """Shows the line element, the domain, exits and symmetries in a notebook."""
        lines = self._native.lines()
        if self.length is not None and self.cameras is not None:
            lines.append(("mirrors found", str(self.mirrors())))
        lines += [(f"parameter {name}", f"{value:g}") for name, value in self.parameters.items()]
        cells = "".join(f"<tr><td>{escape(a)}</td><td>{escape(b)}</td></tr>" for a, b in lines)
        element = _manifold_file.line_element(self.text, self.coordinates)
        return f"<b>{escape(self.name)}</b><br>{element}<table>{cells}</table>"


#: The most shares of a bake.
_MOST_SHARES = 2**32 - 1

#: What a key pose of an animation tells of a camera.
_POSE_KEYS = ("at", "look", "up", "fov", "rest", "velocity")


def _pose(time: float, camera: Camera) -> str:
    """Writes a key pose."""
    kept = [line for line in camera.text.splitlines() if line.split(" = ")[0] in _POSE_KEYS]
    if camera.projection != "perspective":
        kept = [line for line in kept if not line.startswith("fov")]
    return "[[pose]]\n" + _toml.lines({"time": number("time", time)}) + "\n".join(kept) + "\n"


def _read_poses(path: Path) -> str:
    """Reads the text of a file of key poses."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no text: {error}", subject=os.fspath(path)) from None


def _vectors(name: str, values: npt.ArrayLike) -> Floats:
    return vectors(name, values)


def _is_formula(item: Any) -> bool:
    """Tells a formula from the coordinates of a point."""
    return isinstance(item, (str, int, float)) or hasattr(item, "free_symbols")


def _settings(parameters: Mapping[str, float] | None) -> list[tuple[str, float]]:
    """Returns names and numbers."""
    return [(str(name), number(str(name), value)) for name, value in (parameters or {}).items()]


def _rebuilt(
    name: str,
    text: str,
    parameters: list[tuple[str, float]],
    file: str | None = None,
    samples: list[tuple[str, bytes]] | None = None,
) -> Manifold:
    """Makes a manifold of its text and the samples of its fields again, whatever has become of their files."""
    return Manifold._of(_native.Manifold.parse(name, text, parameters, samples or []), file)
